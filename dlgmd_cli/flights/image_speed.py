"""How fast what is seen moves in the picture."""

import numpy as np

from dlgmd_cli.flights.extent import Extent
from dlgmd_cli.flights.path import State
from dlgmd_cli.flights.renderer.camera import Camera, FloatArray
from dlgmd_cli.flights.renderer.solids import IntArray, Surfaces, World
from dlgmd_cli.flights.sightlines import Sightlines

# A point is hidden by what is nearer by more than this share.
_HIDES = 1e-6
# Points on the outline of a ball.
_N_AROUND = 8


class ImageSpeed:
    """The speed of the fastest point in the picture.

    Looked at are the crossings of a grid, with its rim on the picture's, and what can be seen of
    the target's corners and of the outlines of its round parts.

    Parameters
    ----------
    world : World
    camera : Camera
    target : str, optional
        Name of the bodies that are the target.
    """

    def __init__(self, world: World, camera: Camera, target: str | None = None) -> None:
        self._surfaces = Surfaces(world.bodies)
        self._camera, self._lines = camera, Sightlines(self._surfaces, world.room, camera)
        marks = Extent(self._surfaces)
        names = [body.name for body in world.bodies]
        of_target = np.array([names[body] == target for body in marks.body], bool)
        self._marks = marks.points_m[of_target]
        self._mark_body, self._mark_radii = marks.body[of_target], marks.radii_m[of_target]

    def fastest(self, state: State, time_s: float) -> float:
        """In px/s, of the points that a camera in this state sees at a time."""
        pose, offsets = state.pose, self._surfaces.offsets(time_s)
        marks, mark_body = self._marked(state, offsets)
        rays = np.concatenate([self._lines.grid, marks / marks[:, 2:]])
        closeness, body = self._lines.cast(rays, pose, offsets)
        n_lines = len(self._lines.grid)
        own = 1.0 / marks[:, 2]
        shown = closeness[n_lines:] <= own * (1.0 + _HIDES)
        closeness[n_lines:], body[n_lines:] = np.where(shown, own, 0.0), mark_body
        axes = pose.camera_from_world.T
        # The last one is the room's, which rests.
        velocities = np.concatenate([self._surfaces.velocities(time_s), np.zeros((1, 3))])
        speeds = (velocities - state.velocity_m_s) @ axes
        flow = _flow(rays, closeness, speeds[body], state.angular_velocity_rad_s @ axes)
        seen = closeness > 0.0
        fastest = np.sqrt((flow[seen] ** 2).sum(axis=-1)).max(initial=0.0)
        return float(self._camera.focal_px * fastest)

    def _marked(self, state: State, offsets_m: FloatArray) -> tuple[FloatArray, IntArray]:
        """The target's points that may be seen, as the camera has them, and whose they are."""
        pose = state.pose
        at = self._camera.view(self._marks + offsets_m[self._mark_body], pose)
        is_round = self._mark_radii > 0.0
        points, bodies = [at[~is_round]], [self._mark_body[~is_round]]
        for middle, radius, body in zip(
            at[is_round], self._mark_radii[is_round], self._mark_body[is_round], strict=True
        ):
            points.append(_outline(middle, radius))
            bodies.append(np.full(len(points[-1]), body))
        found, owners = np.concatenate(points), np.concatenate(bodies)
        ahead = found[:, 2] > 0.0
        found, owners = found[ahead], owners[ahead]
        reach = self._camera.middle_xy / self._camera.focal_px
        framed = (np.abs(found[:, :2] / found[:, 2:]) <= reach).all(axis=-1)
        return found[framed], owners[framed]


def max_image_speed(
    world: World, camera: Camera, state: State, time_s: float, target: str | None = None
) -> float:
    """The speed of the fastest point in the picture, in px/s; see `ImageSpeed`."""
    return ImageSpeed(world, camera, target).fastest(state, time_s)


def _flow(
    rays: FloatArray, closeness: FloatArray, speeds: FloatArray, spin: FloatArray
) -> FloatArray:
    """How fast x / z and y / z change, (n, 2), in 1/s.

    Parameters
    ----------
    rays : ndarray, shape (n, 3)
        Directions with z = 1.
    closeness : ndarray, shape (n,)
        1 / z.
    speeds : ndarray, shape (n, 3)
        Of the points, relative to the camera, along its axes.
    spin : ndarray, shape (3,)
        Angular velocity of the camera about its axes.
    """
    moves = speeds * closeness[:, None] - np.cross(spin, rays)
    flow: FloatArray = moves[:, :2] - rays[:, :2] * moves[:, 2:]
    return flow


def _outline(middle: FloatArray, radius: float) -> FloatArray:
    """Points of a ball where sight from the origin touches it, and the nearest one, (n, 3)."""
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
