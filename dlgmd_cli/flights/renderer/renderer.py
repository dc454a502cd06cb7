"""A world as a camera sees it, in linear light."""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.renderer.camera import Camera, FloatArray, Pose
from dlgmd_cli.flights.renderer.order import Order
from dlgmd_cli.flights.renderer.outline import Outline, outline_round
from dlgmd_cli.flights.renderer.paint import paint
from dlgmd_cli.flights.renderer.sight import Sight
from dlgmd_cli.flights.renderer.solids import Body, Face, Round, Solid, World
from dlgmd_cli.flights.renderer.texture import FloatImage


class Renderer:
    """Paints a world from any pose, at any time.

    Every face is drawn by its exact homography, far ones first; pixels on an edge know what share
    of them is covered, and textures are sampled at the size that they are seen at.

    Parameters
    ----------
    world : World
    camera : Camera
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera
        self._room = Sight([world.room.faces])
        self._bodies = placed(world, 0.0)
        self._order = Order(self._bodies)
        self._sight = Sight([_faces(body) if body.motion is None else () for body in world.bodies])
        self._moving = {
            index: Sight([_faces(body)])
            for index, body in enumerate(world.bodies)
            if body.motion is not None
        }

    def render(
        self, pose: Pose, time_s: float = 0.0, rows: tuple[int, int] | None = None
    ) -> FloatImage:
        """The picture at a time: (H, W) float32, the light that comes from each pixel.

        A white surface in ordinary light is 1.

        Parameters
        ----------
        pose : Pose
        time_s : float
            When, for what moves and for the light.
        rows : (int, int), optional
            The first row and the one after the last: only they are painted and returned.
        """
        rows = rows or (0, self.camera.shape[0])
        painted = [*self._room.outlines(self.camera, pose).values()]
        outlines_of = self._outlines(pose, time_s)
        extents = {index: _extent(outlines) for index, outlines in outlines_of.items()}
        for index in self._order.back_to_front(pose.position_m, extents):
            painted.append(outlines_of[index])
        picture = paint(painted, self.camera, rows)
        light = self.world.light(time_s)
        if light != 1.0:
            picture *= np.float32(light)
        return picture

    def _outlines(self, pose: Pose, time_s: float) -> dict[int, list[Outline]]:
        """What is in sight, by the index of the body."""
        found = self._sight.outlines(self.camera, pose)
        for index, sight in self._moving.items():
            body = self.world.bodies[index]
            by_m = _moved_by(body, time_s)
            self._bodies[index] = body.moved(by_m)
            self._order.move(index, self._bodies[index])
            # What has moved looks as it did at rest from where the camera would be then.
            seen = sight.outlines(self.camera, Pose(pose.position_m - by_m, pose.rotation))
            if seen:
                found[index] = seen[0]
        for index, body in enumerate(self._bodies):
            if isinstance(body, Round):
                outline = outline_round(body, self.camera, pose)
                if outline is not None:
                    found[index] = [outline]
        return found


def _extent(outlines: Sequence[Outline]) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of what is seen of a body."""
    corners = np.concatenate([outline.corners_xy for outline in outlines])
    (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return left, top, right, bottom


def placed(world: World, time_s: float) -> list[Body]:
    """The bodies of a world where they are at a time."""
    return [_at(body, time_s) for body in world.bodies]


def _at(body: Body, time_s: float) -> Body:
    """A body where it is at a time."""
    return body if body.motion is None else body.moved(_moved_by(body, time_s))


def _moved_by(body: Body, time_s: float) -> FloatArray:
    """How far a body has moved at a time, (3,) in m."""
    return np.zeros(3) if body.motion is None else np.asarray(body.motion(time_s), float)


def _faces(body: Body) -> Sequence[Face]:
    """The planar faces of a body."""
    return body.faces if isinstance(body, Solid) else ()
