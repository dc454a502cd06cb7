"""What a record holds: the one description by which records are written, checked and read.

A record is a dict, the contents of a file such as run.yaml. The classes here name its keys and the
kinds of their values: what writes a record is typed by them. The parameters of the model are
further keys of a record, which its class checks.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TypedDict, TypeVar, cast, get_type_hints

from dlgmd_cli import __version__

# Incremented when a key of the records, or a column of the tables, changes its meaning.
SCHEMA = 2

# The value of a parameter or of an option; and what JSON and YAML can hold.
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
    # Of a recording: where it came from, how it was cut and turned, and what it lacks.
    source: str
    crop: str
    rotate: int
    flip: bool
    dropped: int
    left_out: int


class Size(TypedDict, total=False):
    """The size of the frames that a model was given; fewer `cells` if a mask hides some."""

    width: int
    height: int
    cells: int


class Processed(Size, total=False):
    """The frames that a model was given."""

    frames: int


class CameraFacts(TypedDict):
    """The angles of a camera, in degrees, and how they are known: option or assumed."""

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
    width_px: float
    model_fps: float
    summary: Summary


class InputEntries(TypedDict, total=False):
    """The input, and the frames of it that a model was given."""

    input: InputFacts
    processed: Processed


class RunFacts(InputEntries, total=False):
    """What a record says beside its model; none of it is read from a configuration."""

    schema: int
    # Of the file that defines a custom model.
    model_sha256: str
    # The number of frames of a clip, or the frames of layers.
    frames: int | list[int]
    sweep: dict[str, Json]
    camera: CameraFacts
    columns: list[str]
    collision_frame: int | None
    warnings: list[str]
    # Whether all of the input was used, and whether the user stopped it before its end.
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


def of_another_schema(record: Mapping[str, object]) -> tuple[str, str] | None:
    """Why a record of another schema is not read, and what reads it; None for one of `SCHEMA`."""
    if record.get("schema", SCHEMA) == SCHEMA:
        return None
    versions = record.get("versions")
    version = versions.get("dlgmd") if isinstance(versions, Mapping) else None
    if version is None:
        return "is the record of another version of dlgmd", "Run again."
    why = f"was written by dlgmd {version}, and is not read by {__version__}"
    return why, f"Read it with that version: pip install 'dlgmd=={version}'."


def extended(facts: Record, more: Mapping[str, Json]) -> Record:
    """A record with further keys, which none of these classes names, such as parameters."""
    return {**facts, **more}  # type: ignore[typeddict-item]


def defined(number: float) -> float | None:
    """A number of a summary: None for NaN; infinite ones have a meaning there."""
    return None if math.isnan(number) else number


def finite(number: float) -> float | None:
    """A number as JSON can hold it: None for NaN and infinite ones."""
    return number if math.isfinite(number) else None


def for_json(facts: Mapping[str, object]) -> dict[str, Json]:
    """The entries of a record or summary for JSON, infinite numbers as text: `inf`, `-inf`."""
    entries = cast(Mapping[str, Json], facts)
    return {k: str(v) if isinstance(v, float) and math.isinf(v) else v for k, v in entries.items()}


def flat(facts: Mapping[str, object]) -> dict[str, Value | None]:
    """The entries that are single values."""
    kinds = (bool, int, float, str, type(None))
    return {key: value for key, value in facts.items() if isinstance(value, kinds)}


KindT = TypeVar("KindT")


def part_of(facts: Mapping[str, object], kind: type[KindT]) -> KindT:
    """The entries of a record that a class above names."""
    known = get_type_hints(kind)
    return cast(KindT, {key: value for key, value in facts.items() if key in known})
