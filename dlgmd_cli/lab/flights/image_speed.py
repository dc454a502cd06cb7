"""Image speed: how fast the scene moves in the picture."""

import numpy as np

from dlgmd_cli.lab.flights.geometry import AngularExtent
from dlgmd_cli.lab.flights.path import State
from dlgmd_cli.lab.flights.renderer.camera import Camera, FloatArray, Pose
from dlgmd_cli.lab.flights.renderer.solids import IntArray, Surfaces, World
from dlgmd_cli.lab.flights.renderer.visibility import is_outside

# Cells of the grid of viewing rays, which spans the picture.
_N_COLUMNS, _N_ROWS = 64, 36
# Tolerance for a ray that hits the edge between two faces.
_ROUNDING = 1e-9
_LEAST = 1e-12
# Relative tolerance in depth when deciding whether a point is hidden.
_HIDES = 1e-6
# Points on the outline of a ball.
_N_AROUND = 8


class ImageSpeed:
    """The greatest image speed over sample points.

    The points are the nodes of a grid over the picture, and the visible corners of the target and
    points on the outlines of its round parts.
    """

    def __init__(self, world: World, camera: Camera, target: str | None = None) -> None:
        self.surfaces = Surfaces([*world.bodies, world.room])
        self._camera = camera
        half_width, half_height = camera.middle_xy / camera.focal_px
        x, y = np.meshgrid(
            np.linspace(-half_width, half_width, _N_COLUMNS + 1),
            np.linspace(-half_height, half_height, _N_ROWS + 1),
        )
        self.grid = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
        marks = AngularExtent(Surfaces(world.bodies))
        of_target = np.array([world.bodies[i].name == target for i in marks.body], bool)
        self._marks, self._radii = marks.points_m[of_target], marks.radii_m[of_target]
        self._mark_body = marks.body[of_target]

    def fastest(self, state: State, time_s: float) -> float:
        """The greatest image speed, in px/s, for a camera in this state at a time."""
        pose, offsets = state.pose, self.surfaces.offsets(time_s)
        marks, mark_body = self._marked(state, offsets)
        rays = np.concatenate([self.grid, marks / marks[:, 2:]])
        closeness, body = self.cast(rays, pose, offsets)
        n_lines = len(self.grid)
        own = 1.0 / marks[:, 2]
        shown = closeness[n_lines:] <= own * (1.0 + _HIDES)
        closeness[n_lines:], body[n_lines:] = np.where(shown, own, 0.0), mark_body
        axes = pose.camera_from_world.T
        speeds = (self.surfaces.velocities(time_s) - state.velocity_m_s) @ axes
        spin = state.angular_velocity_rad_s @ axes
        # Rates of change of x / z and y / z, in 1/s.
        moves = speeds[body] * closeness[:, None] - np.cross(spin, rays)
        flow = moves[:, :2] - rays[:, :2] * moves[:, 2:]
        seen = closeness > 0.0
        fastest = np.sqrt((flow[seen] ** 2).sum(axis=-1)).max(initial=0.0)
        return float(self._camera.focal_px * fastest)

    def cast(
        self, rays: FloatArray, pose: Pose, offsets_m: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Find the nearest body along rays, (n, 3), in camera axes with forward component 1.

        The bodies have moved by (n_bodies, 3) m. Returns 1 / depth, (n,) in 1/m, and the indices of
        the bodies in `surfaces`, where the last one is the room. Both are 0 for rays without a hit.
        """
        surfaces, axes = self.surfaces, pose.camera_from_world.T
        closeness, body = np.zeros(len(rays)), np.zeros(len(rays), np.intp)
        eyes = pose.position_m - offsets_m
        corners = (surfaces.corners_m - eyes[surfaces.face_body][:, None]) @ axes
        normals = surfaces.normals @ axes
        heights = (corners[:, 0] * normals).sum(axis=-1)
        chosen = np.flatnonzero((heights < 0.0) & ~is_outside(self._camera, corners))
        corners, planes = corners[chosen], normals[chosen] / heights[chosen, None]
        # Planes through the camera and each side; positive outside the face.
        sides = np.cross(corners, np.roll(corners, -1, axis=1))
        sides /= np.maximum(np.sqrt((sides**2).sum(axis=-1, keepdims=True)), _LEAST)
        columns = np.ascontiguousarray(rays.T)
        hits = [
            (np.where((side @ columns).max(axis=0) <= _ROUNDING, plane @ columns, 0.0), owner)
            for side, plane, owner in zip(sides, planes, surfaces.face_body[chosen], strict=True)
        ]
        for ends, radius, owner in zip(
            surfaces.ends_m, surfaces.radii_m, surfaces.capsule_body, strict=True
        ):
            seen = self._camera.view(ends + offsets_m[owner], pose)
            if (seen[:, 2] >= -radius).any():
                hits.append((_capsule(rays, seen, radius), owner))
        for near, owner in hits:
            body[near > closeness] = owner
            np.maximum(closeness, near, out=closeness)
        return closeness, body

    def _marked(self, state: State, offsets_m: FloatArray) -> tuple[FloatArray, IntArray]:
        """The target's points inside the picture, in camera axes, and their bodies."""
        at = self._camera.view(self._marks + offsets_m[self._mark_body], state.pose)
        outlines = [
            _outline(middle, radius) for middle, radius in zip(at, self._radii, strict=True)
        ]
        found = np.concatenate([np.empty((0, 3)), *outlines])
        owners = np.repeat(self._mark_body, [len(outline) for outline in outlines])
        ahead = found[:, 2] > 0.0
        found, owners = found[ahead], owners[ahead]
        reach = self._camera.middle_xy / self._camera.focal_px
        framed = (np.abs(found[:, :2] / found[:, 2:]) <= reach).all(axis=-1)
        return found[framed], owners[framed]


def _outline(middle: FloatArray, radius: float) -> FloatArray:
    """Points on the outline of a ball seen from the origin, and its nearest point, (n, 3)."""
    if radius == 0.0:
        return middle[None]
    distance = float(np.sqrt(middle @ middle))
    if distance <= radius:
        return np.empty((0, 3))
    towards = middle / distance
    aside = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    aside /= np.sqrt(aside @ aside)
    angles = np.arange(_N_AROUND) * (2.0 * np.pi / _N_AROUND)
    ring = np.cos(angles)[:, None] * aside + np.sin(angles)[:, None] * np.cross(towards, aside)
    share = radius / distance
    rim = (distance - radius * share) * towards + radius * np.sqrt(1.0 - share**2) * ring
    return np.concatenate([rim, (middle - radius * towards)[None]])


def _capsule(rays: FloatArray, ends: FloatArray, radius: float) -> FloatArray:
    """1 / depth at which rays enter a capsule; 0 for those that miss it."""
    balls = [_entry((rays**2).sum(axis=-1), rays @ end, end @ end - radius**2) for end in ends]
    near = np.maximum(*balls)
    axis = ends[1] - ends[0]
    length = float(np.sqrt(axis @ axis))
    if length == 0.0:
        return near
    axis = axis / length
    sideways = rays - (rays @ axis)[:, None] * axis
    middle = ends[0] - (ends[0] @ axis) * axis
    squares, along = (sideways**2).sum(axis=-1), sideways @ middle
    tube = _entry(squares, along, middle @ middle - radius**2)
    height = np.divide(rays @ axis, tube, out=np.full(len(tube), -1.0), where=tube > 0.0)
    height -= ends[0] @ axis
    return np.maximum(near, np.where((height >= 0.0) & (height <= length), tube, 0.0))


def _entry(squares: FloatArray, along: FloatArray, power: float) -> FloatArray:
    """1 / s for the smaller solution s of a s² - 2 b s + c = 0 if it is positive, else 0."""
    inner = along**2 - squares * power
    meets = (inner >= 0.0) & (along > 0.0) & (power > 0.0)
    root = np.sqrt(np.where(meets, inner, 0.0))
    # The smaller solution is c / (b + sqrt(b² - a c)).
    return np.where(meets, (along + root) / (power if power > 0.0 else 1.0), 0.0)
