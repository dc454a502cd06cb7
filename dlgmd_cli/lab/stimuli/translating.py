"""Squares that translate horizontally, one per row."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from dlgmd_cli.lab.stimuli.base import MAX_SIDE_PX, GreyImage, Scene, invalid, option
from dlgmd_cli.lab.stimuli.plain import (
    DEFAULT_FRAMES,
    FlatOptions,
    FlatTruth,
    Patch,
    rectangle,
    render,
)


@dataclass(frozen=True)
class TranslationOptions(FlatOptions):
    """Options of a scene with horizontally moving squares.

    Each square has its own speed, from top to bottom; negative speeds are to the left. The size is
    a ninth of the picture's height unless given.
    """

    object_size_px: float | None = option(
        None, "--object-size", 0, MAX_SIDE_PX, unit="px", low_open=True
    )
    speeds_px: tuple[float, ...] = option(
        (1.0, 2.0, 3.0, 4.0), "--speed", -MAX_SIDE_PX, MAX_SIDE_PX, unit="px/frame"
    )

    @property
    def side_px(self) -> float:
        """Side of the squares, in px."""
        return self.shape[0] / 9.0 if self.object_size_px is None else self.object_size_px


class Translation(Scene[TranslationOptions]):
    """Squares that stay fully visible, and are in the middle halfway through the clip."""

    truth_type = FlatTruth

    def __init__(self, name: str, description: str, defaults: TranslationOptions) -> None:
        self.name, self.description, self.defaults = name, description, defaults

    def n_frames(self, options: TranslationOptions) -> int:
        """Number of frames: as set, else as many as the picture has room for, 75 at most."""
        height, width = options.shape
        n_squares, side, speeds = len(options.speeds_px), options.side_px, options.speeds_px
        if n_squares == 0 or 0.0 in speeds:
            raise invalid("--speed", "every square needs a speed other than 0")
        if side * n_squares > height or side > width:
            squares = f"{n_squares} squares" if n_squares > 1 else "a square"
            raise invalid(
                "--object-size",
                f"{squares} of {side:g} px cannot fit into a picture of {width}x{height}",
                f"Choose {math.floor(min(height / n_squares, width))} px or less.",
            )
        fastest = max(map(abs, speeds))
        # The margin is for speeds such as 0.1 that floats cannot represent exactly.
        room = math.floor((width - side) / fastest + 1e-6) + 1
        if options.n_frames is not None and options.n_frames > room:
            raise invalid(
                "--frames",
                f"a square at {fastest:g} px/frame leaves the picture after {room} frames",
                f"Choose 1 to {room}, a lower --speed, or a wider --size.",
            )
        return options.n_frames or min(DEFAULT_FRAMES, room)

    def frames(self, options: TranslationOptions) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8."""
        n_frames = self.n_frames(options)
        return render(options, n_frames, lambda index: _squares(options, index, n_frames))

    def truth(self, options: TranslationOptions) -> Iterator[FlatTruth]:
        """The ground truth of each frame; the angular size is that of a square in the middle."""
        angle = 2.0 * math.atan2(options.side_px, 2.0 * options.focal_px)
        for index in range(self.n_frames(options)):
            yield FlatTruth(index, index / options.fps, math.degrees(angle), 0.0, math.nan)


def _squares(options: TranslationOptions, index: int, n_frames: int) -> Iterator[Patch]:
    """The squares at frame `index`."""
    height, width = options.shape
    row_height = height / len(options.speeds_px)
    for row, speed in enumerate(options.speeds_px):
        x = width / 2.0 + speed * (index - (n_frames - 1) / 2.0)
        center_yx = ((row + 0.5) * row_height, x)
        yield rectangle(options.shape, center_yx, (options.side_px, options.side_px))
