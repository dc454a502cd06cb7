"""Flights as scenes: built from a seed, filmed, and with full ground truth."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from dlgmd_cli.lab.flights.image_speed import ImageSpeed
from dlgmd_cli.lab.flights.path import Stage
from dlgmd_cli.lab.flights.renderer.camera import Camera
from dlgmd_cli.lab.flights.renderer.painter import Renderer
from dlgmd_cli.lab.flights.renderer.sensor import Sensor
from dlgmd_cli.lab.flights.renderer.texture import FloatImage
from dlgmd_cli.lab.flights.truth import FlightTruth, truth_rows
from dlgmd_cli.lab.stimuli.base import (
    MAX_FRAMES,
    ClipOptions,
    GreyImage,
    Scene,
    invalid,
    option,
    switch,
)

# Rounding tolerance for times in ms and in frames.
_TOLERANCE = 1e-6
# Motion blur averages several pictures; a rolling shutter is rendered in strips of rows. Each has a
# greatest motion per step and a greatest number, which is also used while the light changes.
_BLUR_STEP_PX, _MAX_PICTURES = 1.0, 64
_STRIP_STEP_PX, _MAX_STRIPS = 0.5, 128
_TOO_FAST_PX_S = 1e12


@dataclass(frozen=True)
class FlightOptions(ClipOptions):
    """Options of all flights: those of the camera and the drone, besides those of every clip.

    For the noise see `Sensor`. An exposure or rolling shutter of 0 disables it. `agile` says
    whether the drone follows commands at once, see `fly`; None leaves it to the scene.
    """

    fov_deg: float = option(80.0, "--fov", 1, 170, unit="degrees")
    exposure_ms: float = option(0.0, "--exposure", 0, 1000, unit="ms")
    vignette: float = option(0.3, "--vignette", 0, 1)
    noise: float = option(0.002, "--noise", 0, 1)
    shot_noise: float = option(0.01, "--shot-noise", 0, 1)
    gamma: float = option(2.2, "--gamma", 1, 4)
    rolling_shutter_ms: float = option(0.0, "--rolling-shutter", 0, 1000, unit="ms")
    agile: bool | None = switch(None, "--agile")

    def __post_init__(self) -> None:
        super().__post_init__()
        period_ms = 1000.0 / self.fps
        for flag, value in (
            ("--exposure", self.exposure_ms),
            ("--rolling-shutter", self.rolling_shutter_ms),
        ):
            if value > period_ms + _TOLERANCE:
                raise invalid(
                    flag,
                    f"{value:g} ms is longer than a frame at {self.fps:g} frames/s",
                    f"Choose {period_ms:.4g} or less, or a lower --fps.",
                )


class FlightScene(Scene[FlightOptions]):
    """A flight through a room.

    `stage` builds the room and the flight from a seed and `FlightOptions.agile`; it must be
    picklable.
    """

    truth_type = FlightTruth
    is_flight = True

    def __init__(
        self,
        name: str,
        description: str,
        defaults: FlightOptions,
        stage: Callable[[int, bool | None], Stage],
    ) -> None:
        self.name, self.description, self.defaults = name, description, defaults
        self._build = stage
        self._built: tuple[tuple[int, bool | None], Stage] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": None}

    def stage(self, options: FlightOptions) -> Stage:
        """The room and the flight; the latest is cached."""
        wanted = options.seed, options.agile
        if self._built is None or self._built[0] != wanted:
            self._built = wanted, self._build(*wanted)
        return self._built[1]

    def n_frames(self, options: FlightOptions) -> int:
        """Number of frames: as set, else the whole flight."""
        n_all = math.floor(self.stage(options).duration_s * options.fps + _TOLERANCE) + 1
        if options.n_frames is not None and options.n_frames > n_all:
            raise invalid(
                "--frames",
                f"the flight ends after {n_all} frames",
                f"Choose 1 to {n_all}, or a higher --fps.",
            )
        n_frames = options.n_frames or n_all
        if n_frames > MAX_FRAMES:
            raise invalid(
                "--fps",
                f"the flight has {n_frames} frames, and a clip has {MAX_FRAMES} at most",
                "Lower it, or end the clip earlier with --frames.",
            )
        return n_frames

    def frames(self, options: FlightOptions) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8."""
        return film(self.stage(options), options, self.n_frames(options))

    def truth(self, options: FlightOptions) -> Iterator[FlightTruth]:
        """The ground truth of each frame, computed from the geometry."""
        camera = Camera(options.shape, options.fov_deg)
        return truth_rows(self.stage(options), camera, options.fps, self.n_frames(options))

    def record(self, options: FlightOptions) -> dict[str, Any]:
        """Properties of the clip, as documented in the README of the sample videos.

        `collision_frame` is the first frame at or after contact, None if there is none.
        """
        stage, n_frames = self.stage(options), self.n_frames(options)
        height, width = options.shape
        frame = None
        if stage.contact_s is not None:
            frame = math.ceil(stage.contact_s * options.fps - _TOLERANCE)
        phases: list[dict[str, Any]] = []
        names = [stage.path.phase(index / options.fps) for index in range(n_frames)]
        for name, group in groupby(range(n_frames), key=names.__getitem__):
            frames = list(group)
            phases.append({"name": name, "first_frame": frames[0], "last_frame": frames[-1]})
        return {
            "width": width,
            "height": height,
            "fps": options.fps,
            "frames": n_frames,
            "agile": stage.agile,
            "target": stage.target,
            "collision_frame": frame if frame is not None and frame < n_frames else None,
            "collision_time_s": None if stage.contact_s is None else float(stage.contact_s),
            "phases": phases,
        }


def film(stage: Stage, options: FlightOptions, n_frames: int) -> Iterator[GreyImage]:
    """The frames of a flight in order, (H, W) uint8.

    Frame i is taken at i / fps: the middle of the exposure, and the time of the middle row with a
    rolling shutter.
    """
    camera = Camera(options.shape, options.fov_deg)
    sensor = Sensor(
        camera,
        vignette=options.vignette,
        shot_noise=options.shot_noise,
        read_noise=options.noise,
        gamma=options.gamma,
        seed=options.seed,
    )
    renderer = Renderer(stage.world, camera)
    speeds = ImageSpeed(stage.world, camera, stage.target)
    exposure_s, readout_s = options.exposure_ms / 1000.0, options.rolling_shutter_ms / 1000.0
    n_rows = camera.shape[0]
    for index in range(n_frames):
        time_s = index / options.fps
        speed = _fastest(stage, speeds, time_s, (exposure_s + readout_s) / 2.0)
        n_pictures = _steps(speed * exposure_s / _BLUR_STEP_PX, _MAX_PICTURES)
        n_strips = _steps(speed * readout_s / _STRIP_STEP_PX, min(_MAX_STRIPS, n_rows))
        borders = np.linspace(0, n_rows, n_strips + 1).round().astype(int).tolist()
        strips = []
        for first, last in pairwise(borders):
            middle_s = time_s + ((first + last) / 2.0 / n_rows - 0.5) * readout_s
            light: FloatImage = np.zeros((last - first, camera.shape[1]), np.float32)
            for picture in range(n_pictures):
                time = middle_s + ((picture + 0.5) / n_pictures - 0.5) * exposure_s
                light += renderer.render(stage.path.pose(time), time, (first, last))
            strips.append(light * np.float32(1.0 / n_pictures))
        yield sensor.develop(np.concatenate(strips), index)


def _fastest(stage: Stage, speeds: ImageSpeed, time_s: float, half_s: float) -> float:
    """The greatest image speed around a time, in px/s; 0 without exposure and readout time."""
    if half_s == 0.0:
        return 0.0
    if stage.world.light(time_s - half_s) != stage.world.light(time_s + half_s):
        return _TOO_FAST_PX_S
    return speeds.fastest(stage.path.state(time_s), time_s)


def _steps(wanted: float, most: int) -> int:
    """A whole number of steps from 1 to `most`."""
    return min(max(math.ceil(wanted), 1), most)
