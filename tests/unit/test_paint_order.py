"""Furnished rooms are painted in an order in which nothing shows through what hides it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dlgmd_cli.flights.places import indoor, obstacles, seats
from dlgmd_cli.flights.places.rooms import Hall
from dlgmd_cli.flights.renderer.camera import Camera, Pose, rotation
from dlgmd_cli.flights.renderer.painter import Renderer
from dlgmd_cli.flights.renderer.solids import Solid, World, quad
from dlgmd_cli.flights.renderer.texture import Texture
from dlgmd_cli.flights.renderer.visibility import Order

CAMERA = Camera((90, 150), 80.0)
N_VIEWS = 3


def toned(body, tone):
    """A body whose faces all have one tone of light."""
    texture = Texture(np.float32(tone))
    return Solid(body.name, [replace(face, texture=texture, gain=1.0) for face in body.faces])


def first_met(bodies, pose):
    """The number of the body that is met first from the middle of each pixel; 0 for none."""
    height, width = CAMERA.shape
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = CAMERA.rays(np.stack([columns, rows], -1), pose)
    nearest, number = np.full(CAMERA.shape, np.inf), np.zeros(CAMERA.shape)
    for index, body in enumerate(bodies, 1):
        for face in body.faces:
            above = (pose.position_m - face.corners_m[0]) @ face.normal
            towards = -rays @ face.normal
            if above <= 0.0 or not (towards > 0.0).any():
                continue
            depth = above / np.where(towards > 0.0, towards, np.nan)
            points = pose.position_m + depth[..., None] * rays
            meets = depth < nearest - 1e-6
            ends = np.roll(face.corners_m, -1, axis=0)
            for corner, inwards in zip(
                face.corners_m, np.cross(face.normal, ends - face.corners_m), strict=True
            ):
                meets &= (points - corner) @ inwards >= 0.0
            nearest[meets], number[meets] = depth[meets], index
    return number


def n_wrong(picture, expected):
    """How many pixels have exactly the tone of a body that is not the one seen there.

    Where several bodies are near, a pixel may show a sliver of one that its middle misses.
    """
    around = np.ones((3, 3), np.uint8)
    is_inner = cv2.dilate(expected, around) == cv2.erode(expected, around)
    tone = np.round(picture)
    return int((is_inner & (np.abs(picture - tone) < 0.002) & (tone != expected)).sum())


@pytest.mark.parametrize("name", ["cluttered_room", "two_rooms", "pillared_room"])
def test_every_body_hides_what_is_behind_it(name, monkeypatch):
    monkeypatch.setattr(indoor, "room", lambda *_, **__: Solid("room", []))
    rng = np.random.default_rng(7)
    guests = [
        *(part for x in (2.3, 3.8) for y in (-0.6, 0.6) for part in seats.chair((x, y), 190.0 * x)),
        *obstacles.carton_on_stool(rng, (5.2, -0.5), 200.0),
        *obstacles.notebook_on_table(rng, (8.5, 0.4), 170.0),
    ]
    bodies = [*getattr(indoor, name)(rng, length_m=12.0, guests=guests).bodies, *guests]
    black = Texture(np.float32(0.0))
    walls = Hall((14.0, 8.0, 4.0)).walls().values()
    room = Solid("room", [quad(wall.origin_m, wall.right_m, wall.down_m, black) for wall in walls])
    painted = [toned(body, number) for number, body in enumerate(bodies, 1)]
    renderer = Renderer(World(room, painted), CAMERA)
    assert Order(bodies).is_exact
    total = 0
    for _ in range(N_VIEWS):
        at = rng.uniform((0.5, -0.9, 0.3), (6.0, 0.9, 2.0))
        pose = Pose(at, rotation(*rng.uniform(-15, 15, 2), rng.uniform(-40, 40)))
        expected = first_met(bodies, pose)
        assert len(np.unique(expected)) > 5
        total += n_wrong(renderer.render(pose), expected)
    assert total <= 3
