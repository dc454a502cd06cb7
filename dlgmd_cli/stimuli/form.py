"""What a clip's frames are kept in: a video, or a folder of pictures."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2

from dlgmd_cli.stimuli.base import ClipOptions, GreyImage, invalid
from dlgmd_cli.video.writer import MAX_TICKS_PER_S, best_codec, write_video

_SUFFIXES = {"mpeg4": ".mp4", "h264": ".mp4", "ffv1": ".avi", "png": ""}
# The least number of digits in a name that counts.
N_DIGITS = 4


@dataclass(frozen=True)
class Form:
    """How frames are kept.

    Attributes
    ----------
    codec : {"mpeg4", "h264", "ffv1", "png"}
        The last two keep every grey level.
    """

    codec: str

    @classmethod
    def choose(cls, *, lossless: bool = False, png: bool = False, playable: bool = False) -> "Form":
        """What is asked for.

        Parameters
        ----------
        lossless : bool
            A video in FFV1, which keeps every grey level.
        png : bool
            A folder of PNG, which keeps them, too.
        playable : bool
            Otherwise, what most players show: H.264 where it can be had, not MPEG-4.
        """
        if png:
            return cls("png")
        if lossless:
            return cls("ffv1")
        return cls(best_codec() if playable else "mpeg4")

    @property
    def is_video(self) -> bool:
        """Whether it is a single file."""
        return self.codec != "png"

    @property
    def made_by(self) -> tuple[str, ...]:
        """What beside OpenCV makes it, as `results.record.versions` takes it."""
        return ("pyav",) if self.codec == "h264" else ()

    def path(self, folder: Path, name: str) -> Path:
        """Where the frames of a clip of this name are."""
        return folder / f"{name}{_SUFFIXES[self.codec]}"

    def check(self, options: ClipOptions) -> None:
        """Raise ParameterError if a video would not keep the size or the frame rate as they are."""
        if not self.is_video:
            return
        height, width = options.shape
        if height % 2 or width % 2:  # OpenCV would cut off a row or a column, silently
            raise invalid(
                "--size",
                f"{width}x{height} is odd, and a video needs an even width and height",
                f"Choose {width + width % 2}x{height + height % 2}, or --png.",
            )
        rounded = round(options.fps, 3)
        if rounded != options.fps:
            raise invalid(
                "--fps",
                f"{options.fps!r} has more than three decimals, which a video file does not keep",
                f"Choose {rounded:g}, or --png.",
            )
        if self.codec == "mpeg4" and Fraction(str(rounded)).numerator > MAX_TICKS_PER_S:
            raise invalid(
                "--fps", f"MPEG-4 cannot hold {rounded:g}", "Choose fewer decimals, or --lossless."
            )

    def write(
        self,
        path: Path,
        frames: Iterable[GreyImage],
        n_frames: int,
        options: ClipOptions,
        *,
        target: Path | None = None,
    ) -> None:
        """Keep `n_frames` frames, (H, W) uint8 each; an error names `target` if it is given.

        Raises OutputError, or OSError for pictures, if they cannot be written.
        """
        if self.is_video:
            shape, fps = options.shape, options.fps
            write_video(path, frames, shape, fps, codec=self.codec, target=target)
            return
        path.mkdir()
        digits = n_digits(n_frames)
        for index, frame in enumerate(frames):
            # Not by OpenCV, which says nothing of a full disk.
            (path / f"{index:0{digits}d}.png").write_bytes(cv2.imencode(".png", frame)[1].tobytes())


def n_digits(count: int) -> int:
    """Digits in the names of `count` things, numbered from 0."""
    return max(N_DIGITS, len(str(count - 1)))
