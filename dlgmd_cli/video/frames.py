"""What every input looks like: numbered and timed pictures, facts about their origin, decoders."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]

FALLBACK_FPS = 30.0
MAX_PLAUSIBLE_FPS = 1000.0
# Thirty years; where a stream has no start, OpenCV's timestamps are astronomic.
MAX_PLAUSIBLE_TIME_S = 1e9
# A damaged packet fails one grab, the end of a stream all that follow. Pictures from before the
# damage may still be inside the decoder's threads.
GRABS_PAST_DAMAGE = 32
# How many pictures readers can be asked to keep as they are; memory is used again after that.
KEPT_PICTURES = 6


@dataclass(frozen=True)
class SourceInfo:
    """Facts about an input.

    Attributes
    ----------
    path : str
        Where it lies, absolute.
    name : str
        What its results are called: a file's stem, a folder's name.
    width, height : int
        Size of its pictures as they are shown, in px.
    fps : float
        Nominal frames per second.
    n_frames : int or None
        How many frames it is said to have: a hint for a progress bar, often wrong.
    decoder : str
        What decodes it: opencv or pyav.
    """

    path: str
    name: str
    width: int
    height: int
    fps: float
    n_frames: int | None
    decoder: str = "opencv"


@dataclass(frozen=True)
class Picture:
    """A decoded picture: uint8 or uint16, (H, W) or (H, W, channels) in BGR order.

    `levels` are the levels of black and white, where they are not the least and the greatest that
    its type holds.
    """

    index: int
    time_s: float
    image: Image
    levels: tuple[int, int] | None = None


@dataclass(frozen=True)
class Frame:
    """A frame as models take it.

    `grey` is (H, W): uint8 levels of 0..255 where the input has 8 bits, else float32 in 0..1.
    """

    index: int
    time_s: float
    grey: Image

    @property
    def luminance(self) -> npt.NDArray[np.float32]:
        """The same as float32 in 0..1, shape (H, W)."""
        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)


class Verdict(Enum):
    """What to do with a frame of which only the time is known yet."""

    TAKE = "take"
    SKIP = "skip"
    STOP = "stop"


Select = Callable[[float], Verdict]


@dataclass
class Progress:
    """How far the reading came, kept up to date while it goes on."""

    n_decoded: int = 0
    last_time_s: float = math.nan
    warnings: list[str] = field(default_factory=list)


class Reader(Protocol):
    """Pictures in order from one input; what spoils the reading ends it with a warning."""

    info: SourceInfo
    progress: Progress

    def pictures(self, select: Select, n_kept: int = 1) -> Iterator[Picture]:
        """Every picture that `select` takes; an `image` is valid until `n_kept` more of them."""
        ...

    def close(self) -> None:
        """Free the input; may be called twice."""
        ...


class VideoFacts(NamedTuple):
    """What a video file says about itself; `None` where it says nothing.

    `width` and `height` are those of its first frame as it is shown. `shown_s` is how much of its
    frames it shows, in seconds, where something may hide others; infinite otherwise.
    """

    width: int
    height: int
    fps: float | None
    n_frames: int | None
    shown_s: float = math.inf


class Grab(NamedTuple):
    """A frame that is known to be there: its timestamp in seconds, NaN for none.

    `new_size` is its width and height, where they are not the first frame's.
    """

    stamp_s: float
    new_size: tuple[int, int] | None = None


class Decoded(NamedTuple):
    """The image and the levels of a `Picture`."""

    image: Image
    levels: tuple[int, int] | None = None


class Decoder(Protocol):
    """Frames of one video file, from its beginning. Made with a name that FFmpeg opens as it is.

    Attributes
    ----------
    is_damaged : bool
        Whether something after the first frame could not be decoded, as far as it was read.
    """

    is_damaged: bool

    def open(self) -> VideoFacts | None:
        """Open the file and decode its first frame; None if there is none."""
        ...

    def grabs(self) -> Iterator[Grab]:
        """Every frame from the first on; once after each `open`."""
        ...

    def keep(self, n_pictures: int) -> None:
        """From now on, leave an image as it is until so many more were asked for."""
        ...

    def picture(self) -> Decoded | None:
        """The frame grabbed last, see `keep`; None if it is damaged."""
        ...

    def close(self) -> None:
        """Free the file, so that it can be opened again; may be called twice."""
        ...


def plausible_fps(fps: float) -> float | None:
    """`fps` if it can be a frame rate, else None."""
    return fps if math.isfinite(fps) and 0.0 < fps <= MAX_PLAUSIBLE_FPS else None
