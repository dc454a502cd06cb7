"""Projection of the visible parts of a world to outlines, and the order to paint them in."""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights.camera import Camera, Pose
from dlgmd_cli.scenes.flights.solids import Body, Capsule, IntArray, Outline, Surfaces, box_of

# Near plane; a lens could not focus at this distance either.
_NEAR_M = 0.01
# Greatest deviation of a polygon from the circle it stands for.
_ROUNDNESS_PX = 0.05
_MAX_CORNERS = 360
# A face is seen edge-on if its plane passes this close to the camera.
_EDGE_ON_M = 1e-9
# Bodies may overlap by this much and still count as apart.
_TOUCHING_M = 1e-6


def is_outside(camera: Camera, seen: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether each face, (n, n_corners, 3), is entirely beyond one border of the image."""
    right, down = camera.middle_xy / camera.focal_px
    x, y, depth = np.moveaxis(seen, -1, 0)
    wide, high = right * depth, down * depth
    beyond = np.array([x - wide, -x - wide, y - high, -y - high, _NEAR_M - depth])
    return np.asarray((beyond >= 0.0).all(axis=2).any(axis=0), np.bool_)


def visible_outlines(
    surfaces: Surfaces, camera: Camera, pose: Pose, offsets_m: FloatArray
) -> dict[int, list[Outline]]:
    """The outlines of the visible bodies, by index, displaced by (n_bodies, 3) m."""
    outlines: dict[int, list[Outline]] = {}
    # Instead of moving the bodies, move the camera the other way.
    eyes = pose.position_m - offsets_m
    seen = (surfaces.corners_m - eyes[surfaces.face_body][:, None]) @ pose.camera_from_world.T
    origins = surfaces.origins_m - eyes[surfaces.face_body]
    heights = (surfaces.normals * origins).sum(axis=1)  # of the faces above the camera
    chosen = np.flatnonzero((heights < -_EDGE_ON_M) & ~is_outside(camera, seen))
    heights, normals, shares = heights[chosen], surfaces.normals[chosen], surfaces.shares[chosen]
    rays = pose.camera_from_world.T @ camera.rays_from_xy
    planes = normals @ rays / heights[:, None]
    along = (shares * origins[chosen, None]).sum(axis=2)
    rows = heights[:, None, None] * shares - along[:, :, None] * normals[:, None]
    from_xy = np.concatenate([rows, normals[:, None]], axis=1) @ rays
    for place, index in enumerate(chosen):
        face = surfaces.faces[index]
        corners = _clip_near(seen[index, : len(face.corners_m)])
        if len(corners) < 3:
            continue
        outline = Outline(
            corners_xy=camera.flatten(corners)[::-1],
            plane=planes[place],
            distance_m=-float(heights[place]),
            texture_from_xy=from_xy[place],
            texels_per_m=face.texels_per_m,
            texture=face.texture,
            gain=face.gain,
        )
        outlines.setdefault(int(surfaces.face_body[index]), []).append(outline)
    for index, body in zip(surfaces.capsule_body.tolist(), surfaces.capsules, strict=True):
        round_one = _outline_round(body, camera, Pose(eyes[index], pose.rotation))
        if round_one is not None:
            outlines[index] = [round_one]
    return outlines


def _clip_near(seen: FloatArray) -> FloatArray:
    """The part of a polygon, (n, 3), beyond the near plane."""
    if seen[:, 2].min() >= _NEAR_M:
        return seen
    kept: list[FloatArray] = []
    for here, there in zip(seen, np.roll(seen, -1, axis=0), strict=True):
        if here[2] >= _NEAR_M:
            kept.append(here)
        if (here[2] >= _NEAR_M) != (there[2] >= _NEAR_M):
            share = (_NEAR_M - here[2]) / (there[2] - here[2])
            kept.append(here + share * (there - here))
    return np.array(kept).reshape(-1, 3)


def _outline_round(body: Capsule, camera: Camera, pose: Pose) -> Outline | None:
    """The outline of a capsule; its texture is aligned with it and faces the camera."""
    ends = camera.view(body.ends_m, pose)
    along = ends[1] - ends[0]
    square = float(along @ along)
    share = min(max(-float(ends[0] @ along) / square, 0.0), 1.0) if square else 0.0
    nearest = ends[0] + share * along
    if float(nearest @ nearest) <= body.radius_m * body.radius_m:
        return None  # the camera is inside
    circles = [_touching_circle(end, body.radius_m, camera) for end in ends]
    clipped = _before_near(np.concatenate(circles))
    if len(clipped) < 3:
        return None
    # OpenCV's orientation assumes that y points up.
    hull = cv2.convexHull(camera.flatten(clipped).astype(np.float32), clockwise=False)
    if hull is None or len(hull) < 3:
        return None  # so far away that it is only a point
    middle = ends.mean(axis=0)
    right, up = _upright(middle, along, body.radius_m, pose)
    # Less than half of a nearby ball is visible: the texture fills the visible part.
    distance = math.sqrt(middle @ middle)
    share = math.sqrt(max(1.0 - (body.radius_m / distance) ** 2, 1e-6))
    radius = body.radius_m * share
    toward = middle / distance * (body.radius_m**2 / distance)
    half_height = up * (abs(along @ up) / 2.0 + radius)
    origin = middle - toward - right * radius + half_height
    normal = np.cross(right, up)
    distance = float(normal @ origin)
    if abs(distance) < _EDGE_ON_M:
        return None
    rays = camera.rays_from_xy
    width, height = 2.0 * radius, 2.0 * math.sqrt(half_height @ half_height)
    rows = [
        (distance * axis - (axis @ origin) * normal) / side
        for axis, side in ((right, width), (-up, height))
    ]
    n_rows, n_columns = body.texture.image.shape
    return Outline(
        corners_xy=hull[:, 0].astype(np.float64),
        plane=normal @ rays / distance,
        distance_m=abs(distance),
        texture_from_xy=np.array([*rows, normal]) @ rays,
        texels_per_m=max(n_columns / width, n_rows / height),
        texture=body.texture,
        gain=body.gain,
    )


def _upright(
    middle: FloatArray, along: FloatArray, radius: float, pose: Pose
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the right of a capsule and up along it, as seen by the camera."""
    right, up = np.cross(middle, along), along
    if right @ right <= radius**2 * (along @ along):
        # For a ball or a capsule seen end-on, up is the world's up.
        axes = pose.camera_from_world
        for upwards in (axes[:, 2], axes[:, 0]):
            right = np.cross(middle, upwards)
            if right @ right > 1e-12 * (middle @ middle):
                break
        up = np.cross(right, middle)
    return right / math.sqrt(right @ right), up / math.sqrt(up @ up)


def _before_near(points: FloatArray) -> FloatArray:
    """Clip the convex hull of points, (n, 3), at the near plane; returns points with that hull."""
    is_near = points[:, 2] < _NEAR_M
    if not is_near.any():
        return points
    far, near = points[~is_near, None], points[is_near]
    share = (_NEAR_M - far[..., 2:]) / (near[:, 2:] - far[..., 2:])
    return np.concatenate([far[:, 0], (far + share * (near - far)).reshape(-1, 3)])


def _touching_circle(center: FloatArray, radius: float, camera: Camera) -> FloatArray:
    """The circle where rays from the camera are tangent to a ball, as a polygon, (n, 3)."""
    square = float(center @ center)
    distance = math.sqrt(square)
    toward = center / distance
    across = np.cross(toward, np.array([0.0, 1.0, 0.0] if abs(toward[1]) < 0.9 else [1.0, 0.0, 0]))
    across /= math.sqrt(across @ across)
    down = np.cross(toward, across)
    radius_px = camera.focal_px * radius / max(distance - radius, _NEAR_M)
    wanted = math.pi * math.sqrt(radius_px / (2.0 * _ROUNDNESS_PX))
    n_corners = int(min(max(wanted, 16), _MAX_CORNERS))
    angles = np.arange(n_corners) * (2.0 * math.pi / n_corners)
    seen_radius = radius * math.sqrt(1.0 - radius * radius / square)
    # The polygon deviates equally to the inside and the outside of the circle.
    seen_radius *= 2.0 / (1.0 + math.cos(math.pi / n_corners))
    return toward * (distance - radius * radius / distance) + seen_radius * (
        np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * down
    )


class PaintOrder:
    """The order to paint bodies in, so that each covers those behind it.

    If a plane separates two bodies, the one on the far side of it cannot hide the other. Planes
    along the axes are tried first, then planes along the faces of both. Where bodies intersect, or
    hide each other in a cycle, the one with the farther centre is painted first.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        n = len(bodies)
        self._bodies = list(bodies)
        boxes = np.array([box_of(body) for body in bodies]).reshape(-1, 2, 3)
        self._low, self._high = boxes[:, 0], boxes[:, 1]
        # For bodies i and j: normal and offset of up to four planes with i behind and j in front,
        # one along each axis, or one along a face; zeros for none.
        self._planes = np.zeros((n, n, 4, 4))
        for i in range(n):
            self._separate(i, np.arange(i + 1, n))

    def move(self, index: int, body: Body) -> None:
        """Replace the body with that index."""
        self._bodies[index] = body
        self._low[index], self._high[index] = box_of(body)
        others = np.arange(len(self._bodies))
        self._separate(index, others[others != index])

    def back_to_front(
        self, eye_m: FloatArray, extents: Mapping[int, tuple[float, float, float, float]]
    ) -> list[int]:
        """Indices of the bodies in `extents`, farthest first, as seen from a point, (3,).

        `extents` holds left, top, right and bottom of each body in the image. Bodies that do not
        overlap there may come in any order.
        """
        indices = np.array(list(extents), int)
        middles = (self._low[indices] + self._high[indices]) / 2.0
        distances = np.sqrt(((middles - eye_m) ** 2).sum(axis=1))
        planes = self._planes[np.ix_(indices, indices)]
        # If the camera is in front of a plane, the first body is behind it.
        is_behind = (planes[..., :3] @ eye_m > planes[..., 3]).any(axis=2)
        is_cut = ~planes.any(axis=(2, 3))
        is_behind |= is_cut & (distances[:, None] > distances[None, :])
        # If two bodies are each behind the other, by different planes, neither hides the other.
        left, top, right, bottom = np.array(list(extents.values())).reshape(-1, 4).T
        overlaps = (left[:, None] < right) & (top[:, None] < bottom)
        hides = is_behind & ~is_behind.T & overlaps & overlaps.T
        return [int(indices[place]) for place in _sorted(hides, distances)]

    def _separate(self, index: int, others: IntArray) -> None:
        """Find the planes that separate a body from others."""
        low, high = self._low[index], self._high[index]
        is_less = high <= self._low[others] + _TOUCHING_M
        is_more = low >= self._high[others] - _TOUCHING_M
        signs = is_less.astype(float) - is_more
        levels = np.where(is_less, high + self._low[others], low + self._high[others]) / 2.0
        planes = np.zeros((len(others), 4, 4))
        planes[:, :3, :3] = signs[:, :, None] * np.eye(3)
        planes[:, :3, 3] = signs * levels
        for place in np.flatnonzero(~signs.any(axis=1)):
            other = self._bodies[others[place]]
            planes[place, 3] = separating_plane(self._bodies[index], other) or 0.0
        self._planes[index, others], self._planes[others, index] = planes, -planes


def separating_plane(body: Body, other: Body) -> tuple[float, float, float, float] | None:
    """Normal and offset of a plane with `body` behind it and `other` in front; None without one."""
    (low, high), (low2, high2) = box_of(body), box_of(other)
    line = (low2 + high2 - low - high) / 2.0
    length = float(np.linalg.norm(line))
    candidates = [body.normals, -body.normals, other.normals, -other.normals]
    if length > 0.0 and not (len(body.normals) and len(other.normals)):
        candidates.append(line[None] / length)
    normals = np.concatenate(candidates)
    if not len(normals):
        return None
    ends, begins = body.reach(normals), -other.reach(-normals)
    best = int(np.argmax(begins - ends))
    if begins[best] - ends[best] < -_TOUCHING_M:
        return None
    x, y, z = normals[best].tolist()
    return x, y, z, float(ends[best] + begins[best]) / 2.0


def _sorted(behind: npt.NDArray[np.bool_], distances: FloatArray) -> list[int]:
    """Indices sorted so that j comes after every i with `behind[i, j]`."""
    n_behind = behind.sum(axis=0)
    is_left = np.ones(len(distances), bool)
    order = []
    while is_left.any():
        free = is_left & (n_behind == 0)
        picks = np.flatnonzero(free if free.any() else is_left)
        pick = int(picks[np.argmax(distances[picks])])
        order.append(pick)
        is_left[pick] = False
        n_behind = n_behind - behind[pick]
    return order
