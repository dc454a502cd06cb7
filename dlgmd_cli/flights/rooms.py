"""Furnished rooms to fly through; one flies along x, which runs through the middle of the floor.

In all of them `guests` are bodies that the flight is about. They are not among the bodies of the
place; nothing is put where they are, and those at rest cast their shadows on the floor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from dlgmd_cli.flights import textures
from dlgmd_cli.flights.bodies import spot
from dlgmd_cli.flights.furniture import catalogue, furniture_at_wall
from dlgmd_cli.flights.pictures import ceiling_panels
from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body, Solid, quad
from dlgmd_cli.flights.renderer.texture import FloatImage, Texture
from dlgmd_cli.flights.textures import Rng, limited

_WALL_PX_PER_M, _FLOOR_PX_PER_M, _CEILING_PX_PER_M = 250.0, 200.0, 120.0
_GAINS = {"near": 0.82, "far": 0.85, "left": 0.9, "right": 0.78, "floor": 0.95, "ceiling": 0.85}
# What stands along the walls, by the name that the catalogue has for it.
_CLUTTER = (
    *("bookcase", "desk", "window", "sofa", "cupboard", "stools", "cartons", "bookcase", "door"),
    *("sideboard", "bookcase", "window", "desk", "poster"),
)
_LITTLE = ("window", "door", "cupboard", "poster", "stools", "window", "poster", "sideboard")
_END = ("bookcase", "poster", "cupboard", "door", "cartons", "poster")
_FLAT = ("poster", "door", "window")
_SPACE_M = 0.02  # between two things
_AXES = np.vstack([np.eye(3), -np.eye(3)])
# Of shadows: their resolution; the share of the light that a thing takes away where it touches,
# how fast that fades with the distance, and how far it reaches.
_SHADE_PX_M = 40.0
_DEEPEST = 0.6
_FADE_M = 0.25
_FARTHEST_M = 0.9


@dataclass(frozen=True)
class Wall:
    """A rectangle seen from inside a room, as `Face` has it."""

    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return float(np.linalg.norm(self.right_m)), float(np.linalg.norm(self.down_m))

    def seen(self, points_m: FloatArray) -> FloatArray:
        """Points as (right, down, how far in front of it), from its top left corner, in m."""
        width, height = self.size_m
        right, down = self.right_m / width, self.down_m / height
        axes = np.array([right, down, np.cross(down, right)])
        placed: FloatArray = (points_m - self.origin_m) @ axes.T
        return placed


@dataclass(frozen=True)
class Hall:
    """The inside of a room: x from 0 to its length, y from -width/2 to width/2, z from 0.

    `size_m` is its length, width and height.
    """

    size_m: tuple[float, float, float]

    def walls(self) -> dict[str, Wall]:
        """Its sides: "near" (at x = 0), "far", "left" (towards y), "right", "floor", "ceiling"."""
        length, width, height = self.size_m
        half = width / 2
        sides = {
            "near": ((0, -half, height), (0, width, 0), (0, 0, -height)),
            "far": ((length, half, height), (0, -width, 0), (0, 0, -height)),
            "left": ((0, half, height), (length, 0, 0), (0, 0, -height)),
            "right": ((length, -half, height), (-length, 0, 0), (0, 0, -height)),
            "floor": ((0, half, 0), (length, 0, 0), (0, -width, 0)),
            "ceiling": ((0, -half, height), (length, 0, 0), (0, width, 0)),
        }
        return {
            side: Wall(*(np.array(each, float) for each in lines)) for side, lines in sides.items()
        }

    def stand(self, side: str, along_m: float, off_m: float) -> tuple[tuple[float, float], float]:
        """Where a thing is `off_m` in front of a wall, and the yaw with which it has it behind.

        `along_m` is x on the "left" and "right" wall and y on the "near" and "far" one.
        """
        length, width, _ = self.size_m
        return {
            "near": ((off_m, along_m), 0.0),
            "far": ((length - off_m, along_m), 180.0),
            "left": ((along_m, width / 2 - off_m), -90.0),
            "right": ((along_m, off_m - width / 2), 90.0),
        }[side]


# What the sides of a room are called as targets, in the order of `Hall.walls`.
SIDES = ("wall", "wall", "wall", "wall", "floor", "ceiling")


@dataclass(frozen=True)
class Place:
    """A room of some size with its walls, as `World` has them, and what stands in it."""

    hall: Hall
    room: Solid
    bodies: list[Body] = field(default_factory=list)


def shaded(image: FloatImage, wall: Wall, bodies: Sequence[Body]) -> FloatImage:
    """The picture of a wall, darker near its edges and behind what is close to it.

    What moves casts no shadow.
    """
    width, height = wall.size_m
    shape = (
        max(2, math.ceil(height * _SHADE_PX_M)),
        max(2, math.ceil(width * _SHADE_PX_M)),
    )
    light = np.outer(_edges(shape[0], height), _edges(shape[1], width)).astype(np.float32)
    for body in bodies:
        if isinstance(body, Solid) and body.motion is None:
            _darken(light, wall.seen(body.corners_m))
    full: FloatImage = image * cv2.resize(light, image.shape[::-1]).reshape(image.shape)
    return full


def _edges(count: int, length_m: float) -> FloatArray:
    """How bright it is along a side between two corners."""
    at = (np.arange(count) + 0.5) * length_m / count
    bright: FloatArray = 1.0 - 0.22 * (np.exp(-at / 0.3) + np.exp((at - length_m) / 0.3))
    return bright


def _darken(light: FloatImage, corners_m: FloatArray) -> None:
    """Take away the light behind a body whose corners are as `Wall.seen` has them."""
    nearest = float(corners_m[:, 2].min())
    if nearest > _FARTHEST_M:
        return
    hull = cv2.convexHull((corners_m[:, :2] * _SHADE_PX_M).astype(np.float32))
    sigma = (0.03 + 0.3 * nearest) * _SHADE_PX_M
    rim = math.ceil(3.0 * sigma) + 1
    x, y, width, height = cv2.boundingRect(hull)
    left, top = max(0, x - rim), max(0, y - rim)
    around = light[top : max(0, y + height + rim), left : max(0, x + width + rim)]
    if not around.size:
        return
    # Filled with room to spare, so that a shadow at the picture's edge is not half as deep there.
    shadow = np.zeros((around.shape[0] + 2 * rim, around.shape[1] + 2 * rim), np.float32)
    points = np.round(16.0 * (hull - 0.5 + (rim - left, rim - top))).astype(np.int32)
    cv2.fillPoly(shadow, [points], 1.0, shift=4)
    soft = cv2.GaussianBlur(shadow, (0, 0), sigma)[rim:-rim, rim:-rim]
    around *= 1.0 - _DEEPEST * math.exp(-nearest / _FADE_M) * soft


def room(
    hall: Hall,
    rng: Rng,
    *,
    wall: str = "plaster",
    floor: str = "parquet",
    lamps: tuple[int, int] = (4, 2),
    bodies: Sequence[Body] = (),
) -> Solid:
    """Walls, floor and ceiling, with the soft shadows of `bodies` that stand in front of them.

    `wall` is plaster or brick, `floor` is parquet or carpet; there are so many columns, along x,
    and rows of `lamps` in the ceiling. The faces are in the order of `Hall.walls`.
    """
    tone = rng.uniform(0.4, 0.7)
    faces = []
    for side, seen in hall.walls().items():
        if side == "floor":
            image = getattr(textures, floor)(rng, seen.size_m, _FLOOR_PX_PER_M)
        elif side == "ceiling":
            image = ceiling_panels(rng, seen.size_m, _CEILING_PX_PER_M, lamps=lamps)
        else:
            image = _wall(rng, wall, seen, tone)
        picture = Texture(limited(shaded(image, seen, bodies)))
        faces.append(quad(seen.origin_m, seen.right_m, seen.down_m, picture, _GAINS[side]))
    return Solid("room", faces)


def _wall(rng: Rng, material: str, seen: Wall, tone: float) -> FloatImage:
    """A wall with its skirting board."""
    image = getattr(textures, material)(rng, seen.size_m, _WALL_PX_PER_M, tone)
    board = round(0.08 * image.shape[0] / seen.size_m[1])
    image[-board:] = 0.22
    image[-board : 2 - board] = 0.5
    image[-board - 2 : -board] *= 0.6
    return image


@dataclass
class Furnishing:
    """What is put in a room so far, clear of `guests` that stand there already."""

    hall: Hall
    guests: Sequence[Body] = ()
    bodies: list[Body] = field(default_factory=list)

    def add(self, bodies: Sequence[Body]) -> bool:
        """Add a thing if all of it is clear of all others and inside the room; say whether."""
        if not all(self._is_free(body.reach(_AXES)) for body in bodies):
            return False
        self.bodies += bodies
        return True

    def line(
        self,
        rng: Rng,
        side: str,
        names: Sequence[str],
        span_m: tuple[float, float],
        *,
        depth_m: float,
        gap_m: tuple[float, float] = (0.1, 0.4),
    ) -> None:
        """Put things along a wall from one end of a span to the other, as far as they go.

        The names are what the catalogue has `at_walls`, in their order along the wall. What reaches
        farther into the room than `depth_m` is left out. Gaps have a least and a greatest width.
        """
        at, end = span_m
        for name in names:
            entry = catalogue()["at_walls"][name]
            half, deep = entry["width_m"] / 2, entry["depth_m"]
            if deep > depth_m or at + 2 * half > end:
                continue
            # What finds its place taken tries farther on.
            for middle in np.arange(at + half, end - half, 0.3).tolist():
                # Things are drawn as they are made, which takes long: first see whether they fit.
                if self._is_free(self._ground(side, middle, half, deep / 2)) and self.add(
                    furniture_at_wall(name, rng, spot(*self.hall.stand(side, middle, 0.0)))
                ):
                    at = middle + half + rng.uniform(*gap_m)
                    break

    def finished(self, rng: Rng, wall: str, lamps: tuple[int, int] | None = None) -> Place:
        """The room with all that was put in it."""
        inside = room(
            self.hall,
            rng,
            wall=wall,
            floor=str(rng.choice(["parquet", "carpet"])),
            lamps=lamps or (max(1, round(self.hall.size_m[0] / 2.5)), 2),
            bodies=[*self.guests, *self.bodies],
        )
        return Place(self.hall, inside, self.bodies)

    def _is_free(self, box_m: FloatArray) -> bool:
        """Whether a box, (6,), by its reach along `_AXES`, is inside the room and clear of all."""
        length, width, height = self.hall.size_m
        most = np.array([length, width / 2, height, 0.0, width / 2, 0.0])
        others = (body.reach(_AXES) for body in (*self.guests, *self.bodies))
        return bool((box_m <= most + 1e-9).all()) and not any(_meet(box_m, o) for o in others)

    def _ground(self, side: str, along_m: float, half_m: float, deep: float) -> FloatArray:
        """The box, from floor to ceiling, that a thing takes at a wall; see `_is_free`."""
        (x, y), yaw_deg = self.hall.stand(side, along_m, deep)
        dx, dy = (deep, half_m) if yaw_deg % 180.0 == 0.0 else (half_m, deep)
        return np.array([x + dx, y + dy, self.hall.size_m[2], dx - x, dy - y, 0.0])


def _meet(one: FloatArray, other: FloatArray) -> bool:
    """Whether the boxes around two bodies, by their reach along `_AXES`, nearly meet."""
    gaps = np.concatenate([one[:3] + other[3:], other[:3] + one[3:]])
    return bool((gaps > -_SPACE_M).all())


def cluttered_room(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 5.6,
    free_width_m: float = 2.4,
    end_m: float = 1.1,
    guests: Sequence[Body] = (),
) -> Place:
    """A room full of furniture along its walls.

    No furniture is within half of `free_width_m` from the x axis, but at the far wall, where it
    reaches `end_m` into the room.
    """
    furnishing = Furnishing(Hall((length_m, width_m, 2.8)), guests)
    depth, half_m = (width_m - free_width_m) / 2, width_m / 2
    ends = list(rng.permutation(_END))
    furnishing.line(rng, "far", ends, (0.05 - half_m, half_m - 0.05), depth_m=end_m)
    names = list(rng.permutation(_CLUTTER))
    half = len(names) // 2
    for side, share in (("left", names[:half]), ("right", names[half:])):
        # Posters come last: they fill what is left of the wall.
        share = [*share, *("poster",) * 4]
        furnishing.line(rng, side, share, (0.3, length_m - 0.1), depth_m=depth)
    near = list(rng.permutation(_FLAT))
    furnishing.line(rng, "near", near, (0.1 - half_m, half_m - 0.1), depth_m=0.2)
    return furnishing.finished(rng, str(rng.choice(["brick", "plaster", "plaster"])))


def simple_room(
    rng: Rng, *, length_m: float, width_m: float = 5.0, guests: Sequence[Body] = ()
) -> Place:
    """A room with a few things 1.3 m or more from the x axis; its far wall is bare."""
    furnishing = Furnishing(Hall((length_m, width_m, 2.8)), guests)
    names = list(rng.permutation(_LITTLE))
    for side, share in (("left", names[::2]), ("right", names[1::2])):
        span = (rng.uniform(0.3, 1.0), length_m - 0.3)
        depth_m = width_m / 2 - 1.3
        furnishing.line(rng, side, share, span, depth_m=depth_m, gap_m=(0.3, 1.2))
    furnishing.line(rng, "near", ["door"], (-1.5, 1.5), depth_m=0.2)
    return furnishing.finished(rng, "plaster")


def corridor(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 2.2,
    height_m: float = 2.6,
    guests: Sequence[Body] = (),
) -> Place:
    """A long and narrow place with doors and posters on both sides and lamps along it."""
    furnishing = Furnishing(Hall((length_m, width_m, height_m)), guests)
    for side, start in (("left", 0.4), ("right", 1.4)):
        names = [str(rng.choice(["door", "door", "poster"])) for _ in range(int(length_m))]
        furnishing.line(rng, side, names, (start, length_m - 0.2), depth_m=0.1, gap_m=(0.5, 1.3))
    for side in ("far", "near"):
        furnishing.line(rng, side, ["door"], (-width_m / 2, width_m / 2), depth_m=0.1)
    lamps = (max(1, round(length_m / 2.4)), 1)
    return furnishing.finished(rng, "plaster", lamps)
