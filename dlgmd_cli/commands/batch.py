"""`dlgmd batch`: every video below folders, whatever some of them are like."""

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._batch_models import Models, batch_model_options
from dlgmd_cli.commands._batch_report import Report
from dlgmd_cli.commands._batch_view import batch_view
from dlgmd_cli.commands._console import (
    EXIT_INTERRUPTED,
    Command,
    say,
    settings,
    warn,
)
from dlgmd_cli.commands._input import input_options
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._labels import told_apart
from dlgmd_cli.commands._model import engine_option
from dlgmd_cli.commands._types import FiniteRange, format_option

if TYPE_CHECKING:
    from dlgmd_cli.batch.events import Pool
    from dlgmd_cli.batch.find import Found
    from dlgmd_cli.batch.resume import Plan
    from dlgmd_cli.batch.task import Order


@click.command(
    cls=Command,
    epilog="Example: dlgmd batch flights --set 7 --set 9 --jobs 4 --timeout 600 --out results",
)
@click.argument("folders", metavar="FOLDER...", nargs=-1, required=True)
@batch_model_options
@engine_option
@input_options
@click.option("--out", default="dlgmd-out", show_default=True, help="Where results go; a URL, too.")
@format_option
@click.option("--no-plots", is_flag=True, help="Draw no plots.")
@click.option(
    "--overwrite", is_flag=True, help="Replace results of other parameters or of another input."
)
@click.option("--force", is_flag=True, help="Redo what is done already, too.")
@click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    metavar="N",
    help="Videos at a time, each in a process of its own.  [default: all processors]",
)
@click.option(
    "--timeout",
    type=FiniteRange(min=0, min_open=True),
    metavar="S",
    help="Seconds that one video may take.  [default: no limit]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on a Dask cluster: tcp://HOST:PORT or a scheduler file. Needs dlgmd[cluster].",
)
@click.option("--json", "as_json", is_flag=True, help="Print the counts as one JSON object.")
def batch(
    folders: tuple[str, ...],
    models: Models,
    engine: str | None,
    given: dict[str, Any],
    out: str,
    formats: tuple[str, ...],
    no_plots: bool,
    overwrite: bool,
    force: bool,
    jobs: int | None,
    timeout: float | None,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Run the model over every video below folders.

    A FOLDER may also be a video, or the URL of either, such as s3://bucket/flights.

    Writes into OUT what 'dlgmd run' writes, one folder a video, in a tree like that of the videos,
    and summary.csv, a row a video. Of several models each has such a tree and summary of its own,
    OUT/set7, OUT/set9 and so on; every video is decoded once for all of them.

    A video that fails is a row, not an end. What is done already with the same input and
    parameters is left as it is, so that after an interrupt the same command goes on.
    """
    if scheduler is not None and jobs is not None:
        raise click.UsageError("--jobs is of this machine, not of a cluster. Leave it out.")
    with Interrupts() as interrupts, ExitStack() as stack:
        order = _order(models, engine, given, out, () if no_plots else formats)
        found = _find(folders, order)
        plan = _prepare(stack, found, order, force=force, overwrite=force or overwrite)
        pool = _pool(order, plan, jobs, timeout, scheduler)
        complete = _work(plan, pool, models.labels())
        interrupts.hold()
        report = Report(found, plan, models.labels(), complete=complete)
        report.show(as_json=as_json)
    if not complete or interrupts.count:
        raise click.exceptions.Exit(EXIT_INTERRUPTED)
    report.raise_failures()


def _order(
    models: Models,
    engine: str | None,
    given: dict[str, Any],
    out: str,
    formats: tuple[str, ...],
) -> "Order":
    """What is the same for every video, refused at once if it cannot be."""
    options, labels = models.options(given), models.labels()
    from dlgmd_cli.batch.remote_place import place_at
    from dlgmd_cli.batch.task import Order, Variant
    from dlgmd_cli.models.base import create_model

    if not out.strip() or "\0" in out:
        raise click.UsageError("--out is no name of a folder. Choose another one.")
    place = place_at(out)
    variants = []
    for choice, label in zip(models.choices, labels, strict=True):
        wanted = engine or choice.recorded_engine or "auto"
        create_model(choice.params, engine=wanted)
        own_place = place.within(label) if len(labels) > 1 else place
        variants.append(Variant(choice.label, choice.params, wanted, own_place))
    return Order(tuple(variants), options, tuple(dict.fromkeys(formats)))


def _find(folders: tuple[str, ...], order: "Order") -> "Found":
    """The videos, and what is to be said of the search."""
    from pathlib import Path

    from dlgmd_cli.batch.find import find_videos
    from dlgmd_cli.batch.places import Folder
    from dlgmd_cli.errors import SourceError

    roots = list(dict.fromkeys(folders))
    names = told_apart([Path(root) for root in roots]) if len(roots) > 1 else [""]
    results = [one.place.path for one in order.variants if isinstance(one.place, Folder)]
    found = find_videos(list(zip(names, roots, strict=True)), results)
    for remark in found.remarks:
        say(f"Note: {remark}.")
    for fault in found.faults:
        warn(f"{fault}; its videos are left out")
    if not found.videos:
        raise SourceError(
            ", ".join(roots),
            "there is no video",
            "Give folders with .mp4, .avi, .mkv and the like.",
        )
    return found


def _prepare(
    stack: ExitStack, found: "Found", order: "Order", *, force: bool, overwrite: bool
) -> "Plan":
    """What is left to do, with the results' places locked until `stack` ends."""
    from dlgmd_cli.batch.resume import plan

    for variant in order.variants:
        variant.place.prepare()
        stack.enter_context(variant.place.locked())
    made = plan(found.videos, order, force=force, overwrite=overwrite)
    n_before = len(found.videos) - len(made.tasks)
    if n_before:
        say(f"{n_before} of {len(found.videos)} videos were done already.")
    if made.n_other_version:
        warn(f"{made.n_other_version} of the results are of another release; --force redoes all")
    return made


def _pool(
    order: "Order", plan: "Plan", jobs: int | None, timeout: float | None, scheduler: str | None
) -> "Pool":
    """Who does the work."""
    from dataclasses import replace

    from dlgmd_cli.batch.local import LocalPool
    from dlgmd_cli.threads import n_processors

    if scheduler is not None:
        from dlgmd_cli.batch.cluster import Cluster

        return Cluster(order, scheduler, timeout, quiet=not settings().debug)
    n_jobs = jobs or n_processors()
    # With fewer videos than processors, each has several of those.
    n_busy = max(1, min(n_jobs, len(plan.tasks)))
    return LocalPool(replace(order, threads=max(1, n_processors() // n_busy)), n_jobs, timeout)


def _work(plan: "Plan", pool: "Pool", labels: list[str]) -> bool:
    """Do what is left; False if an interrupt ended it."""
    from dlgmd_cli.batch.drive import drive

    try:
        with batch_view(plan.tasks, labels) as tell:
            drive(plan, pool, tell)
    except KeyboardInterrupt:
        return False
    return True
