"""What a worker does with one video: decode it once, run every variant, store the results."""

import time
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from dlgmd_cli.batch.remote import at_hand
from dlgmd_cli.batch.task import DONE, FAILED, Ending, Order, Outcome, Task, Variant
from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.runs import single
from dlgmd_cli.runs.compare import Entry, compare
from dlgmd_cli.runs.findings import Asked, Findings, conclude, write_findings
from dlgmd_cli.runs.serve import note
from dlgmd_cli.threads import limit_threads
from dlgmd_cli.video.frames import Video

# How often it tells how far it is.
_NOTE_EVERY_S = 0.25


def prepare(order: Order) -> Callable[[Task], Outcome]:
    """What answers the tasks of an order, in a process of its own."""
    limit_threads(order.threads)
    if order.formats:  # which takes long to import, and is not the first video's to wait for
        import_module("dlgmd_cli.plots.traces")
    return partial(process, order)


def process(order: Order, task: Task) -> Outcome:
    """One video through the variants that it is still to go through.

    Whatever goes wrong in one variant is that one's ending.
    """
    began = time.monotonic()
    note((0, None))
    try:
        return _process(order, task, began)
    except Exception as error:
        return dict.fromkeys(task.wanted, as_failed(error, began))


def _process(order: Order, task: Task, began: float) -> Outcome:
    outcome: Outcome = {}
    video, entries = task.video, {}
    for number in task.wanted:
        variant = order.variants[number]
        try:
            variant.place.check(video.result)
            entries[number] = create_model(variant.params, engine=variant.engine)
        except Exception as error:
            outcome[number] = as_failed(error, began)
    if not entries:
        return outcome
    with at_hand(video.path) as path, order.options.open(path) as source:
        filled = {number: Entry(model, source.size_wh) for number, model in entries.items()}
        _feed(source, list(filled.values()), order)
        for number, entry in filled.items():
            try:
                findings = _conclude(source, entry, order, order.variants[number], task, began)
                _save(findings, order, order.variants[number], task)
                ending = Ending(DONE, record=findings.record, wall_s=findings.record["wall_s"])
            except Exception as error:
                ending = as_failed(error, began)
            outcome[number] = ending
    return outcome


def _feed(source: Video, entries: list[Entry], order: Order) -> None:
    """Decode once, whatever the number of models, and tell how far it is."""
    n_expected, told_s = order.options.n_expected(source.info), 0.0

    def on_frame(n_decoded: int) -> None:
        nonlocal told_s
        now = time.monotonic()
        if now - told_s >= _NOTE_EVERY_S:
            told_s = now
            note((n_decoded, n_expected))

    if len(entries) == 1:
        single.run(source, entries[0].model, entries[0].recording, on_frame)
    else:
        compare(source, entries, on_frame)


def _conclude(
    source: Video, entry: Entry, order: Order, variant: Variant, task: Task, began: float
) -> Findings:
    """What `dlgmd run` would find, and how long it took."""
    asked = Asked(variant.params, variant.label, order.options, task.video.identity)
    findings = conclude(task.video.name, source, entry, asked, complete=True)
    if findings.shortage is not None:
        raise findings.shortage
    findings.record["input"]["path"] = task.video.path
    findings.record["wall_s"] = round(time.monotonic() - began, 3)
    return findings


def _save(findings: Findings, order: Order, variant: Variant, task: Task) -> None:
    def write(folder: Path) -> None:
        write_findings(folder, findings)
        _draw(folder, findings, order.formats)

    variant.place.save(task.video.result, write)


def _draw(folder: Path, findings: Findings, formats: tuple[str, ...]) -> None:
    """Every plot in every format."""
    if not formats:
        return
    from dlgmd_cli.plots.style import save_figure
    from dlgmd_cli.plots.traces import PLOTS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a font may lack letters of a title
        for name, plot in PLOTS.items():
            figure = plot(findings.result)
            for suffix in formats:
                save_figure(figure, folder / f"{name}.{suffix}")


def as_failed(error: Exception, began: float | None = None) -> Ending:
    """An error as a row has it: on one line, without the video's name."""
    if isinstance(error, DlgmdError):
        text = f"{error.why}. {error.mend}".strip()
    elif isinstance(error, MemoryError):
        text = "not enough memory. Process smaller frames with --scale, or use fewer --jobs."
    elif isinstance(error, OSError):
        text = f"{error.strerror or type(error).__name__}."
    else:
        text = f"internal error ({type(error).__name__}). 'dlgmd --debug run' shows more."
    wall_s = None if began is None else round(time.monotonic() - began, 3)
    return Ending(FAILED, text, wall_s=wall_s)
