"""A flight as its camera films it: each frame is what the shutter lets in around its time."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dlgmd_cli.flights.image_speed import ImageSpeed
from dlgmd_cli.flights.options import FlightOptions
from dlgmd_cli.flights.renderer.camera import Camera
from dlgmd_cli.flights.renderer.painter import Renderer
from dlgmd_cli.flights.renderer.sensor import Sensor
from dlgmd_cli.flights.renderer.texture import FloatImage
from dlgmd_cli.flights.stage import Stage
from dlgmd_cli.stimuli.base import GreyImage

# How far the fastest point may move between two pictures that are blurred into one, and from one
# strip of rows that are taken at the same time to the next; and how many there are at most, which
# is how many there are while the light changes.
_BLUR_STEP_PX, _MAX_PICTURES = 1.0, 64
_STRIP_STEP_PX, _MAX_STRIPS = 0.5, 128
_TOO_FAST_PX_S = 1e12


def film(stage: Stage, options: FlightOptions, n_frames: int) -> Iterator[GreyImage]:
    """The frames of a flight in order.

    Frame i is taken at i / fps. With an exposure, that is the middle of the time that the shutter
    is open; with a rolling shutter, it is the time of the middle row.

    Parameters
    ----------
    stage : Stage
    options : FlightOptions
        Of the camera.
    n_frames : int

    Yields
    ------
    ndarray, shape (H, W), uint8
    """
    camera = Camera(options.shape, options.fov_deg)
    shutter = _Shutter(stage, camera, options)
    sensor = Sensor(
        camera,
        vignette=options.vignette,
        shot_noise=options.shot_noise,
        read_noise=options.noise,
        gamma=options.gamma,
        seed=options.seed,
    )
    for index in range(n_frames):
        yield sensor.develop(shutter.light(index / options.fps), index)


class _Shutter:
    """What light reaches the sensor of the camera of a flight."""

    def __init__(self, stage: Stage, camera: Camera, options: FlightOptions) -> None:
        self._path, self._n_rows = stage.path, camera.shape[0]
        self._renderer = Renderer(stage.world, camera)
        self._exposure_s = options.exposure_ms / 1000.0
        self._readout_s = options.rolling_shutter_ms / 1000.0
        self._speed = ImageSpeed(stage.world, camera, stage.target)
        self._light = stage.world.light

    def light(self, time_s: float) -> FloatImage:
        """The frame at a time, (H, W), linear."""
        if not (self._exposure_s or self._readout_s):
            return self._renderer.render(self._path.pose(time_s), time_s)
        speed = self._speed.fastest(self._path.state(time_s), time_s)
        half_s = (self._exposure_s + self._readout_s) / 2.0
        if self._light(time_s - half_s) != self._light(time_s + half_s):
            speed = _TOO_FAST_PX_S
        n_pictures = _steps(speed * self._exposure_s / _BLUR_STEP_PX, _MAX_PICTURES)
        n_strips = _steps(speed * self._readout_s / _STRIP_STEP_PX, min(_MAX_STRIPS, self._n_rows))
        borders = np.linspace(0, self._n_rows, n_strips + 1).round().astype(int).tolist()
        strips = []
        for first, last in pairwise(borders):
            late = ((first + last) / 2.0 / self._n_rows - 0.5) * self._readout_s
            strips.append(self._exposed(time_s + late, n_pictures, (first, last)))
        return np.concatenate(strips)

    def _exposed(self, time_s: float, n_pictures: int, rows: tuple[int, int]) -> FloatImage:
        """The mean of what some rows see while the shutter is open."""
        total: FloatImage | None = None
        for index in range(n_pictures):
            time = time_s + ((index + 0.5) / n_pictures - 0.5) * self._exposure_s
            seen = self._renderer.render(self._path.pose(time), time, rows)
            total = seen if total is None else np.add(total, seen, out=total)
        assert total is not None
        total *= np.float32(1.0 / n_pictures)
        return total


def _steps(wanted: float, most: int) -> int:
    """A whole number of steps from 1 to `most`."""
    return min(max(math.ceil(wanted), 1), most)
