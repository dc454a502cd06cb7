"""Furnished rooms to fly through, along the x axis in the middle of the floor.

In all functions, `obstacles` are the bodies that a flight hits or passes. They are not part of the
furniture. Furniture is placed clear of them, and those at rest cast shadows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from dlgmd_cli.lab.flights import textures
from dlgmd_cli.lab.flights.bodies import placement
from dlgmd_cli.lab.flights.furniture import catalogue, furniture_at_wall
from dlgmd_cli.lab.flights.pictures import ceiling_panels
from dlgmd_cli.lab.flights.renderer.camera import FloatArray
from dlgmd_cli.lab.flights.renderer.solids import Body, Solid, quad
from dlgmd_cli.lab.flights.renderer.texture import FloatImage, Texture
from dlgmd_cli.lab.flights.textures import Rng, reflectance

_WALL_PX_PER_M, _FLOOR_PX_PER_M, _CEILING_PX_PER_M = 250.0, 200.0, 120.0
_GAINS = {"near": 0.82, "far": 0.85, "left": 0.9, "right": 0.78, "floor": 0.95, "ceiling": 0.85}
# Furniture along the walls, by its name in the catalogue.
_CLUTTER = (
    *("bookcase", "desk", "window", "sofa", "cupboard", "stools", "cartons", "bookcase", "door"),
    *("sideboard", "bookcase", "window", "desk", "poster"),
)
_LITTLE = ("window", "door", "cupboard", "poster", "stools", "window", "poster", "sideboard")
_END = ("bookcase", "poster", "cupboard", "door", "cartons", "poster")
_FLAT = ("poster", "door", "window")
_SPACE_M = 0.02  # least distance between two pieces
_AXES = np.vstack([np.eye(3), -np.eye(3)])
# Shadows: resolution, share of the light lost at the point of contact, decay with distance, and
# range.
_SHADE_PX_M = 40.0
_DEEPEST = 0.6
_FADE_M = 0.25
_FARTHEST_M = 0.9


@dataclass(frozen=True)
class Wall:
    """A side of a room seen from inside; origin, right and down are as in `Face`."""

    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return float(np.linalg.norm(self.right_m)), float(np.linalg.norm(self.down_m))

    def seen(self, points_m: FloatArray) -> FloatArray:
        """Points as (right, down, distance in front), relative to the top left corner, in m."""
        width, height = self.size_m
        right, down = self.right_m / width, self.down_m / height
        axes = np.array([right, down, np.cross(down, right)])
        relative: FloatArray = (points_m - self.origin_m) @ axes.T
        return relative


@dataclass(frozen=True)
class Interior:
    """The interior of a room: x from 0 to its length, y from -width/2 to width/2, z from 0.

    `size_m` is (length, width, height).
    """

    size_m: tuple[float, float, float]

    def walls(self) -> dict[str, Wall]:
        """The sides: "near" (at x = 0), "far", "left" (towards +y), "right", "floor", "ceiling"."""
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
        """Position `off_m` in front of a wall, and the yaw of a piece with its back to the wall.

        `along_m` is x on the "left" and "right" wall and y on the "near" and "far" one.
        """
        length, width, _ = self.size_m
        return {
            "near": ((off_m, along_m), 0.0),
            "far": ((length - off_m, along_m), 180.0),
            "left": ((along_m, width / 2 - off_m), -90.0),
            "right": ((along_m, off_m - width / 2), 90.0),
        }[side]


# Names of the sides of a room as targets, in the order of `Interior.walls`.
SIDES = ("wall", "wall", "wall", "wall", "floor", "ceiling")


@dataclass(frozen=True)
class FurnishedRoom:
    """A room with its furniture; `room` holds the walls as in `World`."""

    interior: Interior
    room: Solid
    bodies: list[Body] = field(default_factory=list)


def shaded(image: FloatImage, wall: Wall, bodies: Sequence[Body]) -> FloatImage:
    """The picture of a wall, darker near its edges and behind nearby bodies.

    Moving bodies cast no shadow.
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
    """Brightness along a side, darker near its two ends."""
    at = (np.arange(count) + 0.5) * length_m / count
    bright: FloatArray = 1.0 - 0.22 * (np.exp(-at / 0.3) + np.exp((at - length_m) / 0.3))
    return bright


def _darken(light: FloatImage, corners_m: FloatArray) -> None:
    """Darken the wall behind a body whose corners are given as by `Wall.seen`."""
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
    # With a margin: without it, the blur would weaken a shadow at the picture's edge.
    shadow = np.zeros((around.shape[0] + 2 * rim, around.shape[1] + 2 * rim), np.float32)
    points = np.round(16.0 * (hull - 0.5 + (rim - left, rim - top))).astype(np.int32)
    cv2.fillPoly(shadow, [points], 1.0, shift=4)
    soft = cv2.GaussianBlur(shadow, (0, 0), sigma)[rim:-rim, rim:-rim]
    around *= 1.0 - _DEEPEST * math.exp(-nearest / _FADE_M) * soft


def room(
    interior: Interior,
    rng: Rng,
    *,
    wall: str = "plaster",
    floor: str = "parquet",
    lamps: tuple[int, int] = (4, 2),
    bodies: Sequence[Body] = (),
) -> Solid:
    """Walls, floor and ceiling, with soft shadows of `bodies`.

    `wall` is plaster or brick, `floor` is parquet or carpet, and `lamps` is the number of lamps
    along x and along y. The faces are in the order of `Interior.walls`.
    """
    tone = rng.uniform(0.4, 0.7)
    faces = []
    for side, seen in interior.walls().items():
        if side == "floor":
            image = getattr(textures, floor)(rng, seen.size_m, _FLOOR_PX_PER_M)
        elif side == "ceiling":
            image = ceiling_panels(rng, seen.size_m, _CEILING_PX_PER_M, lamps=lamps)
        else:
            image = _wall(rng, wall, seen, tone)
        picture = Texture(reflectance(shaded(image, seen, bodies)))
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
    """A room while it is being furnished, clear of `obstacles`."""

    interior: Interior
    obstacles: Sequence[Body] = ()
    bodies: list[Body] = field(default_factory=list)

    def add(self, bodies: Sequence[Body]) -> bool:
        """Add a piece if it fits into the room, clear of all others; returns whether it does."""
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
        """Place furniture along a wall, from one end of a span to the other.

        The names are those under `at_walls` in the catalogue, in order. Pieces that are deeper than
        `depth_m`, or too wide for the rest of the span, are skipped. Gaps between pieces are drawn
        from the range `gap_m`.
        """
        at, end = span_m
        for name in names:
            entry = catalogue()["at_walls"][name]
            half, deep = entry["width_m"] / 2, entry["depth_m"]
            if deep > depth_m or at + 2 * half > end:
                continue
            # If a position is taken, try farther along the wall.
            for middle in np.arange(at + half, end - half, 0.3).tolist():
                # Creating furniture is slow, since its textures are drawn: first check the space.
                if self._is_free(self._ground(side, middle, half, deep / 2)) and self.add(
                    furniture_at_wall(name, rng, placement(*self.interior.stand(side, middle, 0.0)))
                ):
                    at = middle + half + rng.uniform(*gap_m)
                    break

    def finished(self, rng: Rng, wall: str, lamps: tuple[int, int] | None = None) -> FurnishedRoom:
        """The furnished room."""
        inside = room(
            self.interior,
            rng,
            wall=wall,
            floor=str(rng.choice(["parquet", "carpet"])),
            lamps=lamps or (max(1, round(self.interior.size_m[0] / 2.5)), 2),
            bodies=[*self.obstacles, *self.bodies],
        )
        return FurnishedRoom(self.interior, inside, self.bodies)

    def _is_free(self, box_m: FloatArray) -> bool:
        """Whether a box is inside the room and clear of all bodies; (6,), its reach on `_AXES`."""
        length, width, height = self.interior.size_m
        most = np.array([length, width / 2, height, 0.0, width / 2, 0.0])
        others = (body.reach(_AXES) for body in (*self.obstacles, *self.bodies))
        return bool((box_m <= most + 1e-9).all()) and not any(_meet(box_m, o) for o in others)

    def _ground(self, side: str, along_m: float, half_m: float, deep: float) -> FloatArray:
        """The box from floor to ceiling that a piece at a wall occupies; see `_is_free`."""
        (x, y), yaw_deg = self.interior.stand(side, along_m, deep)
        dx, dy = (deep, half_m) if yaw_deg % 180.0 == 0.0 else (half_m, deep)
        return np.array([x + dx, y + dy, self.interior.size_m[2], dx - x, dy - y, 0.0])


def _meet(one: FloatArray, other: FloatArray) -> bool:
    """Whether two boxes, given by their reach on `_AXES`, are closer than `_SPACE_M`."""
    gaps = np.concatenate([one[:3] + other[3:], other[:3] + one[3:]])
    return bool((gaps > -_SPACE_M).all())


def cluttered_room(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 5.6,
    free_width_m: float = 2.4,
    end_m: float = 1.1,
    obstacles: Sequence[Body] = (),
) -> FurnishedRoom:
    """A room full of furniture along its walls.

    A strip of `free_width_m` along the x axis stays free, except at the far wall, where furniture
    may be `end_m` deep.
    """
    furnishing = Furnishing(Interior((length_m, width_m, 2.8)), obstacles)
    depth, half_m = (width_m - free_width_m) / 2, width_m / 2
    ends = list(rng.permutation(_END))
    furnishing.line(rng, "far", ends, (0.05 - half_m, half_m - 0.05), depth_m=end_m)
    names = list(rng.permutation(_CLUTTER))
    half = len(names) // 2
    for side, share in (("left", names[:half]), ("right", names[half:])):
        # Posters come last, to fill the rest of the wall.
        share = [*share, *("poster",) * 4]
        furnishing.line(rng, side, share, (0.3, length_m - 0.1), depth_m=depth)
    near = list(rng.permutation(_FLAT))
    furnishing.line(rng, "near", near, (0.1 - half_m, half_m - 0.1), depth_m=0.2)
    return furnishing.finished(rng, str(rng.choice(["brick", "plaster", "plaster"])))


def simple_room(
    rng: Rng, *, length_m: float, width_m: float = 5.0, obstacles: Sequence[Body] = ()
) -> FurnishedRoom:
    """A room with a few pieces at least 1.3 m from the x axis, and a bare far wall."""
    furnishing = Furnishing(Interior((length_m, width_m, 2.8)), obstacles)
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
    obstacles: Sequence[Body] = (),
) -> FurnishedRoom:
    """A narrow corridor with doors and posters on both sides and a row of lamps."""
    furnishing = Furnishing(Interior((length_m, width_m, height_m)), obstacles)
    for side, start in (("left", 0.4), ("right", 1.4)):
        names = [str(rng.choice(["door", "door", "poster"])) for _ in range(int(length_m))]
        furnishing.line(rng, side, names, (start, length_m - 0.2), depth_m=0.1, gap_m=(0.5, 1.3))
    for side in ("far", "near"):
        furnishing.line(rng, side, ["door"], (-width_m / 2, width_m / 2), depth_m=0.1)
    lamps = (max(1, round(length_m / 2.4)), 1)
    return furnishing.finished(rng, "plaster", lamps)
