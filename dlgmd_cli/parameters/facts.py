"""What a record holds: the one description by which records are written, checked and read.

A record is a dict, the contents of a file such as run.yaml. The classes here name its keys and the
kinds of their values: what writes a record is typed by them, and `sound` leaves out what a file
holds beside. The parameters of the model are further keys of a record, which its class checks.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from types import UnionType
from typing import (
    Annotated,
    NamedTuple,
    TypedDict,
    TypeGuard,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

# The value of a parameter or of an option; and what JSON and YAML can hold.
Value = bool | int | float | str
Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]


class Within(NamedTuple):
    """Bounds of a number, included."""

    low: float
    high: float


# A float may be infinite, but no larger than this; a whole number has 64 bits.
_MAX_NUMBER, _MAX_WHOLE = 1e30, 2**63 - 1
Rate = Annotated[float, Within(1e-30, _MAX_NUMBER)]
Count = Annotated[int, Within(0, _MAX_WHOLE)]
Side = Annotated[int, Within(1, 65_536)]


class Identity(TypedDict, total=False):
    """What identifies an input: its path, and what changes with the file, images, or object."""

    path: str
    bytes: Count
    mtime_ns: int
    pictures: Count
    sha256: str
    version: str


class InputFacts(Identity, total=False):
    """An input."""

    name: str
    width: Side
    height: Side
    fps: Rate
    frames: Count
    duration_s: float
    decoder: str
    deinterlaced: str
    content_sha256: str
    contact_s: float
    repeats: Count
    # Of a recording: where it came from, how it was cut and turned, and what it lacks.
    source: str
    crop: str
    rotate: int
    flip: bool
    dropped: Count
    left_out: Count


class Size(TypedDict, total=False):
    """The size of the frames that a model was given; fewer `cells` if a mask hides some."""

    width: Side
    height: Side
    cells: Count


class Processed(Size, total=False):
    """The frames that a model was given."""

    frames: Count


class CameraFacts(TypedDict):
    """The angles of a camera, in degrees, and how they are known: option, flight or assumed."""

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
    mean_attenuation_db: float | None
    attenuation_frames: int
    median_attenuation_db: float | None
    pooled_attenuation_db: float | None
    # In comparisons.
    sharpness: float | None
    distinguishability: float | None


class Named(TypedDict, total=False):
    """The set or the preset that was named."""

    set: int
    preset: str


class ModelFacts(Size, total=False):
    """A model of a record, beside its parameters."""

    label: str
    model: str
    engine: str
    width_px: Rate
    model_fps: Rate
    summary: Summary


class SourceFacts(TypedDict, total=False):
    """The input, and the frames of it that a model was given."""

    input: InputFacts
    processed: Processed


class RunFacts(SourceFacts, total=False):
    """What a record says beside its model; none of it is read from a configuration."""

    schema: int
    # Of the file that defines a custom model.
    model_sha256: str
    # The number of frames of a clip, or the frames of layers.
    frames: Count | list[Count]
    sweep: dict[str, Json]
    camera: CameraFacts
    columns: list[str]
    collision_frame: Count | None
    warnings: list[str]
    # Whether all of the input was used, and whether the user stopped it before its end.
    complete: bool
    interrupted: bool
    wall_s: float
    summary: Summary
    versions: dict[str, str]
    machine: dict[str, str]


class Phase(TypedDict):
    """A part of a rendered flight."""

    name: str
    first_frame: int
    last_frame: int


class ClipFacts(TypedDict, total=False):
    """What the record of a rendered clip says of its scene."""

    scene: str
    seed: int
    fps: Rate
    codec: str
    sheet: str
    agile: bool
    manner: str
    target: str | None
    collision_time_s: float | None
    phases: list[Phase]


class Record(RunFacts, ModelFacts, Named, ClipFacts, total=False):
    """A record of any kind: of a run, a comparison, layers, a sweep, or a rendered clip."""

    options: dict[str, Value]
    models: list[ModelFacts]


def extended(facts: Record, more: Mapping[str, Json]) -> Record:
    """A record with further keys, which none of these classes names, such as parameters."""
    return {**facts, **more}  # type: ignore[typeddict-item]


def defined(number: float) -> float | None:
    """A number as JSON can hold it: None for NaN."""
    return None if math.isnan(number) else number


def plain(facts: Mapping[str, object]) -> dict[str, Json]:
    """The entries of a record as JSON can hold them, infinite numbers as text: `inf`, `-inf`."""
    parts = sound(facts, dict[str, Json]) or {}
    return {k: str(v) if isinstance(v, float) and math.isinf(v) else v for k, v in parts.items()}


def flat(facts: Mapping[str, object]) -> dict[str, Value | None]:
    """The entries that are single values."""
    return sound(facts, dict[str, Value | None]) or {}


KindT = TypeVar("KindT")
_LEFT_OUT = object()


def part_of(facts: Mapping[str, object], kind: type[KindT]) -> KindT:
    """The entries of a record that a class above names."""
    known = get_type_hints(kind)
    parts = {key: value for key, value in facts.items() if key in known}
    assert _is_sound(parts, kind)
    return parts


def sound(document: object, kind: type[KindT]) -> KindT | None:
    """The parts of a document that are of their kind; None if it is of another kind itself.

    Keys that the description does not know are kept, whatever they hold.
    """
    parts = _sound(document, kind)
    return parts if _is_sound(parts, kind) else None


def _is_sound(parts: object, kind: type[KindT]) -> TypeGuard[KindT]:
    """Whether what `_sound` returned for a kind is of that kind."""
    return parts is not _LEFT_OUT


def _sound(value: object, kind: object) -> object:
    """The parts of a value that are of their kind, or `_LEFT_OUT`."""
    of_each = get_args(kind)[-1] if get_origin(kind) in (dict, list) else object
    if is_typeddict(kind) or get_origin(kind) is dict:
        if not isinstance(value, dict):
            return _LEFT_OUT
        kinds = _kinds_of(kind) if is_typeddict(kind) else {}
        parts = {k: _sound(v, kinds.get(k, of_each)) for k, v in value.items() if type(k) is str}
        return {name: part for name, part in parts.items() if part is not _LEFT_OUT}
    if get_origin(kind) is list:
        if not isinstance(value, list):
            return _LEFT_OUT
        items = (_sound(item, of_each) for item in value)
        return [item for item in items if item is not _LEFT_OUT]
    if get_origin(kind) in (Union, UnionType):
        choices = (_sound(value, choice) for choice in get_args(kind))
        return next((part for part in choices if part is not _LEFT_OUT), _LEFT_OUT)
    return value if kind is object or _is_of(value, kind) else _LEFT_OUT


@cache
def _kinds_of(kind: object) -> Mapping[str, object]:
    """Key -> kind of a class above."""
    return get_type_hints(kind, include_extras=True)


def _is_of(value: object, kind: object) -> bool:
    """Whether a value is of a plain kind: text, a flag, None, a number, or a collection."""
    origin = get_origin(kind)
    if origin is Annotated:
        number, bounds = get_args(kind)
        return _is_of(value, number) and bounds.low <= value <= bounds.high
    if kind is float and isinstance(value, int | float):
        return type(value) is not bool and not _MAX_NUMBER < abs(value) < math.inf
    if kind is int and type(value) is int:
        return abs(value) <= _MAX_WHOLE
    return isinstance(value, origin) if origin in (Mapping, Sequence) else type(value) is kind
