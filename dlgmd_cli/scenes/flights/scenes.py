"""All scenes, by name; flights are built from a seed, filmed, and have full ground truth."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import groupby, pairwise
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.errors import ParameterError, ResultError, argument
from dlgmd_cli.frame import FloatImage, GreyImage
from dlgmd_cli.parameters.checks import did_you_mean
from dlgmd_cli.parameters.facts import Phase, Record
from dlgmd_cli.results.record import read_record
from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.painter import Renderer
from dlgmd_cli.scenes.flights.path import Path as FlightPath
from dlgmd_cli.scenes.flights.path import Stage
from dlgmd_cli.scenes.flights.random_flights import manners, random_flight
from dlgmd_cli.scenes.flights.stages import ball_and_capsules, named_flight
from dlgmd_cli.scenes.flights.truth import FlightTruth, ImageSpeed, truth_rows
from dlgmd_cli.scenes.stimuli.clip import MAX_FRAMES, ClipOptions, Scene, invalid, option
from dlgmd_cli.scenes.stimuli.flat import Approach, ApproachOptions, Translation, TranslationOptions
from dlgmd_cli.video.base import parse_size
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.source import Video

# Rounding tolerance for times in ms and in frames.
_TOLERANCE = 1e-6
# Motion blur averages several images; a rolling shutter is rendered in strips of rows. Each has a
# greatest motion per step and a greatest number, which is also used while the light changes.
_BLUR_STEP_PX, _MAX_PICTURES = 1.0, 64
_STRIP_STEP_PX, _MAX_STRIPS = 0.5, 128
_TOO_FAST_PX_S = 1e12
# Quantisation of light and noise: 16 bits.
_N_STEPS = 65_536


@dataclass(frozen=True)
class FlightOptions(ClipOptions):
    """Options of all flights: those of the camera and the drone, besides those of every clip.

    For the noise see `Sensor`. An exposure or rolling shutter of 0 disables it. `agile` says
    whether the drone follows commands at once, see `fly`; None leaves it to the scene.
    """

    fov_deg: float = option(80.0, "fov", 1, 170, unit="degrees")
    camera_tilt_deg: float = option(0.0, "camera_tilt", -45, 45, unit="degrees")
    exposure_ms: float = option(0.0, "exposure", 0, 1000, unit="ms")
    vignette: float = option(0.3, "vignette", 0, 1)
    noise: float = option(0.002, "noise", 0, 1)
    shot_noise: float = option(0.01, "shot_noise", 0, 1)
    gamma: float = option(2.2, "gamma", 1, 4)
    rolling_shutter_ms: float = option(0.0, "rolling_shutter", 0, 1000, unit="ms")
    agile: bool | None = option(None, "agile", kind=bool)

    def __post_init__(self) -> None:
        super().__post_init__()
        period_ms = 1000.0 / self.fps
        times = {"exposure": self.exposure_ms, "rolling_shutter": self.rolling_shutter_ms}
        for name, value in times.items():
            if value > period_ms + _TOLERANCE:
                why = f"{value:g} ms is longer than a frame at {self.fps:g} frames/s"
                hint = f"Choose {period_ms:.4g} or less, or a lower {argument('fps')}."
                raise invalid(name, why, hint)

    def to_dict(self) -> dict[str, Any]:
        """See `ClipOptions.to_dict`; the record of a level camera is that of earlier versions."""
        values = super().to_dict()
        if self.camera_tilt_deg == 0.0:
            del values["camera-tilt"]
        return values

    @property
    def camera(self) -> Camera:
        """The camera on the drone."""
        return Camera(self.shape, self.fov_deg, self.camera_tilt_deg)

    @property
    def draws(self) -> tuple[Any, ...]:
        """What determines the room and the flight."""
        return self.seed, self.agile


@dataclass(frozen=True)
class RandomOptions(FlightOptions):
    """Options of random flights, see `random_flight`; `speed_m_s` is one speed or a range."""

    manner: str | None = option(None, "manner", kind=str)
    speed_m_s: tuple[float, ...] = option((), "speed", 0.3, 8, unit="m/s")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.manner is not None and self.manner not in manners():
            why = f"there is no scenario {self.manner[:40]!r}"
            raise invalid("manner", why, f"Choose from {', '.join(manners())}.")
        if len(self.speed_m_s) > 2:
            raise invalid("speed", "a random flight takes one speed, or a range", "Write 1:3.")
        if self.speed_m_s and self.speed_m_s[0] > self.speed_m_s[-1]:
            low, high = self.speed_m_s
            why = f"{low:g}:{high:g} is not a range"
            raise invalid("speed", why, f"Write {high:g}:{low:g}.")

    @property
    def draws(self) -> tuple[Any, ...]:
        """What determines the room and the flight."""
        return *super().draws, self.manner, self.speed_m_s

    def to_dict(self) -> dict[str, Any]:
        """See `ClipOptions.to_dict`; the speed is written as on the command line."""
        return {**super().to_dict(), "speed": ":".join(f"{v:g}" for v in self.speed_m_s) or None}


@lru_cache(maxsize=1)
def _staged(build: Callable[..., Stage], *draws: Any) -> Stage:
    """A stage; the latest one is kept, whose textures take tens of megabytes."""
    return build(*draws)


@dataclass(eq=False)
class FlightScene(Scene[FlightOptions]):
    """A flight through a room.

    `build` makes the room and the flight of `FlightOptions.draws`; it must be picklable.
    """

    truth_type = FlightTruth
    is_flight = True
    build: Callable[..., Stage]

    def stage(self, options: FlightOptions) -> Stage:
        """The room and the flight."""
        return _staged(self.build, *options.draws)

    def n_frames(self, options: FlightOptions) -> int:
        """Number of frames: as set, else the whole flight."""
        n_all = math.floor(self.stage(options).duration_s * options.fps + _TOLERANCE) + 1
        if options.n_frames is not None and options.n_frames > n_all:
            hint = f"Choose 1 to {n_all}, or a higher {argument('fps')}."
            raise invalid("frames", f"the flight ends after {n_all} frames", hint)
        n_frames = options.n_frames or n_all
        if n_frames > MAX_FRAMES:
            why = f"the flight has {n_frames} frames, and a clip has {MAX_FRAMES} at most"
            raise invalid(
                "fps", why, f"Lower it, or end the clip earlier with {argument('frames')}."
            )
        return n_frames

    def frames(self, options: FlightOptions) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8."""
        stage, n_frames = self.stage(options), self.n_frames(options)
        camera = FilmCamera(stage, options)
        return (camera.frame(index, stage.path) for index in range(n_frames))

    def truth(self, options: FlightOptions) -> Iterator[FlightTruth]:
        """The ground truth of each frame, computed from the geometry."""
        n_frames = self.n_frames(options)
        return truth_rows(self.stage(options), options.camera, options.fps, n_frames)

    def record(self, options: FlightOptions) -> Record:
        """Properties of the clip, as the page on rendered flights documents them.

        `collision_frame` is the first frame at or after contact, None if there is none.
        """
        stage, n_frames = self.stage(options), self.n_frames(options)
        height, width = options.shape
        contact_s, frame = stage.contact_s, n_frames
        if contact_s is not None:
            frame = collision_frame(contact_s, options.fps)
        named = groupby(range(n_frames), lambda index: stage.path.phase(index / options.fps))
        groups = [(name, list(frames)) for name, frames in named]
        phases: list[Phase] = [
            {"name": name, "first_frame": f[0], "last_frame": f[-1]} for name, f in groups
        ]
        manner: Record = {"manner": stage.manner} if stage.manner else {}
        return {
            "width": width,
            "height": height,
            "fps": options.fps,
            "frames": n_frames,
            "agile": stage.agile,
            **manner,
            "target": stage.target,
            "collision_frame": frame if frame < n_frames else None,
            "collision_time_s": None if contact_s is None else float(contact_s),
            "phases": phases,
        }


def collision_frame(contact_s: float, fps: float) -> int:
    """The first frame at or after contact."""
    return math.ceil(contact_s * fps - _TOLERANCE)


class FilmCamera:
    """Films a flight frame by frame.

    Frame i is taken at i / fps: the middle of the exposure, and the time of the middle row with a
    rolling shutter.
    """

    def __init__(self, stage: Stage, options: FlightOptions) -> None:
        camera = options.camera
        self._options, self._camera, self._n_rows = options, camera, camera.shape[0]
        self._sensor = Sensor(options)
        self._renderer = Renderer(stage.world, camera)
        self._speeds = ImageSpeed(stage.world, camera, stage.target)

    def frame(self, index: int, path: FlightPath) -> GreyImage:
        """A frame of the flight along a path, (H, W) uint8."""
        options, n_rows = self._options, self._n_rows
        time_s = index / options.fps
        exposure_s, readout_s = options.exposure_ms / 1000.0, options.rolling_shutter_ms / 1000.0
        half_s, light = (exposure_s + readout_s) / 2.0, self._renderer.world.light
        speed = 0.0
        if light(time_s - half_s) != light(time_s + half_s):
            speed = _TOO_FAST_PX_S
        elif half_s > 0.0:
            speed = self._speeds.fastest(path.state(time_s), time_s)
        n_pictures = max(1, min(math.ceil(speed * exposure_s / _BLUR_STEP_PX), _MAX_PICTURES))
        n_strips = max(1, min(math.ceil(speed * readout_s / _STRIP_STEP_PX), _MAX_STRIPS, n_rows))
        borders = np.linspace(0, n_rows, n_strips + 1).round().astype(int).tolist()
        strips = []
        for first, last in pairwise(borders):
            middle_s = time_s + ((first + last) / 2.0 / n_rows - 0.5) * readout_s
            strip: FloatImage = np.zeros((last - first, options.shape[1]), np.float32)
            for picture in range(n_pictures):
                time = middle_s + ((picture + 0.5) / n_pictures - 0.5) * exposure_s
                pose = self._camera.mounted(path.pose(time))
                strip += self._renderer.render(pose, time, (first, last))
            strips.append(strip * np.float32(1.0 / n_pictures))
        return self._sensor.develop(np.concatenate(strips), index)


class Sensor:
    """Converts light to frames.

    The lens loses the share `vignette` of the light in the corners. Elsewhere, the loss is
    proportional to 1 - cos⁴ of the angle to the optical axis. `noise` and `shot_noise` are
    standard deviations, as shares of full light. The former is the same in every pixel; the
    variance of the latter is proportional to the light. Grey levels are 255 light^(1 / gamma).
    """

    def __init__(self, options: FlightOptions) -> None:
        self._transmission = _transmission(options.camera, options.vignette)
        self._shot, self._read, self._seed = options.shot_noise, options.noise, options.seed
        steps = np.linspace(0.0, 1.0, _N_STEPS)
        self._levels = np.rint(255.0 * steps ** (1.0 / options.gamma)).astype(np.uint8)

    def develop(self, light: FloatImage, index: int) -> GreyImage:
        """Frame number `index`, (H, W) uint8, from light, (H, W), where white is 1.

        The noise depends only on the seed and on `index`. `light` is overwritten.
        """
        light *= self._transmission
        if self._shot or self._read:
            # Rounding can make the light slightly negative.
            deviation = np.maximum(light, 0.0) * np.float32(self._shot**2)
            deviation += np.float32(self._read**2)
            np.sqrt(deviation, out=deviation)
            # Quantiles drawn at random are three times as fast as NumPy's normal generator; their
            # range is ±4.3 standard deviations.
            bits = np.random.SFC64([self._seed, index]).random_raw(-(-light.size // 4))
            drawn = bits.view(np.uint16)[: light.size]
            deviation *= _quantiles().take(drawn).reshape(light.shape)
            light += deviation
        np.clip(light, 0.0, 1.0, out=light)
        light *= _N_STEPS - 1
        light += np.float32(0.5)
        return self._levels.take(light.astype(np.uint16))


@cache
def _quantiles() -> FloatImage:
    """Midpoint quantiles of the normal distribution for `_N_STEPS` equal parts."""
    quantile = NormalDist().inv_cdf
    return np.array([quantile((i + 0.5) / _N_STEPS) for i in range(_N_STEPS)], np.float32)


def _transmission(camera: Camera, vignette: float) -> FloatImage:
    """Transmission of the lens, (H, W)."""
    height, width = camera.shape
    x = (np.arange(width) + 0.5 - width / 2.0) / camera.focal_px
    y = (np.arange(height) + 0.5 - height / 2.0) / camera.focal_px
    cosine4 = 1.0 / (1.0 + np.add.outer(y**2, x**2)) ** 2
    darkest = 1.0 / (1.0 + math.hypot(width / 2.0, height / 2.0) ** 2 / camera.focal_px**2) ** 2
    lost = vignette * (1.0 - cosine4) / (1.0 - darkest)
    return (1.0 - lost).astype(np.float32)


_AWAY = "a cube that recedes from the camera"
_ACROSS = "cubes that cross the image, each at its own speed"
# Starts where the looming cube ends: each is the other played backwards.
_RECEDING = ApproachOptions(distance_m=ApproachOptions.speed_m_s / ApproachOptions.fps)
_FLAT: tuple[Scene[Any], ...] = (
    Approach("looming-cube", "a cube that approaches the camera", ApproachOptions(), "cube"),
    Approach("receding-cube", _AWAY, _RECEDING, "cube", recedes=True),
    Approach("looming-ball", "a ball that approaches the camera", ApproachOptions(), "ball"),
    Translation("translating-cubes", _ACROSS, TranslationOptions()),
)


def _flights() -> Iterator[FlightScene]:
    """First-person flights: collisions, the paper's Fig. 8, near misses, and random ones."""
    builders: dict[str, Callable[..., Stage]] = {
        "ball-and-capsules": ball_and_capsules,
        "random": random_flight,
    }
    named = yaml.safe_load(Path(__file__).with_name("scenes.yaml").read_text("utf-8"))
    for name, spec in named.items():
        kind = RandomOptions if name == "random" else FlightOptions
        options = kind(shape=spec["size_wh"][::-1])
        yield FlightScene(
            name, spec["shows"], options, builders.get(name, partial(named_flight, spec))
        )


SCENES: dict[str, Scene[Any]] = {scene.name: scene for scene in (*_FLAT, *_flights())}


def find_scene(name: str) -> Scene[Any]:
    """The scene called `name`; raises ParameterError if there is none.

    Examples
    --------
    >>> scene = find_scene("looming-cube")
    >>> options = scene.configure({"speed": 2.0, "size": (135, 240)})
    >>> next(scene.frames(options)).shape
    (135, 240)
    """
    if name not in SCENES:
        hint = did_you_mean(name, SCENES) + f"Choose from {', '.join(SCENES)}."
        raise ParameterError("", f"there is no scene {name[:100]!r}", hint)
    return SCENES[name]


def recorded_stage(video: Path) -> Stage | None:
    """The room and the flight of a video that was rendered, from the record beside it.

    None if the record is that of something else. Raises ResultError if it cannot be read, or if
    this version would fly another flight.
    """
    path = video.with_suffix(".yaml")
    facts = read_record(path)
    scene, given = SCENES.get(str(facts.get("scene"))), facts.get("options", {})
    if facts and not isinstance(scene, FlightScene):
        return None
    try:
        if not isinstance(scene, FlightScene):
            raise ValueError
        chosen: dict[str, Any] = {k.replace("-", "_"): value for k, value in given.items()}
        chosen["size"] = parse_size(str(given.get("size")))[::-1]
        if "speed" in given:
            chosen["speed"] = tuple(map(float, str(given["speed"]).split(":")))
        options = scene.configure(chosen)
        record = scene.record(options)
        if record != {key: facts.get(key) for key in record}:
            raise ValueError
    except (ParameterError, ValueError):
        why = "is damaged, or the record of a flight that this version renders differently"
        raise ResultError(str(path), why) from None
    return scene.stage(options)


class _Frames:
    """The frames of a scene, (H, W) uint8; every iteration renders them again."""

    def __init__(self, scene: Scene[Any], options: ClipOptions) -> None:
        self._scene, self._options = scene, options

    def __iter__(self) -> Iterator[GreyImage]:
        return self._scene.frames(self._options)

    def __len__(self) -> int:
        return self._scene.n_frames(self._options)


def open_scene(
    name: str | Scene[Any], given: Mapping[str, Any] | None = None, **options: Any
) -> Video:
    """Open a scene as a source, such as ``open_scene("group2", {"size": (135, 240)})``.

    `name` may be a custom scene. `given` are options of the scene, see `Scene.configure`, and
    `options` those of `open_video`.
    Raises ParameterError if there is no such scene, or it cannot be rendered like that.
    """
    scene = find_scene(name) if isinstance(name, str) else name
    chosen = scene.configure(given or {})
    return open_video(_Frames(scene, chosen), input_fps=chosen.fps, **options)
