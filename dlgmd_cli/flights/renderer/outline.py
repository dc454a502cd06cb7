"""What of a face or a round body is in sight: a polygon in the picture, and a plane behind it."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from dlgmd_cli.flights.renderer.camera import Camera, FloatArray, Pose
from dlgmd_cli.flights.renderer.solids import Round
from dlgmd_cli.flights.renderer.texture import Texture

# Nothing nearer than this is drawn; a lens could not focus on it either.
NEAR_M = 0.01
# By how much a polygon of corners may miss a circle.
_ROUNDNESS_PX = 0.05
_MAX_CORNERS = 360
# A face whose plane passes this close to the camera is a line.
EDGE_ON_M = 1e-9


@dataclass(frozen=True)
class Outline:
    """A convex polygon of the picture, and the textured plane that is seen through it.

    Attributes
    ----------
    corners_xy : ndarray, shape (n, 2)
        In px, clockwise on the screen.
    plane : ndarray, shape (3,)
        1 / depth at the point (x, y) of the picture is ``plane @ (x, y, 1)``, in 1/m.
    distance_m : float
        From the camera to the plane.
    texture_from_xy : ndarray, shape (3, 3)
        Homography from (x, y, 1) to the texture, whose width and height are 1.
    texels_per_m : float
        Resolution of the texture, along its finer side.
    texture : Texture
    gain : float
        See `Face`.
    """

    corners_xy: FloatArray
    plane: FloatArray
    distance_m: float
    texture_from_xy: FloatArray
    texels_per_m: float
    texture: Texture
    gain: float

    @cached_property
    def inverse_depths(self) -> tuple[float, float]:
        """1 / depth of its farthest and its nearest corner, in 1/m."""
        inverse = self.corners_xy @ self.plane[:2] + self.plane[2]
        return float(inverse.min()), float(inverse.max())


def outline_round(body: Round, camera: Camera, pose: Pose) -> Outline | None:
    """The outline of a capsule or a ball: around the circles where sight touches its end balls.

    Its texture stands upright along it, and faces the camera.
    """
    ends = camera.view(body.ends_m, pose)
    along = ends[1] - ends[0]
    if _is_inside(ends[0], along, body.radius_m):
        return None
    circles = [_touching_circle(end, body.radius_m, camera) for end in ends]
    clipped = _before_near(np.concatenate(circles))
    if len(clipped) < 3:
        return None
    points = to_picture(clipped, camera)
    # What OpenCV calls counter-clockwise has y upwards.
    hull = cv2.convexHull(points.astype(np.float32), clockwise=False)
    if hull is None or len(hull) < 3:
        return None  # too far to be more than a point
    middle = ends.mean(axis=0)
    right, up = _upright(middle, along, body.radius_m, pose)
    # Of a ball near the camera, less than the half is seen: the picture fills what is seen.
    distance = math.sqrt(middle @ middle)
    share = math.sqrt(max(1.0 - (body.radius_m / distance) ** 2, 1e-6))
    radius = body.radius_m * share
    toward = middle / distance * (body.radius_m**2 / distance)
    half_height = up * (abs(along @ up) / 2.0 + radius)
    origin = middle - toward - right * radius + half_height
    normal = np.cross(right, up)
    distance = float(normal @ origin)
    if abs(distance) < EDGE_ON_M:
        return None
    rays = camera.rays_from_xy
    width, height = 2.0 * radius, 2.0 * math.sqrt(half_height @ half_height)
    rows = [
        (distance * axis - (axis @ origin) * normal) / side
        for axis, side in ((right, width), (-up, height))
    ]
    n_rows, n_columns = body.texture.image.shape
    return Outline(
        hull[:, 0].astype(np.float64),
        normal @ rays / distance,
        abs(distance),
        np.array([*rows, normal]) @ rays,
        max(n_columns / width, n_rows / height),
        body.texture,
        body.gain,
    )


def clip_near(seen: FloatArray) -> FloatArray:
    """The part of a polygon, (n, 3), that is `NEAR_M` or more in front of the camera."""
    depths = seen[:, 2]
    if depths.min() >= NEAR_M:
        return seen
    kept: list[FloatArray] = []
    for here, there in zip(seen, np.roll(seen, -1, axis=0), strict=True):
        if here[2] >= NEAR_M:
            kept.append(here)
        if (here[2] >= NEAR_M) != (there[2] >= NEAR_M):
            share = (NEAR_M - here[2]) / (there[2] - here[2])
            kept.append(here + share * (there - here))
    return np.array(kept).reshape(-1, 3)


def to_picture(seen: FloatArray, camera: Camera) -> FloatArray:
    """Points in front of the camera, (n, 3), to px, (n, 2)."""
    flat: FloatArray = camera.middle_xy + camera.focal_px * seen[:, :2] / seen[:, 2:]
    return flat


def _is_inside(end: FloatArray, along: FloatArray, radius: float) -> bool:
    """Whether the camera is in a capsule that begins at a point and reaches along a vector."""
    square = float(along @ along)
    share = min(max(-float(end @ along) / square, 0.0), 1.0) if square else 0.0
    nearest = end + share * along
    return float(nearest @ nearest) <= radius * radius


def _upright(
    middle: FloatArray, along: FloatArray, radius: float, pose: Pose
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the right and up, as somebody has them who looks at a round body."""
    right, up = np.cross(middle, along), along
    if right @ right <= radius**2 * (along @ along):
        # A ball, or a capsule of which only one tip is seen: what looks up there is up.
        axes = pose.camera_from_world
        for upwards in (axes[:, 2], axes[:, 0]):
            right = np.cross(middle, upwards)
            if right @ right > 1e-12 * (middle @ middle):
                break
        up = np.cross(right, middle)
    return right / math.sqrt(right @ right), up / math.sqrt(up @ up)


def _before_near(points: FloatArray) -> FloatArray:
    """Points, (n, 3), whose hull is the part of that of others that `clip_near` would keep."""
    is_near = points[:, 2] < NEAR_M
    if not is_near.any():
        return points
    far, near = points[~is_near, None], points[is_near]
    share = (NEAR_M - far[..., 2:]) / (near[:, 2:] - far[..., 2:])
    return np.concatenate([far[:, 0], (far + share * (near - far)).reshape(-1, 3)])


def _touching_circle(center: FloatArray, radius: float, camera: Camera) -> FloatArray:
    """Where sight touches a ball from outside: a circle, as a polygon around it."""
    square = float(center @ center)
    distance = math.sqrt(square)
    toward = center / distance
    across = np.cross(toward, np.array([0.0, 1.0, 0.0] if abs(toward[1]) < 0.9 else [1.0, 0.0, 0]))
    across /= math.sqrt(across @ across)
    down = np.cross(toward, across)
    radius_px = camera.focal_px * radius / max(distance - radius, NEAR_M)
    wanted = math.pi * math.sqrt(radius_px / (2.0 * _ROUNDNESS_PX))
    n_corners = int(min(max(wanted, 16), _MAX_CORNERS))
    angles = np.arange(n_corners) * (2.0 * math.pi / n_corners)
    seen_radius = radius * math.sqrt(1.0 - radius * radius / square)
    # Half of the polygon's error inside the circle, half of it outside.
    seen_radius *= 2.0 / (1.0 + math.cos(math.pi / n_corners))
    circle: FloatArray = toward * (distance - radius * radius / distance) + seen_radius * (
        np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * down
    )
    return circle
