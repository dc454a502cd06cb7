"""What of a batch is done already, what is left to do, and what stands in the way."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from dlgmd_cli import __version__
from dlgmd_cli.batch.places import Standing
from dlgmd_cli.batch.summary import OF_INPUT, OF_SUMMARY, Summary
from dlgmd_cli.batch.task import DONE, Ending, Order, Task, Variant, Video
from dlgmd_cli.errors import OutputExistsError
from dlgmd_cli.models.engines import AUTO
from dlgmd_cli.results.folder import RUN_PLOTS
from dlgmd_cli.results.tables import TABLES


@dataclass
class Plan:
    """What is left of a batch.

    Attributes
    ----------
    tasks : list of Task
        What is to be done.
    summaries : list of Summary
        One a variant; they hold what is done already.
    n_other_version : int
        How many of the results that are kept come from another release.
    """

    tasks: list[Task] = field(default_factory=list)
    summaries: list[Summary] = field(default_factory=list)
    n_other_version: int = 0


def plan(videos: Sequence[Video], order: Order, *, force: bool, overwrite: bool) -> Plan:
    """Compare what is asked for with what stands there.

    Parameters
    ----------
    videos : sequence of Video
        All of the batch.
    order : Order
        How each is to be computed.
    force : bool
        Take nothing as done.
    overwrite : bool
        Results of other parameters, or of another input, may be replaced.

    Raises
    ------
    OutputExistsError
        If there are such, and they may not.
    OutputError
        If the results' place cannot be read.
    """
    made = Plan()
    wanted: dict[str, list[int]] = {video.name: [] for video in videos}
    for number, variant in enumerate(order.variants):
        summary = Summary(variant.place)
        made.summaries.append(summary)
        by_result = {video.result: video for video in videos}
        standing = dict(variant.place.standing(by_result))
        for result, video in by_result.items():
            there = standing.get(result)
            if there is None or not there.record or force:
                wanted[video.name].append(number)
                continue
            if not overwrite:
                _check(video, there.record, variant, order)
            if _is_done(video, there, variant, order):
                summary.add(video.name, _ending(there.record))
                made.n_other_version += there.record["versions"].get("dlgmd") != __version__
            else:
                wanted[video.name].append(number)
    made.tasks = [Task(video, tuple(wanted[video.name])) for video in videos if wanted[video.name]]
    return made


def _is_done(video: Video, there: Standing, variant: Variant, order: Order) -> bool:
    """Whether a result is whole, of this very input, and as it is asked for."""
    record = there.record
    return (
        record.get("complete") is True
        and bool(video.identity)
        and _holds(record["input"], video.identity)
        and _has_numbers(record["input"], OF_INPUT)
        and _has_numbers(record["summary"], OF_SUMMARY)
        and not _differing(record, variant, order)
        and there.files >= set(TABLES)
        and there.files >= {f"{name}.{kind}" for name in RUN_PLOTS for kind in order.formats}
    )


def _check(video: Video, record: dict[str, Any], variant: Variant, order: Order) -> None:
    """Raise OutputExistsError where what stands there is not this batch's to replace."""
    where = variant.place.show(video.result)
    mend = "Add --overwrite to replace such results, or choose another --out."
    differing = _differing(record, variant, order)
    if differing:
        shown = ", ".join(differing[:5])
        raise OutputExistsError(where, f"a result of other settings stands here ({shown})", mend)
    is_other = record["input"].get("path") != video.path
    if is_other and not _holds(record["input"], video.identity):
        raise OutputExistsError(where, "the result of another input stands here", mend)


def _differing(record: dict[str, Any], variant: Variant, order: Order) -> list[str]:
    """Which settings of a result are not those that are asked for."""
    asked: dict[str, Any] = {"model": variant.params.model, **variant.params.to_dict()}
    if variant.engine != AUTO:
        asked["engine"] = variant.engine
    options, wanted = record.get("options"), order.options.to_record()
    if not isinstance(options, dict):
        options = {}
    return [key for key, value in asked.items() if record.get(key) != value] + [
        f"--{key}".replace("_", "-")
        for key in {**wanted, **options}
        if wanted.get(key) != options.get(key)
    ]


def _holds(record: dict[str, Any], identity: dict[str, Any]) -> bool:
    return all(record.get(key) == value for key, value in identity.items())


def _has_numbers(facts: dict[str, Any], keys: tuple[str, ...]) -> bool:
    """Whether all are there, as numbers or as nothing, so that tables can show them."""
    return all(isinstance(facts.get(key, ""), int | float | None) for key in keys)


def _ending(record: dict[str, Any]) -> Ending:
    """How the video of a stored result ended."""
    wall_s = record.get("wall_s")
    return Ending(DONE, record=record, wall_s=wall_s if isinstance(wall_s, int | float) else None)
