"""The contents of a record: one description, by which records are written, checked and read.

A record is a dict, the contents of a file such as run.yaml. The classes here name its keys and the
types of their values; code that writes records is typed by these classes. A record also holds the
parameters of the model, which the model's parameter class checks.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from inspect import Parameter, signature
from types import UnionType
from typing import (
    Any,
    TypedDict,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

# Incremented when a key of the records, or a column of the tables, changes its meaning.
SCHEMA = 3

# The value of a parameter or an option; the values that JSON and YAML can hold.
Value = bool | int | float | str
Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]


class InputFacts(TypedDict, total=False):
    """An input."""

    # What identifies it: its path, and what changes with the file, images, or object.
    path: str
    bytes: int
    mtime_ns: int
    pictures: int
    sha256: str
    version: str
    # What else is known of it.
    name: str
    width: int
    height: int
    fps: float
    frames: int
    duration_s: float
    decoder: str
    deinterlaced: str
    content_sha256: str
    contact_s: float
    repeats: int
    # What an absolute clock showed at the first frame, from which the times count.
    start_time_utc: str
    clock_offset_s: float
    # For a recording: its source, how its images were cropped and turned, and the missing frames.
    source: str
    crop: str
    rotate: int
    flip: bool
    dropped: int
    left_out: int


class Size(TypedDict, total=False):
    """The size of a model's frames; `cells` is below width x height if a mask hides cells."""

    width: int
    height: int
    cells: int


class Processed(Size, total=False):
    """The size and number of a model's frames."""

    frames: int


class CameraFacts(TypedDict):
    """The angles of a camera, in degrees, and their origin: an option, or assumed."""

    fov: float
    camera_tilt: float
    known_by: str


class Summary(TypedDict, total=False):
    """The main numbers of a result, see `Result.summary`; None where undefined."""

    rule: str
    mp_max: float | None
    mp_max_frame: int | None
    mp_max_time_s: float | None
    spikes: int
    first_spike_time_s: float | None
    alarms: int
    first_alarm_frame: int | None
    first_alarm_time_s: float | None
    first_alarm_side: str | None
    first_alarm_ttc_s: float | None
    blind_share: float
    mean_attenuation_db: float | None
    attenuation_frames: int
    median_attenuation_db: float | None
    pooled_attenuation_db: float | None
    # Only in comparisons.
    sharpness: float | None
    distinguishability: float | None


class Named(TypedDict, total=False):
    """The set or the preset that the user named."""

    set: int
    preset: str


class ModelFacts(Size, total=False):
    """The facts about a model in a record, without the model's parameters."""

    label: str
    model: str
    width_px: float
    model_fps: float
    summary: Summary


class InputEntries(TypedDict, total=False):
    """The input, and the frames of the input that a model was given."""

    input: InputFacts
    processed: Processed


class RunFacts(InputEntries, total=False):
    """The facts in a record that do not describe the model; a configuration ignores them."""

    schema: int
    # Hash of the file that defines a custom model.
    model_sha256: str
    # The number of frames of a clip, or the frame numbers of layers.
    frames: int | list[int]
    sweep: dict[str, Json]
    camera: CameraFacts
    columns: list[str]
    collision_frame: int | None
    warnings: list[str]
    # Whether the whole input was processed, and whether the user stopped the run early.
    complete: bool
    interrupted: bool
    wall_s: float
    summary: Summary
    versions: dict[str, str]
    machine: dict[str, str]


class Record(RunFacts, ModelFacts, Named, total=False):
    """A record of any kind: of a run, a comparison, layers, or a sweep."""

    options: dict[str, Value]
    models: list[ModelFacts]


def misfits(facts: Mapping[str, object], kind: type = Record) -> Iterator[str]:
    """The entries whose value is of another type than the class `kind` says, as ``input.fps``."""
    for key, expected in get_type_hints(kind).items():
        value = facts.get(key)
        if key in facts and is_typeddict(expected) and isinstance(value, Mapping):
            yield from (f"{key}.{name}" for name in misfits(value, expected))
        elif key in facts and not _fits(value, expected):
            yield key


def _fits(value: object, expected: Any) -> bool:
    """Whether a value is of the type, as one of the classes above states types."""
    kind, parts = get_origin(expected) or expected, get_args(expected)
    if kind in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if is_typeddict(kind):
        return isinstance(value, Mapping) and not any(misfits(value, kind))
    if kind is list:
        return isinstance(value, list) and all(_fits(one, *parts) for one in value)
    if kind is dict:
        return isinstance(value, dict) and all(_fits(one, parts[-1]) for one in value.values())
    if kind in (int, float) and isinstance(value, bool):
        return False
    return isinstance(value, int | float if kind is float else kind)


def of_another_schema(record: Mapping[str, object]) -> tuple[str, str] | None:
    """Why a record of another schema is refused, and a hint; None for `SCHEMA`."""
    if record.get("schema", SCHEMA) == SCHEMA:
        return None
    return "is the record of another version of dlgmd", "Run again."


def extended(facts: Record, more: Mapping[str, Json]) -> Record:
    """A record with further keys, such as parameters, that none of the classes above names."""
    return {**facts, **more}  # type: ignore[typeddict-item]


def defined(number: float) -> float | None:
    """A number for JSON: None for NaN."""
    return None if math.isnan(number) else number


def finite(number: float) -> float | None:
    """A number as JSON can hold it: None for NaN and infinite numbers."""
    return number if math.isfinite(number) else None


def for_json(facts: Mapping[str, object]) -> dict[str, Json]:
    """The entries of a record for JSON; infinite numbers become the text `inf` or `-inf`."""
    entries = cast(Mapping[str, Json], facts)
    return {k: str(v) if isinstance(v, float) and math.isinf(v) else v for k, v in entries.items()}


def flat(facts: Mapping[str, object]) -> dict[str, Value | None]:
    """The entries that are single values."""
    kinds = (bool, int, float, str, type(None))
    return {key: value for key, value in facts.items() if isinstance(value, kinds)}


KindT = TypeVar("KindT")


def part_of(facts: Mapping[str, object], kind: type[KindT]) -> KindT:
    """The entries of a record whose keys the class `kind` names."""
    known = get_type_hints(kind)
    return cast(KindT, {key: value for key, value in facts.items() if key in known})


FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def stating(arguments: Any) -> Callable[[FunctionT], FunctionT]:
    """A decorator: the signature names the arguments that a function takes by two asterisks.

    `arguments` is a mapping, name -> type, all None by default; or a dataclass or a function, whose
    arguments by name are meant.
    """
    kind = Parameter.KEYWORD_ONLY
    if isinstance(arguments, Mapping):
        more = [
            Parameter(name, kind, default=None, annotation=of) for name, of in arguments.items()
        ]
    else:
        known = signature(arguments).parameters.values()
        meant = [one for one in known if isinstance(arguments, type) or one.kind is kind]
        more = [one.replace(kind=kind) for one in meant]

    def decorate(function: FunctionT) -> FunctionT:
        stated = signature(function)
        own = {p.name: p for p in stated.parameters.values() if p.kind is not p.VAR_KEYWORD}
        every = [*own.values(), *(one for one in more if one.name not in own)]
        function.__signature__ = stated.replace(parameters=every)  # type: ignore[attr-defined]
        return function

    return decorate
