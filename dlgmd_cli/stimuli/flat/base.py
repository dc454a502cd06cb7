"""What the flat scenes share: objects of one luminance on a background of another."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.stimuli.base import ClipOptions, GreyImage, invalid, option
from dlgmd_cli.stimuli.flat.shapes import FloatImage, Patch

DEFAULT_FRAMES = 75


@dataclass(frozen=True)
class FlatOptions(ClipOptions):
    """What all flat scenes can be told.

    Attributes
    ----------
    contrast : float
        Weber contrast of the object, (object - background) / background.
    background : float
        Luminance of the background in 0..1; 1 is grey level 255, in proportion.
    noise : float
        Standard deviation of Gaussian noise that every pixel of every frame gets, in units of
        luminance, before frames are rounded to grey levels. `seed` is where it starts.
    """

    contrast: float = option(-0.75, "--contrast", -1, 1000)
    background: float = option(0.8, "--background", 0, 1, low_open=True)
    noise: float = option(0.0, "--noise", 0, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.object_luminance <= 1.0:
            raise invalid(
                "--contrast",
                f"{self.contrast:g} on a background of {self.background:g} makes the object "
                "brighter than white",
                f"Choose -1 to {1 / self.background - 1:.3g}, or a darker --background.",
            )

    @property
    def object_luminance(self) -> float:
        """Luminance of the object in 0..1."""
        return self.background * (1.0 + self.contrast)


@dataclass(frozen=True)
class FlatTruth:
    """What is so at one frame of a flat scene."""

    frame: int
    time_s: float
    angular_size_deg: float
    angular_velocity_deg_s: float
    time_to_contact_s: float


def render(
    options: FlatOptions, n_frames: int, patches: Callable[[int], Iterable[Patch]]
) -> Iterator[GreyImage]:
    """Frames of objects that are all alike, `patches` of the frame's index, on the background."""
    rng = np.random.default_rng(options.seed)
    for index in range(n_frames):
        picture: FloatImage = np.full(options.shape, options.background, np.float32)
        for patch in patches(index):
            patch.paint(picture, options.object_luminance)
        if options.noise > 0.0:
            picture += options.noise * rng.standard_normal(options.shape, np.float32)
        yield np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
