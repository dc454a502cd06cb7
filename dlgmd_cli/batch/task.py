"""What a batch asks for, video by video, and what becomes of it; all of it can be pickled."""

from dataclasses import dataclass, field
from typing import Any

from dlgmd_cli.batch.places import Place
from dlgmd_cli.parameters import Parameters
from dlgmd_cli.video.choice import InputChoice

# How a video can end, as summary.csv has it.
DONE, FAILED, CRASHED, KILLED, TIMEOUT = "done", "failed", "crashed", "killed", "timeout"


@dataclass(frozen=True)
class Video:
    """One input of a batch.

    Attributes
    ----------
    name : str
        What the summary calls it: its path below the folder that was given, with slashes.
    path : str
        Where it lies: an absolute path or a URL.
    result : str
        The folder of its result below that of the batch, with slashes.
    identity : dict
        What tells it from another of the same name; empty where it cannot be looked at.
    """

    name: str
    path: str
    result: str
    identity: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Variant:
    """One model that every video goes through, what messages call it, and its results' place."""

    label: str
    params: Parameters
    engine: str
    place: Place


@dataclass(frozen=True)
class Order:
    """What is the same for every video of a batch.

    `threads` is how many of them the work on one video may use; None for no limit.
    """

    variants: tuple[Variant, ...]
    options: InputChoice
    formats: tuple[str, ...]
    threads: int | None = None


@dataclass(frozen=True)
class Task:
    """A video, and which of the order's variants it is still to go through, by number."""

    video: Video
    wanted: tuple[int, ...]


@dataclass(frozen=True)
class Ending:
    """How a video ended in one variant.

    Attributes
    ----------
    status : str
        `done`, `failed`, `crashed`, `killed` or `timeout`.
    error : str
        Why it is not done, on one line.
    record : dict
        What run.yaml says, of one that is done.
    wall_s : float or None
        How long it took, decoding included, in seconds.
    """

    status: str
    error: str = ""
    record: dict[str, Any] = field(default_factory=dict)
    wall_s: float | None = None


# By the variant's number.
Outcome = dict[int, Ending]
