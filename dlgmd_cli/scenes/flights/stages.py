"""The named flights, of `scenes.yaml` and of the paper's Fig. 8, and the places of obstacles."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.frame import FloatArray, FloatImage
from dlgmd_cli.scenes.flights.drone import PHASES, fly
from dlgmd_cli.scenes.flights.furniture import furniture, placement
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage
from dlgmd_cli.scenes.flights.rooms import (
    DAYLIGHT,
    cluttered_room,
    corridor,
    renamed,
    simple_room,
    walls,
)
from dlgmd_cli.scenes.flights.solids import Body, Capsule, Motion, Solid, Texture, World, box_of
from dlgmd_cli.scenes.flights.textures import Rng, reflectance, smooth_noise
from dlgmd_cli.scenes.flights.truth import Nearest

# Builds an obstacle at (x, y) on the floor with a yaw in degrees; its front faces along its x.
Build = Callable[[tuple[float, float], float], Sequence[Body]]

# Frame interval of the paper's videos.
FRAME_S = 1.0 / 30.0
_ROOMS = {"cluttered": cluttered_room, "simple": simple_room, "corridor": corridor}
_DUSK, _OFF_WALL_M = 0.3, 0.01
# Time filmed after a collision.
_AFTER_S = 15 * FRAME_S

# Bound on the extent of obstacles, and step of the search.
_FARTHEST_M, _STEP_M = 3.0, 0.02
_N_HALVINGS = 50
_STANDS_M_S, _TOUCHING_M = 0.1, 0.01


class MissedError(Exception):
    """The flight passes over or under the obstacle that it should hit."""


def obstacle_in_path(
    path: Path, contact_s: float, build: Build, target: str, *, turned_deg: float = 0.0
) -> list[Body]:
    """An obstacle straight ahead, placed so that the drone touches it at `contact_s`.

    `path` is the flight without contact. `target` names the part to be touched; other parts must
    not be touched earlier. The front is turned by `turned_deg` from facing the drone. Raises
    MissedError if the drone cannot touch the target.
    """
    state = path.state(contact_s)
    ahead = _heading(state.velocity_m_s)
    x, y, _ = state.position_m.tolist()
    bodies = build((x, y), _facing_deg(ahead) + turned_deg)
    nearest = Nearest([body for body in bodies if body.name == target])

    def touches(ahead_m: float) -> bool:
        distances = nearest.distances(state.position_m - ahead_m * ahead, contact_s)
        return bool(distances.min() <= REACH_M)

    far = _FARTHEST_M
    while not touches(far - _STEP_M):
        far -= _STEP_M
        if far < -_FARTHEST_M:
            raise MissedError(target)
    near = far - _STEP_M
    for _ in range(_N_HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if touches(middle) else (near, middle)
    return [body.moved(near * ahead) for body in bodies]


def obstacle_beside(
    path: Path, time_s: float, build: Build, aside_m: float, ahead_m: float = 0.0
) -> list[Body]:
    """An obstacle that faces the drone, so far to its left and ahead of it at a time.

    This is relative to the direction of flight, or to the heading if the drone is at rest.
    """
    state, (ahead, left) = path.state(time_s), directions(path, time_s)
    x, y, _ = (state.position_m + ahead_m * ahead + aside_m * left).tolist()
    return list(build((x, y), _facing_deg(ahead)))


def directions(path: Path, time_s: float, *, looks: bool = False) -> tuple[FloatArray, FloatArray]:
    """Horizontal unit vectors, (3,): where the drone flies, or heads if it rests, and its left.

    With `looks`, it is where the camera looks in any case.
    """
    state = path.state(time_s)
    stands = np.linalg.norm(state.velocity_m_s) < _STANDS_M_S
    ahead = _heading(state.pose.rotation[:, 0] if looks or stands else state.velocity_m_s)
    return ahead, np.array([-ahead[1], ahead[0], 0.0])


def _heading(velocity_m_s: FloatArray) -> FloatArray:
    """Horizontal direction of a velocity, a unit vector (3,)."""
    level = velocity_m_s * (1.0, 1.0, 0.0)
    return level / np.linalg.norm(level)


def _facing_deg(ahead: FloatArray) -> float:
    """The yaw of what faces a drone that flies in a direction."""
    return math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0


def with_unique_name(world: World, index: int) -> World:
    """The world with other furniture renamed so that only one piece has its name.

    The piece is that of the body `index`: the bodies of the same name connected to it by touching.
    """
    name = world.bodies[index].name
    named = [i for i, body in enumerate(world.bodies) if body.name == name]
    boxes = {i: box_of(world.bodies[i]) for i in named}
    piece, new = {index}, [index]
    while new:
        low, high = boxes[new.pop()] + np.array([[-_TOUCHING_M], [_TOUCHING_M]])
        touched = {
            i
            for i, (low2, high2) in boxes.items()
            if (low <= high2 + _TOUCHING_M).all() and (low2 - _TOUCHING_M <= high).all()
        }
        new += touched - piece
        piece |= touched
    others = {*named} - piece
    bodies = [renamed(body) if i in others else body for i, body in enumerate(world.bodies)]
    return replace(world, bodies=bodies)


# Named flights


def named_flight(spec: Mapping[str, Any], seed: int, agile: bool | None = None) -> Stage:
    """The flight described by an entry of `scenes.yaml`; `seed` determines everything random.

    `agile` overrides the entry.
    """
    agile = spec.get("agile", False) if agile is None else agile
    phases = [PHASES[name](n / 30.0, *values) for name, n, *values in spec["flies"]]
    start = {"position_m": spec["start_m"], "yaw_deg": spec.get("yaw_deg", 0.0)}
    flight = partial(fly, phases, **start, seed=seed, agile=agile)
    free, obstacle = flight(), spec["obstacle"]
    target, hit_at = obstacle.get("target", obstacle["piece"]), obstacle.get("hit_at")
    room = dict(spec["room"])
    rng = np.random.default_rng([seed, room.pop("number", 1)])
    kind, behind_m = _ROOMS[room.pop("kind")], room.pop("behind_m", 0.0)
    if hit_at is not None:
        contact_s = hit_at * FRAME_S
        build = partial(_piece, obstacle["piece"], np.random.default_rng([seed, 2]))
        turned = obstacle.get("turned_deg", 0.0)
        obstacles = obstacle_in_path(free, contact_s, build, target, turned_deg=turned)
        end_m = max(float(box_of(body)[1, 0]) for body in obstacles)
        world = kind(rng, **{"length_m": end_m + behind_m, **room}, obstacles=obstacles)
        path = flight(contact_s=contact_s)
        return Stage(world, path, target, contact_s, contact_s + _AFTER_S, agile)
    room.setdefault("length_m", _x(free, free.duration_s) + behind_m)
    obstacles = _missed_obstacle(obstacle, rng, free, room["length_m"])
    world = kind(rng, **room, obstacles=obstacles)
    if "lamps_on_at" in spec:
        on_s = spec["lamps_on_at"] / 30.0
        world = replace(world, light=lambda time_s: DAYLIGHT if time_s >= on_s else _DUSK)
    return Stage(world, free, target, None, free.duration_s, agile)


def _piece(
    name: str, rng: Rng, at_m: Sequence[float], yaw_deg: float = 0.0, motion: Motion | None = None
) -> list[Body]:
    """A piece of furniture at (x, y) on the floor, or at (x, y, z)."""
    return furniture(name, rng, placement(at_m, yaw_deg), motion=motion)


def _missed_obstacle(
    obstacle: Mapping[str, Any], rng: Rng, path: Path, length_m: float
) -> list[Body]:
    """An obstacle that is not hit."""
    name = obstacle["piece"]
    if "at_frame" in obstacle:
        return _piece(name, rng, (_x(path, obstacle["at_frame"] / 30.0), obstacle["y_m"]))
    if "up_m" in obstacle:
        return _piece(name, rng, (length_m - _OFF_WALL_M, 0.0, obstacle["up_m"]), 180.0)
    walk = obstacle["walks"]

    def motion(time_s: float) -> tuple[float, float, float]:
        way = walk["m_s"] * (time_s - walk["from"] / 30.0)
        return 0.0, float(np.clip(way, 0.0, walk["way_m"])), 0.0

    return _piece(name, rng, obstacle["at_m"], obstacle["yaw_deg"], motion)


def _x(path: Path, time_s: float) -> float:
    """Position along the room at a time, in m."""
    return float(path.state(time_s).position_m[0])


CONTACT_FRAME = 61
BALL_M, BALL_PX = 0.5, 25.0
_CAPSULES_AT_M = 4.0
_FOCAL_PX = 400.0 / math.tan(math.radians(40.0))
_EYE = np.array([1.0, 0.0, 20.0])
# Capsules: offset below the middle in px, and speed to the right in px/frame.
CAPSULES = ((-140.0, 6.4), (-40.0, 4.8), (60.0, 3.2), (160.0, 1.6))
START_PX, _CAPSULE_PX = -312.0, (48.0, 80.0)
_BACKGROUND = 0.9
_TEXELS = 768


def ball_and_capsules(seed: int, _agile: bool | None = None) -> Stage:
    """The flight: a still camera in a white room, hit by the ball at frame 61."""
    rng = np.random.default_rng([seed, 1])
    contact_s = CONTACT_FRAME * FRAME_S
    arrives_m = BALL_M + REACH_M
    speed = (_FOCAL_PX * BALL_M / BALL_PX - arrives_m) / contact_s

    def approach(time_s: float) -> tuple[float, float, float]:
        return speed * (contact_s - time_s), 0.0, 0.0

    center = _EYE + np.array([arrives_m, 0.0, 0.0])
    ball = Capsule("ball", np.array([center, center]), BALL_M, _ball_texture(rng), motion=approach)
    room = Solid("room", [*walls((60.0, 80.0, 40.0), Texture(_BACKGROUND)).values()])
    capsules = [_capsule(rng, down, pace) for down, pace in CAPSULES]
    path = fly([PHASES["hover"](contact_s + FRAME_S)], position_m=_EYE, seed=seed, jitter=0.0)
    return Stage(World(room, [ball, *capsules]), path, "ball", contact_s, contact_s)


def _capsule(rng: Rng, down_px: float, px_per_frame: float) -> Body:
    """A capsule that translates from left to right."""
    scale = _CAPSULES_AT_M / _FOCAL_PX
    width, height = (side * scale for side in _CAPSULE_PX)
    middle = _EYE + np.array([_CAPSULES_AT_M, -START_PX * scale, -down_px * scale])
    half = np.array([0.0, 0.0, (height - width) / 2.0])
    ends = np.array([middle - half, middle + half])
    speed_m_s = px_per_frame * scale / FRAME_S

    def passing(time_s: float) -> tuple[float, float, float]:
        return 0.0, -speed_m_s * time_s, 0.0

    return Capsule("capsule", ends, width / 2.0, _capsule_texture(rng), motion=passing)


def _ball_texture(rng: Rng) -> Texture:
    """A bright ball with a dark belt above its equator and small windows below."""
    y, x = (np.mgrid[:_TEXELS, :_TEXELS] + 0.5) * 2.0 / _TEXELS - 1.0
    depth = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    up, right = np.arcsin(np.clip(-y, -1.0, 1.0)), np.arctan2(x, depth)
    tone = 0.68 + 0.02 * smooth_noise(rng, x.shape, (60.0, 60.0))
    wave = 0.35 + 0.05 * np.sin(3.0 * right)
    tone[(up > wave - 0.28) & (up < wave + 0.35)] = 0.07
    tone[np.abs(up - wave + 0.31) < 0.012] = 0.03
    for across in (-0.6, -0.2, 0.2, 0.6):
        window = (np.abs(right - across) < 0.12) & (np.abs(up + 0.4) < 0.07)
        tone[window] = 0.85
        tone[window & (np.abs(up + 0.4) > 0.055)] = 0.3
    light = 0.35 + 0.65 * np.clip(-0.35 * x - 0.45 * y + 0.82 * depth, 0.0, 1.0)
    return Texture(_soft(tone * light))


def _capsule_texture(rng: Rng) -> Texture:
    """Two tones, a ring between them, and a label."""
    height, width = _TEXELS // 2, round(_TEXELS / 2 * _CAPSULE_PX[0] / _CAPSULE_PX[1])
    lower, upper = rng.uniform(0.25, 0.6), rng.uniform(0.06, 0.2)
    tone = np.full((height, width), lower)
    border = round(height * rng.uniform(0.3, 0.5))
    tone[:border] = upper
    tone[border : border + height // 40] = 0.03
    left, top = round(width * rng.uniform(0.3, 0.5)), round(height * 0.6)
    tone[top : top + height // 10, left : left + width // 3] = rng.uniform(0.05, 0.8)
    across = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    return Texture(_soft(tone * (0.45 + 0.55 * np.sqrt(1.0 - across**2))))


def _soft(image: np.ndarray) -> FloatImage:
    """A texture without edges sharper than a pixel."""
    return reflectance(cv2.GaussianBlur(image, (0, 0), 1.2))
