"""Building a model of MuJoCo: textured boxes, boards, cylinders and balls, lights and a sky."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import MjsBody, mjtGeom, mjtLightType, mjtTexture

from dlgmd_cli.lab.fly import textures
from dlgmd_cli.lab.fly.textures import FloatArray, Look

# Groups of geoms: what stands still; what the flight is about; the hull of the drone.
SCENERY, TARGET, HULL = 0, 1, 4
# How many different squares a flight has of each texture.
_VARIANTS = 2
Size = Sequence[float] | FloatArray


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

    def part(self, name: str = "", at: Sequence[float] = (0, 0, 0), yaw_deg: float = 0.0) -> "Part":
        """A body that stands somewhere; one with a name can move."""
        world = self.spec.worldbody
        if not name:
            return Part(self, world.add_body(pos=list(at), quat=turned(yaw_deg)))
        return Part(self, world.add_body(name=name, pos=list(at), mocap=True))

    def lamps(self, middle: tuple[float, float], reach: float, height: float) -> None:
        """Light of a room: two lamps on the ceiling, and what the walls throw back."""
        self.spec.visual.headlight.ambient = [0.62] * 3
        self.spec.visual.headlight.diffuse = [0.15] * 3
        x, y = middle
        for at in ((x - reach / 4, y + 0.4), (x + reach / 4, y - 0.4)):
            place = (*at, height - 0.1)
            self._light(mjtLightType.mjLIGHT_POINT, place, (0.1, 0.05, -1), 0.6, 0.02)

    def sky(self) -> None:
        """An even sky, and a sun."""
        self.spec.add_texture(
            name="sky", type=mjtTexture.mjTEXTURE_SKYBOX, width=128, height=768,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=[0.6] * 3, rgb2=[0.85] * 3,
        )  # fmt: skip
        self.spec.visual.headlight.ambient = [0.6] * 3
        self.spec.visual.headlight.diffuse = [0.1] * 3
        direction = [*self.rng.uniform(-0.7, 0.7, 2), -1.0]
        place = [-12 * d for d in direction]
        self._light(mjtLightType.mjLIGHT_DIRECTIONAL, place, direction, 0.65, 0.0)

    def _light(self, kind: mjtLightType, at: Size, way: Size, level: float, fading: float) -> None:
        """A light without gloss and shadows, which would double the time."""
        self.spec.worldbody.add_light(
            type=kind, pos=list(at), dir=list(way), diffuse=[level] * 3, specular=[0.0] * 3,
            castshadow=False, attenuation=[1.0, 0.0, fading],
        )  # fmt: skip

    def _texture(self, name: str, *, cube: bool) -> str:
        """A square of a texture, drawn when it is first used."""
        full = f"{name}-{self.rng.integers(_VARIANTS)}{'-cube' * cube}"
        if full not in self._named:
            self._named.add(full)
            image = textures.drawn(name, self.rng)
            if cube:  # smaller, and the same on each side
                image = np.concatenate([image[::2, ::2]] * 6)
            kind = mjtTexture.mjTEXTURE_CUBE if cube else mjtTexture.mjTEXTURE_2D
            height, width = image.shape
            texture = self.spec.add_texture(
                name=full, type=kind, nchannel=3, height=height, width=width
            )
            texture.data = np.repeat(image[:, :, None], 3, axis=2).tobytes()
        return full

    def cube(self, look: Look) -> str:
        """The name of a material that shows a whole texture on each side."""
        return self._material(self._texture(look.texture, cube=True), look, None)

    def flat(self, look: Look, size: Size) -> str:
        """The name of one that repeats in its own size, or covers a `size` once."""
        metres = textures.TEXTURES[look.texture][1]
        # MuJoCo counts repeats per half of a unit.
        repeat = (2 / size[0], 2 / size[1]) if look.once else (2 / metres, 2 / metres)
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


class Part:
    """A body of the model; its shapes are placed by their middles, in m from its origin.

    Attributes
    ----------
    body : MjsBody
    rng : Generator
        That of the builder.
    """

    def __init__(self, builder: Builder, body: MjsBody) -> None:
        self._builder, self.body, self.rng = builder, body, builder.rng

    def box(self, size: Size, at: Size, look: Look, yaw_deg: float = 0.0) -> None:
        """A box of a size along x, y and z; each side shows the whole texture."""
        half = [side / 2 for side in size]
        self._add(mjtGeom.mjGEOM_BOX, half, at, self._builder.cube(look), turned(yaw_deg))

    def board(self, size: Size, at: Size, look: Look, facing_deg: float = 0.0) -> None:
        """An upright board of a width and height, seen from the direction it faces."""
        quat, upright = np.zeros(4), np.array([0.5, 0.5, 0.5, 0.5])  # z to x, y upwards
        mujoco.mju_mulQuat(quat, np.array(turned(facing_deg)), upright)
        material = self._builder.flat(look, size)
        half = [size[0] / 2, size[1] / 2, 0.01]
        self._add(mjtGeom.mjGEOM_BOX, half, at, material, quat.tolist())

    def floor(self, size: Size, at: Size, look: Look) -> None:
        """A level slab, textured in its own size above and below."""
        half = [size[0] / 2, size[1] / 2, 0.01]
        self._add(mjtGeom.mjGEOM_BOX, half, at, self._builder.flat(look, size))

    def block(self, size: Size, at: Size, look: Look) -> None:
        """A large box, whose four sides are boards with the texture in its own size."""
        x, y, z = at
        for facing, across, away in ((0, 1, 0), (90, 0, 1), (180, 1, 0), (270, 0, 1)):
            turn, out = math.radians(facing), size[away] / 2
            place = x + out * math.cos(turn), y + out * math.sin(turn), z
            self.board((size[across], size[2]), place, look, facing)
        self.floor((size[0], size[1]), (x, y, z + size[2] / 2), look)

    def cylinder(
        self, radius: float, height: float, at: Size, look: Look, *, lies: bool = False
    ) -> None:
        """A cylinder, upright, or along y."""
        quat = [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0] if lies else turned(0.0)
        size = [radius, height / 2, 0]
        self._add(mjtGeom.mjGEOM_CYLINDER, size, at, self._builder.cube(look), quat)

    def limb(self, start: Size, end: Size, radius: float, look: Look) -> None:
        """A capsule from one end to another."""
        self._add(mjtGeom.mjGEOM_CAPSULE, [radius, 0, 0], (0, 0, 0), self._builder.cube(look))
        self.body.geoms[-1].fromto = [*start, *end]

    def ball(self, radii: Size, at: Size, look: Look) -> None:
        """An ellipsoid of radii along x, y and z."""
        self._add(mjtGeom.mjGEOM_ELLIPSOID, list(radii), at, self._builder.cube(look))

    def _add(
        self, kind: mjtGeom, size: list[float], at: Size, material: str, quat: Size = (1, 0, 0, 0)
    ) -> None:
        self.body.add_geom(
            type=kind, size=size, pos=list(at), quat=list(quat), material=material,
            group=self._builder.group,
        )  # fmt: skip


def turned(yaw_deg: float) -> list[float]:
    """The quaternion of a turn about z."""
    half = math.radians(yaw_deg) / 2
    return [math.cos(half), 0.0, 0.0, math.sin(half)]
