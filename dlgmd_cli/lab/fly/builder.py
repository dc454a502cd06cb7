"""Building a model of MuJoCo: textured boxes, boards, cylinders and balls, lights and a sky."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import MjsBody, mjtGeom, mjtTexture

from dlgmd_cli.lab.fly import textures
from dlgmd_cli.lab.fly.textures import FloatArray, GreyImage, Look

# Groups of geoms: what stands still; what the flight is about; the hull of the drone.
SCENERY, TARGET, HULL = 0, 1, 4
# How many different squares a flight has of each texture.
_VARIANTS = 2
_GEOM = mjtGeom
_SKY_PX = 128


class Builder:
    """A model of MuJoCo that grows by textured boxes, boards, cylinders and balls.

    Attributes
    ----------
    spec : MjSpec
    rng : Generator
        Of everything that is drawn.
    group : int
        The group of the geoms that are added from now on.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.spec, self.rng = mujoco.MjSpec(), rng
        self.group = SCENERY
        self._named: set[str] = set()

    def body(self, name: str, at: Sequence[float] = (0, 0, 0), yaw_deg: float = 0.0) -> MjsBody:
        """A body that stands somewhere; a name that is not empty makes it one that can move."""
        turn = math.radians(yaw_deg) / 2
        quat = [math.cos(turn), 0.0, 0.0, math.sin(turn)]
        world = self.spec.worldbody
        if not name:
            return world.add_body(pos=list(at), quat=quat)
        return world.add_body(name=name, pos=list(at), quat=quat, mocap=True)

    def box(
        self,
        body: MjsBody,
        size: Sequence[float],
        at: Sequence[float],
        look: Look,
        euler: Sequence[float] = (0, 0, 0),
    ) -> None:
        """A box of a size along x, y and z about its middle; each side shows the whole texture."""
        half = [side / 2 for side in size]
        self._add(body, _GEOM.mjGEOM_BOX, half, at, self._cube(look), euler)

    def board(
        self,
        body: MjsBody,
        size: tuple[float, float],
        at: Sequence[float],
        look: Look,
        facing_deg: float = 0.0,
        *,
        once: bool = False,
    ) -> None:
        """An upright board of a width and height, seen from the direction it faces.

        The texture repeats in its own size, or covers the board `once`.
        """
        turn = np.array([0.5, 0.5, 0.5, 0.5])  # z of the board to x, its y upwards
        quat = np.zeros(4)
        half = math.radians(facing_deg) / 2
        mujoco.mju_mulQuat(quat, np.array([math.cos(half), 0, 0, math.sin(half)]), turn)
        material = self._flat(look, size if once else None)
        self._add(body, _GEOM.mjGEOM_BOX, [size[0] / 2, size[1] / 2, 0.01], at, material, quat=quat)

    def floor(
        self, body: MjsBody, size: tuple[float, float], at: Sequence[float], look: Look
    ) -> None:
        """A level slab, textured in its own size above and below."""
        half = [size[0] / 2, size[1] / 2, 0.01]
        self._add(body, _GEOM.mjGEOM_BOX, half, at, self._flat(look, None))

    def block(self, body: MjsBody, size: Sequence[float], at: Sequence[float], look: Look) -> None:
        """A large box, whose four sides are boards with the texture in its own size."""
        x, y, z = at
        for facing, across, away in ((0, 1, 0), (90, 0, 1), (180, 1, 0), (270, 0, 1)):
            turn = math.radians(facing)
            out = size[away] / 2
            place = x + out * math.cos(turn), y + out * math.sin(turn), z
            self.board(body, (size[across], size[2]), place, look, facing)
        self.floor(body, (size[0], size[1]), (x, y, z + size[2] / 2), look)

    def cylinder(
        self,
        body: MjsBody,
        radius: float,
        height: float,
        at: Sequence[float],
        look: Look,
        euler: Sequence[float] = (0, 0, 0),
    ) -> None:
        """A cylinder about its middle, upright unless turned."""
        size = [radius, height / 2, 0]
        self._add(body, _GEOM.mjGEOM_CYLINDER, size, at, self._cube(look), euler)

    def capsule(
        self,
        body: MjsBody,
        ends: tuple[Sequence[float], Sequence[float]],
        radius: float,
        look: Look,
    ) -> None:
        """A limb from one end to another."""
        geom = body.add_geom(type=_GEOM.mjGEOM_CAPSULE, size=[radius, 0, 0], group=self.group)
        geom.fromto, geom.material = [*ends[0], *ends[1]], self._cube(look)

    def ball(
        self, body: MjsBody, radii: Sequence[float] | FloatArray, at: Sequence[float], look: Look
    ) -> None:
        """An ellipsoid of radii along x, y and z."""
        self._add(body, _GEOM.mjGEOM_ELLIPSOID, list(radii), at, self._cube(look))

    def lamps(self, middle: tuple[float, float], reach: float, height: float) -> None:
        """Light of a room: two lamps on the ceiling, and what the walls throw back."""
        self.spec.visual.headlight.ambient = [0.62] * 3
        self.spec.visual.headlight.diffuse = [0.15] * 3
        x, y = middle
        for at in ((x - reach / 4, y + 0.4), (x + reach / 4, y - 0.4)):
            self.spec.worldbody.add_light(
                pos=[*at, height - 0.1], dir=[0.1, 0.05, -1], diffuse=[0.6] * 3,
                specular=[0.0] * 3, type=mujoco.mjtLightType.mjLIGHT_POINT, castshadow=False,
                attenuation=[1.0, 0.0, 0.02],
            )  # fmt: skip

    def sky(self) -> None:
        """A sky with clouds, and a sun without shadows, which would double the time."""
        v, u = np.mgrid[1 : -1 : _SKY_PX * 1j, -1 : 1 : _SKY_PX * 1j]
        one = np.ones_like(u)
        # The sides of MuJoCo's cube: right, left, up, down, front, back.
        sides = ((one, v, -u), (-one, v, u), (u, one, -v), (u, -one, v), (u, v, one), (-u, v, -one))
        waves = [(self.rng.normal(0, 2.5, 3), self.rng.uniform(0, 6.28)) for _ in range(24)]
        images = []
        for side in sides:
            direction = np.stack(side) / np.sqrt(sum(part**2 for part in side))
            clouds = sum(np.sin(np.tensordot(k, direction, 1) + phase) for k, phase in waves)
            images.append(0.72 + 0.1 * np.tanh(clouds / 5) - 0.15 * np.clip(direction[1], 0, 1))
        grey = np.clip(np.concatenate(images) * 255, 0, 255).astype(np.uint8)
        self._image("sky", mjtTexture.mjTEXTURE_SKYBOX, grey)
        self.spec.visual.headlight.ambient = [0.6] * 3
        self.spec.visual.headlight.diffuse = [0.1] * 3
        direction = [*self.rng.uniform(-0.7, 0.7, 2), -1.0]
        self.spec.worldbody.add_light(
            pos=[-12 * d for d in direction], dir=direction, diffuse=[0.65] * 3,
            specular=[0.0] * 3, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False,
        )  # fmt: skip

    def _add(
        self,
        body: MjsBody,
        kind: mjtGeom,
        size: list[float],
        at: Sequence[float],
        material: str,
        euler: Sequence[float] = (0, 0, 0),
        quat: FloatArray | None = None,
    ) -> None:
        geom = body.add_geom(
            type=kind, size=size, pos=list(at), material=material, group=self.group
        )
        if quat is not None:
            geom.quat = quat
        elif any(euler):
            geom.alt.euler = [math.radians(angle) for angle in euler]

    def _texture(self, name: str, *, cube: bool) -> str:
        """A square of a texture, drawn when it is first used."""
        full = f"{name}-{self.rng.integers(_VARIANTS)}{'-cube' * cube}"
        if full not in self._named:
            self._named.add(full)
            image = textures.drawn(name, self.rng)
            if cube:  # smaller, and the same on each side
                image = np.concatenate([image[::2, ::2]] * 6)
            kind = mjtTexture.mjTEXTURE_CUBE if cube else mjtTexture.mjTEXTURE_2D
            self._image(full, kind, image)
        return full

    def _image(self, name: str, kind: mjtTexture, grey: GreyImage) -> None:
        height, width = grey.shape
        texture = self.spec.add_texture(
            name=name, type=kind, nchannel=3, height=height, width=width
        )
        texture.data = np.repeat(grey[:, :, None], 3, axis=2).tobytes()

    def _cube(self, look: Look) -> str:
        return self._material(self._texture(look.texture, cube=True), look, None)

    def _flat(self, look: Look, size: tuple[float, float] | None) -> str:
        metres = textures.TEXTURES[look.texture][1]
        # MuJoCo counts repeats per half of a unit.
        repeat = (2 / metres, 2 / metres) if size is None else (2 / size[0], 2 / size[1])
        return self._material(self._texture(look.texture, cube=False), look, repeat)

    def _material(self, texture: str, look: Look, repeat: tuple[float, float] | None) -> str:
        name = f"{texture} {look.shade:.3f} {repeat}"
        if name not in self._named:
            self._named.add(name)
            shade = look.shade
            material = self.spec.add_material(
                name=name, rgba=[shade, shade, shade, 1], specular=0.0, shininess=0.0,
                texuniform=repeat is not None, texrepeat=list(repeat or (1.0, 1.0)),
            )  # fmt: skip
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture
        return name
