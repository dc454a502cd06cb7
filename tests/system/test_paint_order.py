"""Furnished rooms are painted in an order in which nothing shows through what hides it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from bodies import are_apart, rays_of

from dlgmd_cli.scenes.flights.camera import Camera, Pose, rotation
from dlgmd_cli.scenes.flights.painter import Renderer
from dlgmd_cli.scenes.flights.scenes import SCENES
from dlgmd_cli.scenes.flights.solids import Solid, Texture, World

pytestmark = pytest.mark.slow

CAMERA = Camera((90, 150), 80.0)
N_VIEWS = 4


def toned(body, tone):
    """A body whose faces all have one tone of light."""
    texture = Texture(np.float32(tone))
    return Solid(body.name, [replace(face, texture=texture, gain=1.0) for face in body.faces])


def first_met(bodies, pose):
    """The number of the body that is met first from the middle of each pixel; 0 for none."""
    height, width = CAMERA.shape
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = rays_of(CAMERA, np.stack([columns, rows], -1), pose)
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


@pytest.mark.parametrize("name", ["group1", "group3", "past-pillar", "random"])
def test_every_body_hides_what_is_behind_it(name):
    scene, rng = SCENES[name], np.random.default_rng(7)
    stage = scene.stage(scene.configure({"seed": 3}))
    bodies = [body for body in stage.world.bodies if isinstance(body, Solid)]
    assert are_apart(bodies)
    room = toned(stage.world.room, 0)
    painted = [toned(body, number) for number, body in enumerate(bodies, 1)]
    renderer = Renderer(World(room, painted), CAMERA)
    total = 0
    for time_s in np.linspace(0.0, stage.duration_s, N_VIEWS):
        state = stage.path.state(time_s)
        turn = rotation(*rng.uniform(-15, 15, 2), state.yaw_deg + rng.uniform(-40, 40))
        pose = Pose(state.position_m, turn)
        expected = first_met(bodies, pose)
        assert len(np.unique(expected)) > 2
        total += n_wrong(renderer.render(pose), expected)
    assert total <= 3
