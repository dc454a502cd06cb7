"""What is read of an input, and how: the choice that run.yaml records, apart from any command."""

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import ParameterError

if TYPE_CHECKING:
    from dlgmd_cli.video.frames import SourceInfo
    from dlgmd_cli.video.prepare import Source


@dataclass(frozen=True)
class InputChoice:
    """What is read of an input, and which normalised membrane potential is thresholded.

    None stands for the default everywhere; `scale`, `size` and the rest are those of
    `open_source`, and `normalise` is `absolute` or `sequence`.

    Raises
    ------
    ParameterError
        If two of them exclude each other.
    """

    scale: float | None = None
    size: tuple[int, int] | None = None
    fps: float | None = None
    input_fps: float | None = None
    decoder: str | None = None
    start: float | None = None
    end: float | None = None
    normalise: str | None = None

    def __post_init__(self) -> None:
        if self.scale is not None and self.size is not None:
            raise ParameterError("", "--scale and --size exclude each other", "Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ParameterError("", f"--end {self.end:g} is not after --start {self.start:g}")

    def n_expected(self, info: "SourceInfo") -> int | None:
        """The number of frames until the end asked for, as far as the input says."""
        if info.n_frames is None or self.end is None:
            return info.n_frames
        return min(info.n_frames, math.ceil(self.end * info.fps))

    def to_record(self) -> dict[str, Any]:
        """What is not left to the default, as a record holds it."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.size is not None:
            values["size"] = "{}x{}".format(*self.size)
        return {key: value for key, value in values.items() if value is not None}

    @property
    def by_sequence(self) -> bool:
        """Whether spikes follow the MP normalised by its own sequence."""
        return self.normalise == "sequence"

    def open(self, path: str) -> "Source":
        """The frames that these options ask for; raises SourceError."""
        from dlgmd_cli.video.open import open_source
        from dlgmd_cli.video.reader import DEFAULT_DECODER

        return open_source(
            path,
            scale=self.scale,
            size_wh=self.size,
            start_s=self.start or 0.0,
            end_s=math.inf if self.end is None else self.end,
            max_fps=self.fps,
            input_fps=self.input_fps,
            decoder=self.decoder or DEFAULT_DECODER,
        )
