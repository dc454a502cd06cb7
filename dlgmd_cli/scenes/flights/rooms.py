"""Furnished rooms to fly through, along the x axis in the middle of the floor.

A room extends over x from 0 to its length, y from -width/2 to width/2, and z from 0 to its height.
In all functions, `size_m` is (length, width, height), and `obstacles` are the bodies that a flight
hits or passes. Furniture is placed clear of them, and those at rest cast shadows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from dlgmd_cli.frame import FloatArray, FloatImage
from dlgmd_cli.scenes.flights import textures
from dlgmd_cli.scenes.flights.furniture import catalogue, furniture, placement
from dlgmd_cli.scenes.flights.solids import Body, Face, Shade, Solid, Texture, World, quad
from dlgmd_cli.scenes.flights.textures import Rng, reflectance

Size3 = tuple[float, float, float]

# Light in a room: a white surface facing the lamps is just saturated in the camera.
DAYLIGHT = 1.35

_WALL_PX_PER_M, _FLOOR_PX_PER_M, _CEILING_PX_PER_M = 250.0, 200.0, 120.0
_GAINS = {"near": 0.82, "far": 0.85, "left": 0.9, "right": 0.78, "floor": 0.95, "ceiling": 0.85}
_SPACE_M = 0.02  # least distance between two pieces
_OFF_WALL_M = 0.005  # distance of a shadow from its wall
_AXES = np.vstack([np.eye(3), -np.eye(3)])
# Shadows: resolution, share of the light lost at the point of contact, decay with distance, and
# range.
_SHADE_PX_M = 40.0
_DEEPEST = 0.6
_FADE_M = 0.25
_FARTHEST_M = 0.9

# Names of the sides of a room as targets, in the order of `walls`.
SIDES = ("wall", "wall", "wall", "wall", "floor", "ceiling")


def walls(size_m: Size3, texture: Texture) -> dict[str, Face]:
    """The sides: "near" (at x = 0), "far", "left" (towards +y), "right", "floor", "ceiling"."""
    length, width, height = size_m
    half = width / 2
    sides = {
        "near": ((0, -half, height), (0, width, 0), (0, 0, -height)),
        "far": ((length, half, height), (0, -width, 0), (0, 0, -height)),
        "left": ((0, half, height), (length, 0, 0), (0, 0, -height)),
        "right": ((length, -half, height), (-length, 0, 0), (0, 0, -height)),
        "floor": ((0, half, 0), (length, 0, 0), (0, -width, 0)),
        "ceiling": ((0, -half, height), (length, 0, 0), (0, width, 0)),
    }
    return {side: quad(*lines, texture) for side, lines in sides.items()}


def at_wall(
    size_m: Size3, side: str, along_m: float, off_m: float
) -> tuple[tuple[float, float], float]:
    """Position (x, y), `off_m` in front of a wall, and the yaw of a piece with its back to it.

    `along_m` is x on the "left" and "right" wall and y on the "near" and "far" one.
    """
    length, width, _ = size_m
    x, y, yaw_deg = {
        "near": (off_m, along_m, 0.0),
        "far": (length - off_m, along_m, 180.0),
        "left": (along_m, width / 2 - off_m, -90.0),
        "right": (along_m, off_m - width / 2, 90.0),
    }[side]
    return (x, y), yaw_deg


def shaded(image: FloatImage, wall: Face, bodies: Sequence[Body]) -> FloatImage:
    """The image of a wall, darker near its edges and behind nearby bodies.

    Moving bodies cast no shadow.
    """
    width, height = wall.size_m
    n_rows, n_columns = (max(2, math.ceil(side * _SHADE_PX_M)) for side in (height, width))
    light = np.outer(_edges(n_rows, height), _edges(n_columns, width)).astype(np.float32)
    right, down = wall.right_m / width, wall.down_m / height
    axes = np.array([right, down, np.cross(down, right)])
    for body in bodies:
        if isinstance(body, Solid) and body.motion is None:
            _darken(light, (body.corners_m - wall.origin_m) @ axes.T)
    return image * cv2.resize(light, image.shape[::-1]).reshape(image.shape)


def _edges(count: int, length_m: float) -> FloatArray:
    """Brightness along a side, darker near its two ends."""
    at = (np.arange(count) + 0.5) * length_m / count
    return 1.0 - 0.22 * (np.exp(-at / 0.3) + np.exp((at - length_m) / 0.3))


def _darken(light: FloatImage, corners_m: FloatArray) -> None:
    """Darken the wall behind a body with corners at (right, down, distance in front), (n, 3)."""
    nearest = float(corners_m[:, 2].min())
    if nearest > _FARTHEST_M:
        return
    hull = cv2.convexHull((corners_m[:, :2] * _SHADE_PX_M).astype(np.float32))
    sigma = (0.03 + 0.3 * nearest) * _SHADE_PX_M
    rim = math.ceil(3.0 * sigma) + 1
    x, y, width, height = cv2.boundingRect(hull)
    left, top = max(0, x - rim), max(0, y - rim)
    around = light[top : max(0, y + height + rim), left : max(0, x + width + rim)]
    # With a margin: without it, the blur would weaken a shadow at the image's edge.
    shadow = np.zeros((around.shape[0] + 2 * rim, around.shape[1] + 2 * rim), np.float32)
    points = np.round(16.0 * (hull - 0.5 + (rim - left, rim - top))).astype(np.int32)
    cv2.fillPoly(shadow, [points], 1.0, shift=4)
    soft = cv2.GaussianBlur(shadow, (0, 0), sigma)[rim:-rim, rim:-rim]
    around *= 1.0 - _DEEPEST * math.exp(-nearest / _FADE_M) * soft


def room(
    size_m: Size3,
    rng: Rng,
    *,
    wall: str = "plaster",
    floor: str = "parquet",
    lamps: tuple[int, int] = (4, 2),
    bodies: Sequence[Body] = (),
) -> Solid:
    """Walls, floor and ceiling, with soft shadows of `bodies`.

    `wall` is plaster or brick, `floor` is parquet, carpet, tiles or lines, and `lamps` is the
    number of lamps along x and along y. The faces are in the order of `walls`.
    """
    tone = rng.uniform(0.4, 0.7)
    faces = []
    for side, face in walls(size_m, Texture(tone)).items():
        if side == "floor":
            image = getattr(textures, floor)(rng, face.size_m, _FLOOR_PX_PER_M)
        elif side == "ceiling":
            image = textures.ceiling_panels(rng, face.size_m, _CEILING_PX_PER_M, lamps=lamps)
        else:
            image = getattr(textures, wall)(rng, face.size_m, _WALL_PX_PER_M, tone)
            board = round(0.08 * image.shape[0] / face.size_m[1])  # the skirting board
            image[-board:] = 0.22
            image[-board : 2 - board] = 0.5
            image[-board - 2 : -board] *= 0.6
        picture = Texture(reflectance(shaded(image, face, bodies)))
        faces.append(replace(face, texture=picture, gain=_GAINS[side]))
    return Solid("room", faces)


def shadow_on(wall: Face, texture: Shade, *, up: float, speed_m_s: float, phase: float) -> Solid:
    """A shadow on a side of a room, which sweeps to and fro along its width.

    Parameters
    ----------
    wall : Face
        A side of the room, or its floor.
    texture : Shade
        Its image; with a size, see `textures.shadow`.
    up : float
        Where it is along the height of the side: 0 at one end, 1 at the other.
    speed_m_s : float
        Greatest speed; it moves as a sine of the time.
    phase : float
        Phase of the sine, in rad.
    """
    lines, whole = np.array([wall.right_m, wall.down_m]), np.array(wall.size_m)
    cut = np.minimum(texture.size_m or wall.size_m, whole)
    units, free = lines / whole[:, None], whole - cut
    corner = wall.origin_m + up * free[1] * units[1] + _OFF_WALL_M * wall.normal
    right, down = cut[:, None] * units
    half_m = free[0] / 2.0
    pace = speed_m_s / max(half_m, _OFF_WALL_M)

    def motion(time_s: float) -> FloatArray:
        return np.asarray(units[0] * (half_m * math.sin(pace * time_s + phase)))

    return Solid("shadow", [quad(corner + half_m * units[0], right, down, texture)], motion)


@dataclass
class Furnishing:
    """A room while it is being furnished, clear of `obstacles`."""

    size_m: Size3
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
                where = placement(*at_wall(self.size_m, side, middle, 0.0))
                if self._is_free(self._ground(side, middle, half, deep / 2)) and self.add(
                    furniture(name, rng, where, group="at_walls")
                ):
                    at = middle + half + rng.uniform(*gap_m)
                    break

    def finished(
        self, rng: Rng, wall: str, floor: str | None, lamps: tuple[int, int] | None = None
    ) -> World:
        """The room with its furniture and the obstacles, in constant light.

        Without a `floor`, it is parquet or carpet. Furniture with the same name as an obstacle is
        renamed: the name identifies the target.
        """
        drawn = str(rng.choice(["parquet", "carpet"]))
        looks = {"wall": wall, "floor": floor or drawn}
        lamps = lamps or (max(1, round(self.size_m[0] / 2.5)), 2)
        bodies = [*self.obstacles, *self.bodies]
        inside = room(self.size_m, rng, **looks, lamps=lamps, bodies=bodies)
        taken = {obstacle.name for obstacle in self.obstacles}
        others = [renamed(body) if body.name in taken else body for body in self.bodies]
        return World(inside, [*others, *self.obstacles], lambda _: DAYLIGHT)

    def _is_free(self, box_m: FloatArray) -> bool:
        """Whether a box is inside the room and clear of all bodies; (6,), its reach on `_AXES`."""
        length, width, height = self.size_m
        most = np.array([length, width / 2, height, 0.0, width / 2, 0.0])
        taken = np.array([body.reach(_AXES) for body in (*self.obstacles, *self.bodies)])
        # Overlap along each axis, from either side; two boxes meet if they overlap along all.
        overlaps = box_m + np.roll(taken.reshape(-1, 6), 3, axis=1)
        is_taken = (overlaps > -_SPACE_M).all(axis=1).any()
        return bool((box_m <= most + 1e-9).all() and not is_taken)

    def _ground(self, side: str, along_m: float, half_m: float, deep: float) -> FloatArray:
        """The box from floor to ceiling that a piece at a wall occupies; see `_is_free`."""
        (x, y), yaw_deg = at_wall(self.size_m, side, along_m, deep)
        dx, dy = (deep, half_m) if yaw_deg % 180.0 == 0.0 else (half_m, deep)
        return np.array([x + dx, y + dy, self.size_m[2], dx - x, dy - y, 0.0])


def renamed(body: Body) -> Body:
    """The body under another name, so that it is not part of a target."""
    return replace(body, name=f"other {body.name}")


def cluttered_room(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 5.6,
    free_width_m: float = 2.4,
    end_m: float = 1.1,
    floor: str | None = None,
    obstacles: Sequence[Body] = (),
) -> World:
    """A room full of furniture along its walls.

    A strip of `free_width_m` along the x axis stays free, except at the far wall, where furniture
    may be `end_m` deep.
    """
    furnishing = Furnishing((length_m, width_m, 2.8), obstacles)
    depth, half_m = (width_m - free_width_m) / 2, width_m / 2
    ends = list(rng.permutation(catalogue()["along_walls"]["end"]))
    furnishing.line(rng, "far", ends, (0.05 - half_m, half_m - 0.05), depth_m=end_m)
    names = list(rng.permutation(catalogue()["along_walls"]["clutter"]))
    half = len(names) // 2
    for side, share in (("left", names[:half]), ("right", names[half:])):
        # Posters come last, to fill the rest of the wall.
        share = [*share, *("poster",) * 4]
        furnishing.line(rng, side, share, (0.3, length_m - 0.1), depth_m=depth)
    near = list(rng.permutation(catalogue()["along_walls"]["flat"]))
    furnishing.line(rng, "near", near, (0.1 - half_m, half_m - 0.1), depth_m=0.2)
    return furnishing.finished(rng, str(rng.choice(["brick", "plaster", "plaster"])), floor)


def simple_room(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 5.0,
    floor: str | None = None,
    obstacles: Sequence[Body] = (),
) -> World:
    """A room with a few pieces at least 1.3 m from the x axis, and a bare far wall."""
    furnishing = Furnishing((length_m, width_m, 2.8), obstacles)
    names = list(rng.permutation(catalogue()["along_walls"]["little"]))
    for side, share in (("left", names[::2]), ("right", names[1::2])):
        span = (rng.uniform(0.3, 1.0), length_m - 0.3)
        furnishing.line(rng, side, share, span, depth_m=width_m / 2 - 1.3, gap_m=(0.3, 1.2))
    furnishing.line(rng, "near", ["door"], (-1.5, 1.5), depth_m=0.2)
    return furnishing.finished(rng, "plaster", floor)


def corridor(
    rng: Rng,
    *,
    length_m: float,
    width_m: float = 2.2,
    height_m: float = 2.6,
    floor: str | None = None,
    obstacles: Sequence[Body] = (),
) -> World:
    """A narrow corridor with doors and posters on both sides and a row of lamps."""
    furnishing = Furnishing((length_m, width_m, height_m), obstacles)
    for side, start in (("left", 0.4), ("right", 1.4)):
        names = [str(rng.choice(["door", "door", "poster"])) for _ in range(int(length_m))]
        furnishing.line(rng, side, names, (start, length_m - 0.2), depth_m=0.1, gap_m=(0.5, 1.3))
    for side in ("far", "near"):
        furnishing.line(rng, side, ["door"], (-width_m / 2, width_m / 2), depth_m=0.1)
    return furnishing.finished(rng, "plaster", floor, (max(1, round(length_m / 2.4)), 1))
