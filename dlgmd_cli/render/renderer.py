"""A world as a camera sees it, in linear light."""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.render.camera import Camera, Pose
from dlgmd_cli.render.order import Order
from dlgmd_cli.render.outline import Outline, outline_round
from dlgmd_cli.render.paint import paint
from dlgmd_cli.render.sight import Sight
from dlgmd_cli.render.solids import Body, Round, Solid, World
from dlgmd_cli.render.texture import FloatImage


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
        self._moving = [i for i, body in enumerate(world.bodies) if body.motion is not None]
        self._sight = Sight(
            [
                body.faces if isinstance(body, Solid) and body.motion is None else ()
                for body in world.bodies
            ]
        )

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
        for index in self._moving:
            self._bodies[index] = _at(self.world.bodies[index], time_s)
            self._order.move(index, self._bodies[index])
        for index, body in enumerate(self._bodies):
            if isinstance(body, Round):
                outline = outline_round(body, self.camera, pose)
                if outline is not None:
                    found[index] = [outline]
            elif isinstance(body, Solid) and index in self._moving:
                outlines = Sight([body.faces]).outlines(self.camera, pose)
                if outlines:
                    found[index] = outlines[0]
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
    if body.motion is None:
        return body
    return body.moved(np.asarray(body.motion(time_s), float))
