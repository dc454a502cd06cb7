"""Flights as scenes: each is built from a seed, filmed, and known in every detail."""

import math
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import Any

from dlgmd_cli.flights.film import film
from dlgmd_cli.flights.options import FlightOptions
from dlgmd_cli.flights.renderer.camera import Camera
from dlgmd_cli.flights.stage import Stage
from dlgmd_cli.flights.truth import FlightTruth, truth_rows
from dlgmd_cli.stimuli.base import MAX_FRAMES, GreyImage, Scene, invalid

# What rounding may take from a time that is a whole number of frames.
_TOLERANCE = 1e-6


class FlightScene(Scene[FlightOptions]):
    """A flight through a place.

    Parameters
    ----------
    name, description, defaults
        See `Scene`.
    stage : callable
        Builds the place and the flight from a seed; a function of a module, so that other
        processes can be told of it.
    """

    truth_type = FlightTruth
    is_playable = True
    has_record = True

    def __init__(
        self,
        name: str,
        description: str,
        defaults: FlightOptions,
        stage: Callable[[int], Stage],
    ) -> None:
        self.name, self.description, self.defaults = name, description, defaults
        self._build = stage
        self._built: tuple[int, Stage] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": None}

    def stage(self, options: FlightOptions) -> Stage:
        """The place and the flight; the last one is kept."""
        if self._built is None or self._built[0] != options.seed:
            self._built = options.seed, self._build(options.seed)
        return self._built[1]

    def n_frames(self, options: FlightOptions) -> int:
        """As many as asked for, else the whole flight."""
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
        """What is so at each frame, from the geometry alone."""
        camera = Camera(options.shape, options.fov_deg)
        return truth_rows(self.stage(options), camera, options.fps, self.n_frames(options))

    def record(self, options: FlightOptions) -> dict[str, Any]:
        """What is so of the clip as a whole.

        Returns
        -------
        dict
            `width`, `height`, `fps` and `frames`; the `target`; `collision_frame`, the first at or
            after the contact with it, None if the clip has none; `collision_time_s`, None if the
            flight has none; and `phases`, each with its `name`, `first_frame` and `last_frame`.
        """
        stage, n_frames = self.stage(options), self.n_frames(options)
        height, width = options.shape
        return {
            "width": width,
            "height": height,
            "fps": options.fps,
            "frames": n_frames,
            "target": stage.target,
            "collision_frame": _first_frame(stage.contact_s, options.fps, n_frames),
            "collision_time_s": None if stage.contact_s is None else float(stage.contact_s),
            "phases": list(_phases(stage, options.fps, n_frames)),
        }


def _first_frame(time_s: float | None, fps: float, n_frames: int) -> int | None:
    """The first of `n_frames` frames at or after a time; None if there is none."""
    if time_s is None:
        return None
    frame = math.ceil(time_s * fps - _TOLERANCE)
    return frame if frame < n_frames else None


def _phases(stage: Stage, fps: float, n_frames: int) -> Iterator[dict[str, Any]]:
    """Every phase that a frame is in."""
    names = (stage.path.phase(index / fps) for index in range(n_frames))
    first = 0
    for name, frames in groupby(names):
        after = first + sum(1 for _ in frames)
        yield {"name": name, "first_frame": first, "last_frame": after - 1}
        first = after
