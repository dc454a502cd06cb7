"""The options that choose what is read of an input, shared by every command that reads one."""

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._types import FiniteRange, OptionGroup, Size, Time
from dlgmd_cli.errors import ParameterError

if TYPE_CHECKING:
    from dlgmd_cli.sources.base import SourceInfo
    from dlgmd_cli.sources.prepare import Source

NORMALISATIONS = ("absolute", "sequence")
DECODERS = ("opencv", "pyav")

_RATE = FiniteRange(min=0, min_open=True, max=100_000)
_TYPES: dict[str, click.ParamType] = {
    "scale": FiniteRange(min=0, min_open=True, max=1),
    "size": Size(),
    "fps": _RATE,
    "input_fps": _RATE,
    "start": Time(),
    "end": Time(),
    "decoder": click.Choice(DECODERS),
    "normalise": click.Choice(NORMALISATIONS),
}

decoder_option = click.option(
    "--decoder",
    type=_TYPES["decoder"],
    help="What decodes a video; pictures are read the same with both. PyAV needs "
    "pip install 'dlgmd[fast]'.  [default: opencv]",
)

input_options = OptionGroup(
    "given",
    dict,
    click.option(
        "--scale",
        type=_TYPES["scale"],
        metavar="S",
        help="Linear scale of the processed frame.  [default: fits the width to 480 px]",
    ),
    click.option("--size", type=_TYPES["size"], help="An exact processed size instead."),
    click.option(
        "--fps", type=_RATE, metavar="F", help="Process at most F frames a second; times stay true."
    ),
    click.option(
        "--input-fps",
        type=_RATE,
        metavar="F",
        help="Frame rate of pictures, or of a video that states none.  [default: 30]",
    ),
    decoder_option,
    click.option("--start", type=_TYPES["start"], help="Seconds or HH:MM:SS.mmm."),
    click.option("--end", type=_TYPES["end"], help="Seconds or HH:MM:SS.mmm, excluded."),
    click.option(
        "--normalise",
        type=_TYPES["normalise"],
        help="Which normalised MP drives the spikes.  [default: absolute]",
    ),
)


@dataclass(frozen=True)
class InputChoice:
    """What is read of an input, and which normalised membrane potential is thresholded."""

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
            raise click.UsageError("--scale and --size exclude each other. Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise click.UsageError(f"--end {self.end:g} is not after --start {self.start:g}.")

    @classmethod
    def from_options(
        cls, given: dict[str, Any], recorded: dict[str, Any], origin: str
    ) -> "InputChoice":
        """The command line's options, and for the others those that `origin` has on record.

        Raises
        ------
        ParameterError
            If a recorded option is unknown or not valid.
        """
        values = {key: _recorded(key, value, origin) for key, value in recorded.items()}
        try:
            cls(**values)
        except click.UsageError as error:
            raise ParameterError(origin, f"options: {error.message.rstrip('.')}") from None
        explicit = {key: value for key, value in given.items() if value is not None}
        if explicit.keys() & {"scale", "size"}:
            values.pop("scale", None)
            values.pop("size", None)
        return cls(**{**values, **explicit})

    def n_expected(self, info: "SourceInfo") -> int | None:
        """The number of frames until the end asked for, as far as the input says."""
        if info.n_frames is None or self.end is None:
            return info.n_frames
        return min(info.n_frames, math.ceil(self.end * info.fps))

    def to_record(self) -> dict[str, Any]:
        """What `from_options` takes back as `recorded`."""
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
        from dlgmd_cli.sources.open import open_source
        from dlgmd_cli.sources.video import DEFAULT_DECODER

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


def _recorded(key: Any, value: Any, origin: str) -> Any:
    """One recorded option, checked like the command line's."""
    if key not in _TYPES:
        raise ParameterError(origin, f"unknown option {str(key)[:40]!r} under 'options'")
    try:
        return _TYPES[key].convert(value, None, None)
    except (click.BadParameter, TypeError, ValueError):
        shown = repr(value)[:40] if isinstance(value, str | int | float) else "a list or mapping"
        raise ParameterError(origin, f"{key} = {shown} under 'options' is not valid") from None
