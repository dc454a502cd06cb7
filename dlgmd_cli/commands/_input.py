"""The options that choose what is read of an input, shared by every command that reads one."""

from typing import Any

import click

from dlgmd_cli.commands._types import FiniteRange, OptionGroup, Size, Time
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import shown
from dlgmd_cli.video.choice import InputChoice

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


def choose_input(given: dict[str, Any], recorded: dict[str, Any], origin: str) -> InputChoice:
    """The command line's options, and for the others those that `origin` has on record.

    Raises
    ------
    ParameterError
        If options exclude each other, or a recorded one is unknown or not valid.
    """
    values = {key: _recorded(key, value, origin) for key, value in recorded.items()}
    try:
        InputChoice(**values)
    except ParameterError as error:
        raise ParameterError(origin, f"options: {str(error).rstrip('.')}") from None
    explicit = {key: value for key, value in given.items() if value is not None}
    if explicit.keys() & {"scale", "size"}:
        values.pop("scale", None)
        values.pop("size", None)
    return InputChoice(**{**values, **explicit})


def _recorded(key: Any, value: Any, origin: str) -> Any:
    """One recorded option, checked like the command line's."""
    if key not in _TYPES:
        name = key if isinstance(key, str) else shown(key)
        raise ParameterError(origin, f"unknown option {name[:40]!r} under 'options'")
    try:
        if isinstance(value, bool):  # it would count as 0 or 1
            raise TypeError
        return _TYPES[key].convert(value, None, None)
    except (click.BadParameter, TypeError, ValueError, OverflowError):
        why = f"{key} = {shown(value)} under 'options' is not valid"
        raise ParameterError(origin, why) from None
