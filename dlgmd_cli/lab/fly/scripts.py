"""What is flown: the paper's five groups, and flights that a seed draws."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.fly.objects import INDOORS, KINDS, OUTDOORS
from dlgmd_cli.lab.fly.worlds import ENVIRONMENTS, environment_of

T = TypeVar("T")
# How the drone meets its target: flies into it, past it, or through it; it comes, or crosses.
AHEAD, BESIDE, THROUGH, COMES, CROSSES = "ahead", "beside", "through", "comes", "crosses"
SPEEDS_M_S = (1.0, 3.0)
FOV_DEG = (60.0, 120.0)
# The time constant with which ArduCopter's tilt follows (ATC_INPUT_TC).
TILT_S = 0.15
_HEIGHTS_M = (0.8, 1.8)
# What comes or crosses.
MOVERS = ("ball", "drone", "person")
# A wall ahead stays this far away where nothing is to be hit: its true rate is below 0.45/s.
_AHEAD_S = 2.3


@dataclass(frozen=True)
class Options:
    """What is flown, and how it is filmed; None is drawn by the seed.

    Attributes
    ----------
    scene : str, optional
        A manner, or a group of the paper.
    seed : int
    size_wh : (int, int)
        Of the images, in px.
    fps : float
    environment, target : str, optional
    speed_m_s : float, optional
        Of the drone, or of what comes while it hovers.
    height_m : float, optional
        Of a flight that does not climb.
    fov, camera_tilt : float
        Angles of the camera in degrees; `fov` may be None.
    agile : bool
        Whether the jerk is hardly limited.
    tilt_s : float
        The time constant with which the tilt follows.
    """

    scene: str | None = None
    seed: int = 0
    size_wh: tuple[int, int] = (480, 270)
    fps: float = 30.0
    environment: str | None = None
    target: str | None = None
    speed_m_s: float | None = None
    height_m: float | None = None
    fov: float | None = None
    camera_tilt: float = 0.0
    agile: bool = False
    tilt_s: float = TILT_S


@dataclass(frozen=True)
class Leg:
    """A part of a flight with constant commands.

    Attributes
    ----------
    name : str
        What the drone does: hover, accelerate, brake, yaw.
    seconds : float
    forward_m_s, climb_m_s : float
        Commanded speed along the drone's heading, and upwards.
    yaw_deg_s : float
        Rate of turn, positive to the left.
    tilt_deg : float
        Greatest tilt, which limits the acceleration along the ground.
    """

    name: str
    seconds: float
    forward_m_s: float = 0.0
    climb_m_s: float = 0.0
    yaw_deg_s: float = 0.0
    tilt_deg: float = 15.0


@dataclass(frozen=True)
class Script:
    """A flight before it is flown.

    Attributes
    ----------
    name : str
        Its manner, or the group of the paper.
    world : str
        A key of `WORLDS`.
    legs : tuple of Leg
    height_m, starts_m_s, yaw_deg : float
        First height, speed and heading.
    target : str
        A key of `KINDS`, "door", or empty.
    meets : str
        How the drone meets the target; empty without one.
    meets_s : float
        When: at the contact, or half-way past.
    speed_m_s : float
        Of what moves: the drone at cruise, or what comes or crosses.
    aside : float
        In a collision, how far off the middle the target is hit, as a share of its half width, -1
        to 1; else the free space between the drone's hull and the target, in m. A negative one is
        on the right.
    turned_deg : float
        Rotation of the target; of what comes, the direction it comes from.
    behind_m, ahead_s : float
        Free space behind the target or the end of the flight, in m, and in seconds of flight.
    margin_m : float
        Free space on both sides.
    fov_deg, camera_tilt_deg : float
    agile : bool
    tilt_s : float
    """

    name: str
    world: str
    legs: tuple[Leg, ...]
    height_m: float
    starts_m_s: float = 0.0
    yaw_deg: float = 0.0
    target: str = ""
    meets: str = ""
    meets_s: float = 0.0
    speed_m_s: float = 0.0
    aside: float = 0.0
    turned_deg: float = 0.0
    behind_m: float = 1.5
    ahead_s: float = 0.0
    margin_m: float = 1.5
    fov_deg: float = 80.0
    camera_tilt_deg: float = 0.0
    agile: bool = False
    tilt_s: float = TILT_S

    @property
    def collides(self) -> bool:
        """Whether the flight ends in a contact."""
        return self.meets in (AHEAD, COMES)

    @property
    def hovers(self) -> bool:
        """Whether the drone stays where it is, and something else moves."""
        return self.meets in (COMES, CROSSES)

    @property
    def environment(self) -> str:
        """Indoors or outdoors."""
        return environment_of(self.world)


def _frames(n: float) -> float:
    """Seconds of n frames of the paper's videos."""
    return n / 30.0


def _group(frame: int, script: Script) -> Script:
    """A group of the paper: a contact straight ahead at a frame; the last leg ends 12 later."""
    *first, last = script.legs
    rest = _frames(frame + 12) - sum(leg.seconds for leg in first)
    legs = (*first, replace(last, seconds=rest))
    return replace(script, legs=legs, meets=AHEAD, meets_s=_frames(frame), behind_m=2.0)


# The paper's Table III has the backgrounds, the attitude motion, the objects and the frames of the
# collisions; the caption of Fig. 14 that group 2 pitches and accelerates from frame 40 on and
# brakes near frame 125; that of Fig. 17 that group 3 yaws at 10 degrees/s. Groups 1 and 2 are in
# the same room. The paper has no speeds, sizes or tilts: these are the tilt of a careful pilot, 6
# degrees, and objects of their usual sizes. In group 2 they are those by which braking can be seen:
# it tilts by 4 degrees, so that 15 frames take a good part of its speed, and its obstacle is so
# wide that each of sets 3, 6, 7 and 8 has 5 % of its peak in the 10 frames before the drone brakes.
_HOVER, _PITCH = Leg("hover", _frames(40)), Leg("pitch", _frames(10), 6.0, tilt_deg=6.0)
_ACCELERATE = Leg("accelerate", _frames(75), 6.0, tilt_deg=6.0)
_SLOWLY = tuple(replace(leg, tilt_deg=4.0) for leg in (_PITCH, _ACCELERATE))
_TAKE_OFF = (
    Leg("stand", _frames(24)),
    Leg("take off", _frames(66), climb_m_s=0.36),
    replace(_PITCH, seconds=_frames(12)),
    _ACCELERATE,
)
_YAW = Leg("hover", _frames(15), yaw_deg_s=10.0), Leg("yaw", 0.0, 1.0, 0.0, 10.0, 6.0)
_BRAKE = Leg("decelerate", 0.0, tilt_deg=20.0)
GROUPS = {
    script.name: script
    for script in (
        _group(120, Script("group1", "room", (_HOVER, _PITCH, _ACCELERATE), 0.78, target="chair",
                           turned_deg=20.0)),
        _group(140, Script("group2", "room", (_HOVER, *_SLOWLY, _BRAKE), 1.1, target="panel")),
        _group(135, Script("group3", "room", _YAW, 0.95, yaw_deg=-20.0, target="notebook")),
        _group(210, Script("group4", "simple", _TAKE_OFF, 0.16, target="board")),
        _group(196, Script("group5", "simple", _TAKE_OFF, 0.16, target="carton")),
    )
}  # fmt: skip


class Draw:
    """Draws a flight in one manner; options that are None are drawn."""

    def __init__(self, options: Options, rng: np.random.Generator) -> None:
        self.rng, self.environment, self.target = rng, options.environment, options.target
        drawn = self.between(*SPEEDS_M_S)
        self.speed = drawn if options.speed_m_s is None else options.speed_m_s

    def between(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.rng.uniform(low, high))

    def either(self, *of: T) -> T:
        """One of several."""
        return of[int(self.rng.integers(len(of)))]

    def world(self, *but: str) -> str:
        """A world of the environment, without some."""
        environment = self.environment
        if environment is None:
            fits = KINDS[self.target].where.split() if self.target else (INDOORS, OUTDOORS)
            environment = self.either(*fits)
        return self.either(*(w for w in ENVIRONMENTS[environment] if w not in but))

    def kind(self, world: str, kinds: Sequence[str]) -> str:
        """The target: the one that is asked for, or one of some kinds that is found in a world."""
        where = environment_of(world)
        fitting = (k for k in kinds if KINDS[k].is_drawn and where in KINDS[k].where)
        return self.target or self.either(*fitting)

    def height(self, target: str) -> float:
        """A height at which a target is in the way."""
        low, high = KINDS[target].aim_m if KINDS[target].stands else _HEIGHTS_M
        return self.between(low, high)

    def cruise(self, low_s: float, high_s: float, yaw_deg_s: float = 0.0) -> tuple[Leg, ...]:
        """Legs that end in a cruise of some seconds; some begin in a hover."""
        flies = Leg("cruise", self.between(low_s, high_s), self.speed, yaw_deg_s=yaw_deg_s)
        if self.rng.random() < 0.7:
            return (flies,)
        faster = Leg("accelerate", 0.5 + self.speed / 3, self.speed, tilt_deg=20.0)
        return Leg("hover", self.between(0.5, 1.2)), faster, flies

    def meeting(
        self, name: str, world: str, height: float, target: str, meets: str, legs: tuple[Leg, ...]
    ) -> Script:
        """A flight that meets its target at the end of the legs, and goes on for a while."""
        last_s = 0.5 if meets in (AHEAD, COMES) else 1.2
        return Script(
            name, world, (*legs, replace(legs[-1], name="on", seconds=last_s)), height,
            legs[0].forward_m_s, target=target, meets=meets,
            meets_s=sum(leg.seconds for leg in legs), speed_m_s=self.speed,
            margin_m=self.between(1.2, 2.2),
        )  # fmt: skip


def _hit(d: Draw) -> Script:
    world = d.world()
    target = d.kind(world, list(KINDS))
    turns = 0.0 if world == "corridor" or d.rng.random() < 0.7 else d.between(-8, 8)
    flight = d.meeting("hit", world, d.height(target), target, AHEAD, d.cruise(2.0, 3.5, turns))
    return replace(
        flight, aside=d.between(-0.7, 0.7), turned_deg=d.between(-25, 25),
        behind_m=d.between(1.0, 4.0),
    )  # fmt: skip


def _pass(d: Draw) -> Script:
    world = d.world("corridor")
    target = d.kind(world, [kind for kind in KINDS if kind not in ("wall", "car")])
    flight = d.meeting("pass", world, d.height(target), target, BESIDE, d.cruise(2.0, 3.0))
    aside = d.either(-1.0, 1.0) * d.between(0.3, 0.9)
    return replace(flight, aside=aside, turned_deg=d.between(-40, 40), ahead_s=_AHEAD_S)


def _door(d: Draw) -> Script:
    world, height = d.world("simple"), d.between(0.9, 1.6)
    flight = d.meeting("door", world, height, "door", THROUGH, d.cruise(2.0, 3.0))
    return replace(flight, aside=d.between(-0.08, 0.08), ahead_s=_AHEAD_S)


def _turn(d: Draw) -> Script:
    rate = d.either(-1.0, 1.0) * d.between(35, 80)
    turn_s = d.between(80, 160) / abs(rate)
    legs = (
        Leg("cruise", d.between(1.2, 2.2), d.speed),
        Leg("yaw", turn_s, 0.25 * d.speed, yaw_deg_s=rate, tilt_deg=20.0),
        Leg("on", d.between(1.0, 1.8), d.speed),
    )
    return Script(
        "turn", d.world("corridor"), legs, d.between(*_HEIGHTS_M), d.speed, speed_m_s=d.speed,
        behind_m=d.between(0.9, 1.5), ahead_s=0.5, margin_m=d.between(1.0, 2.0),
    )  # fmt: skip


def _climb(d: Draw) -> Script:
    world, up = d.world(), d.between(0.4, 0.8)
    seconds = min(0.9 / up, 2.0)
    forward = d.between(0.0, 0.5)
    legs = (
        Leg("hover", 0.7),
        Leg("climb", seconds, forward, up),
        Leg("hold", 0.7),
        Leg("descend", seconds, forward, -up),
        Leg("end", 0.6),
    )
    return Script(
        "climb", world, legs, d.between(0.8, 1.1), speed_m_s=up, behind_m=d.between(1.5, 4.0),
        ahead_s=_AHEAD_S, margin_m=d.between(1.2, 2.2),
    )  # fmt: skip


def _approached(d: Draw) -> Script:
    world = d.world("corridor")
    target, legs = d.kind(world, MOVERS), (Leg("hover", d.between(2.0, 3.0)),)
    flight = d.meeting("approached", world, d.height(target), target, COMES, legs)
    return replace(flight, aside=d.between(-0.5, 0.5), turned_deg=d.between(-20, 20))


def _crossed(d: Draw) -> Script:
    world = d.world("corridor")
    target, legs = d.kind(world, MOVERS), (Leg("hover", d.between(1.6, 2.4)),)
    flight = d.meeting("crossed", world, d.height(target), target, CROSSES, legs)
    aside = d.either(-1.0, 1.0) * d.between(0.8, 2.5)
    turned, behind = d.between(-25, 25), d.between(3.5, 5.0)
    return replace(flight, aside=aside, turned_deg=turned, behind_m=behind)


def _free(d: Draw) -> Script:
    legs = tuple(
        Leg(f"curve {number}", d.between(1.0, 1.6), d.speed * d.between(0.6, 1.0),
            d.between(-0.15, 0.15), d.between(-25, 25))
        for number in range(1, 5)
    )  # fmt: skip
    return Script(
        "free", d.world("corridor"), legs, d.between(1.0, 1.6), d.speed, speed_m_s=d.speed,
        ahead_s=_AHEAD_S, margin_m=d.between(1.2, 2.2),
    )  # fmt: skip


class Manner(NamedTuple):
    """A manner: its share of the drawn flights, its scripts, and the targets that it meets."""

    share: float
    draw: Callable[[Draw], Script]
    targets: Collection[str] = ()


# Half of the drawn flights end in a contact.
MANNERS = {
    "hit": Manner(0.35, _hit, KINDS),
    "pass": Manner(0.13, _pass, KINDS),
    "door": Manner(0.09, _door),
    "turn": Manner(0.08, _turn),
    "climb": Manner(0.06, _climb),
    "approached": Manner(0.15, _approached, MOVERS),
    "crossed": Manner(0.08, _crossed, MOVERS),
    "free": Manner(0.06, _free),
}


def script_of(options: Options) -> Script:
    """The script of a group, or of a flight in a manner; the seed draws what is not given.

    Raises ParameterError for an unknown scene, and for a target that is not met there.
    """
    scene, fov, target = options.scene, options.fov, options.target
    if scene is not None and scene not in (*MANNERS, *GROUPS):
        hint = f"Choose from {', '.join((*MANNERS, *GROUPS))}."
        raise ParameterError("", f"there is no manner {scene!r}", hint, "manner")
    if scene in GROUPS:
        if options.environment or target:
            raise ParameterError("", f"{scene} has its own room and obstacle", "Leave yours out.")
        script = GROUPS[scene]
    else:
        script = _drawn(options)
        drawn = np.random.default_rng([options.seed, 4]).uniform(*FOV_DEG)
        fov = round(float(drawn), 1) if fov is None else fov
    if options.height_m is not None:
        legs = tuple(replace(leg, climb_m_s=0.0) for leg in script.legs)
        script = replace(script, legs=legs, height_m=options.height_m)
    return replace(
        script,
        meets_s=round(script.meets_s * options.fps) / options.fps,
        fov_deg=script.fov_deg if fov is None else fov,
        camera_tilt_deg=options.camera_tilt,
        agile=options.agile,
        tilt_s=options.tilt_s,
    )


def _drawn(options: Options) -> Script:
    """A flight that the seed draws."""
    scene, target, environment = options.scene, options.target, options.environment
    if environment and target and environment not in KINDS[target].where:
        raise ParameterError("", f"a {target} is not found {environment}", "", "target")
    rng = np.random.default_rng([options.seed, 0])
    fitting = [m for m in MANNERS if target is None or target in MANNERS[m].targets]
    if scene is None:
        shares = np.array([MANNERS[m].share for m in fitting])
        scene = str(rng.choice(fitting, p=shares / shares.sum()))
    elif scene not in fitting:
        meeting = ", ".join(m for m in MANNERS if MANNERS[m].targets)
        why = f"a flight of the manner {scene} meets no {target}"
        raise ParameterError("", why, f"Choose from {meeting}.", "manner")
    return MANNERS[scene].draw(Draw(options, rng))
