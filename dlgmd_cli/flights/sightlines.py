"""What lies at the end of lines of sight, spread over a picture: how deep, and which body."""

import numpy as np

from dlgmd_cli.flights.renderer.camera import Camera, FloatArray, Pose
from dlgmd_cli.flights.renderer.solids import IntArray, Solid, Surfaces

# Cells of the grid whose crossings are looked along, its rim being the picture's.
N_COLUMNS, N_ROWS = 64, 36

# A line that runs along the edge between two faces belongs to both of them.
_ROUNDING = 1e-9
_NEAREST_M = 1e-6


class Sightlines:
    """Lines of sight through a grid on the picture, and through further points.

    Parameters
    ----------
    surfaces : Surfaces
        The bodies that can be seen.
    room : Solid
        What is behind them; its faces go on beyond their corners.
    camera : Camera
    """

    def __init__(self, surfaces: Surfaces, room: Solid, camera: Camera) -> None:
        self._surfaces, self._camera = surfaces, camera
        self._walls = room.normals
        self._levels = np.array([wall.normal @ wall.corners_m[0] for wall in room.faces])
        half_width, half_height = camera.middle_xy / camera.focal_px
        self._columns = np.linspace(-half_width, half_width, N_COLUMNS + 1)
        self._rows = np.linspace(-half_height, half_height, N_ROWS + 1)
        x, y = np.meshgrid(self._columns, self._rows)
        self.grid = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)

    def cast(
        self, rays: FloatArray, pose: Pose, offsets_m: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Find what is nearest along each line.

        Parameters
        ----------
        rays : ndarray, shape (n, 3)
            First those of `grid`, then any others: right, down and forward, with forward 1.
        pose : Pose
        offsets_m : ndarray, shape (n_bodies, 3)
            How far the bodies have moved.

        Returns
        -------
        closeness : ndarray, shape (n,)
            1 / depth along the camera's axis, in 1/m; 0 where there is nothing.
        body : ndarray, shape (n,)
            Which it is; -1 for the room, and where there is nothing.
        """
        closeness, body = self._room(rays, pose), np.full(len(rays), -1, np.intp)
        hits = self._faces(rays, pose, offsets_m)
        for near, ray, owner in [hits, *self._rounds(rays, pose, offsets_m)]:
            nearer = near > closeness[ray]
            near, ray, owner = near[nearer], ray[nearer], owner[nearer]
            # Of several values for one line, the last and so the nearest stays.
            order = np.argsort(near)
            closeness[ray[order]], body[ray[order]] = near[order], owner[order]
        return closeness, body

    def _room(self, rays: FloatArray, pose: Pose) -> FloatArray:
        """Closeness of the room along each line; 0 where it has no face."""
        heights = self._walls @ pose.position_m - self._levels
        before = heights > 0.0
        walls = self._walls[before] @ pose.camera_from_world.T / -heights[before, None]
        nearest: FloatArray = (rays @ walls.T).max(axis=1, initial=0.0)
        return nearest

    def _faces(
        self, rays: FloatArray, pose: Pose, offsets_m: FloatArray
    ) -> tuple[FloatArray, IntArray, IntArray]:
        """Closeness, line and body of every point where a line meets a face."""
        surfaces, axes = self._surfaces, pose.camera_from_world.T
        eyes = pose.position_m - offsets_m
        to_corners = surfaces.corners_m - eyes[surfaces.face_body][:, None]
        heights = (to_corners[:, 0] * surfaces.normals).sum(axis=-1)
        seen = np.flatnonzero((heights < 0.0) & (to_corners @ axes[:, 2] > 0.0).any(axis=1))
        corners, normals = to_corners[seen] @ axes, surfaces.normals[seen] @ axes
        planes = np.cross(corners, np.roll(corners, -1, axis=1))
        planes /= np.maximum(np.sqrt((planes**2).sum(axis=-1, keepdims=True)), _NEAREST_M**2)
        face, ray = self._candidates(corners, len(rays))
        x, y, _ = rays[ray].T
        outside = np.full(len(ray), -np.inf)
        for a, b, c in planes.transpose(1, 2, 0):
            np.maximum(outside, a[face] * x + b[face] * y + c[face], out=outside)
        meets = np.flatnonzero(outside <= _ROUNDING)
        face, ray = face[meets], ray[meets]
        near = (rays[ray] * (normals / heights[seen, None])[face]).sum(axis=-1)
        return near, ray, surfaces.face_body[seen][face]

    def _candidates(self, corners: FloatArray, n_rays: int) -> tuple[IntArray, IntArray]:
        """Pairs of face and line that may meet, from the rectangles that faces fit in."""
        depth = corners[..., 2]
        flat = corners[..., :2] / np.maximum(depth, _NEAREST_M)[..., None]
        # What reaches behind the camera may be anywhere in the picture.
        whole = depth.min(axis=1, keepdims=True) <= _NEAREST_M
        low = np.where(whole, -np.inf, flat.min(axis=1)) - _ROUNDING
        high = np.where(whole, np.inf, flat.max(axis=1)) + _ROUNDING
        left, right = _within(self._columns, low[:, 0], high[:, 0])
        top, bottom = _within(self._rows, low[:, 1], high[:, 1])
        widths = right - left
        counts = widths * (bottom - top)
        face = np.repeat(np.arange(len(corners)), counts)
        number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
        row, column = np.divmod(number, widths[face])
        ray = (top[face] + row) * len(self._columns) + left[face] + column
        n_others = n_rays - len(self.grid)
        return (
            np.concatenate([face, np.repeat(np.arange(len(corners)), n_others)]),
            np.concatenate([ray, np.tile(np.arange(len(self.grid), n_rays), len(corners))]),
        )

    def _rounds(
        self, rays: FloatArray, pose: Pose, offsets_m: FloatArray
    ) -> list[tuple[FloatArray, IntArray, IntArray]]:
        """For each round body: closeness, line and body where lines meet it."""
        surfaces, hits = self._surfaces, []
        for ends, radius, owner in zip(
            surfaces.ends_m, surfaces.radii_m, surfaces.round_body, strict=True
        ):
            seen = self._camera.view(ends + offsets_m[owner], pose)
            if (seen[:, 2] < -radius).all():
                continue
            near = np.maximum(_ball(rays, seen[0], radius), _ball(rays, seen[1], radius))
            near = np.maximum(near, _tube(rays, seen, radius))
            met = np.flatnonzero(near)
            hits.append((near[met], met, np.full(len(met), owner)))
        return hits


def _within(values: FloatArray, low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """From and before which of some sorted values they lie in each of some ranges."""
    first, last = np.searchsorted(values, low), np.searchsorted(values, high, side="right")
    return first, last


def _ball(rays: FloatArray, middle: FloatArray, radius: float) -> FloatArray:
    """Closeness at which lines enter a ball; 0 for those that do not."""
    squares, along = (rays**2).sum(axis=-1), rays @ middle
    return _entry(squares, along, float(middle @ middle) - radius**2)


def _tube(rays: FloatArray, ends: FloatArray, radius: float) -> FloatArray:
    """Closeness at which lines enter the side of a cylinder; 0 for those that do not."""
    axis = ends[1] - ends[0]
    length = float(np.sqrt(axis @ axis))
    if length == 0.0:
        return np.zeros(len(rays))
    axis = axis / length
    sideways = rays - (rays @ axis)[:, None] * axis
    middle = ends[0] - (ends[0] @ axis) * axis
    squares, along = (sideways**2).sum(axis=-1), sideways @ middle
    near = _entry(squares, along, float(middle @ middle) - radius**2)
    height = np.divide(rays @ axis, near, out=np.full(len(near), -1.0), where=near > 0.0)
    height -= ends[0] @ axis
    return np.where((height >= 0.0) & (height <= length), near, 0.0)


def _entry(squares: FloatArray, along: FloatArray, power: float) -> FloatArray:
    """1 / s for the lesser solution s of a s² - 2 b s + c = 0, where it is above 0; else 0."""
    inner = along**2 - squares * power
    meets = (inner >= 0.0) & (along > 0.0) & (power > 0.0)
    root = np.sqrt(np.where(meets, inner, 0.0))
    # The lesser solution is c / (b + sqrt(b² - a c)).
    return np.where(meets, (along + root) / (power if power > 0.0 else 1.0), 0.0)
