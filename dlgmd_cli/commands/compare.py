"""`dlgmd compare`: one video through many models, decoded once."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._ahead import import_ahead
from dlgmd_cli.commands._annotations import annotation_options
from dlgmd_cli.commands._compared import show_comparison
from dlgmd_cli.commands._console import Command, progress, say, warn
from dlgmd_cli.commands._figures import save_plots
from dlgmd_cli.commands._input import choose_input, input_options
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._model import engine_option
from dlgmd_cli.commands._types import Output, output_options, width_option
from dlgmd_cli.commands._variants import Variant, variant_options
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.runs.facts import facts, too_short
from dlgmd_cli.video.choice import InputChoice

if TYPE_CHECKING:
    from dlgmd_cli.models.base import Model
    from dlgmd_cli.plots.style import Width
    from dlgmd_cli.results.annotations import Annotations
    from dlgmd_cli.results.tables import Result
    from dlgmd_cli.runs.compare import Entry
    from dlgmd_cli.runs.recording import Recording
    from dlgmd_cli.video.prepare import Source

_NEEDED_LATER = ("dlgmd_cli.models.engines.opencv", "dlgmd_cli.runs.compare", "rich.table")
_NEEDED_FOR_PLOTS = ("dlgmd_cli.plots.overlays", "matplotlib.backends.backend_agg")


@click.command(
    cls=Command,
    epilog="Example: dlgmd compare flight.mp4 --set 3 --set 9 --model lgmd --collision-frame 120",
)
@click.argument("input_path", metavar="INPUT")
@variant_options
@engine_option
@input_options
@annotation_options
@width_option
@output_options
@click.option("--json", "as_json", is_flag=True, help="Print the summaries as one JSON object.")
def compare(
    input_path: str,
    variants: list[Variant],
    engine: str | None,
    given: dict[str, Any],
    annotations: "Annotations",
    width: "Width",
    output: Output,
    as_json: bool,
) -> None:
    """Run many models over one video, which is decoded once.

    INPUT is as in 'dlgmd run'. Without --set, --config and --model, set 9 is compared with the
    other models.

    Writes OUT/NAME/compare.csv, a figure of the membrane potentials, each normalised by its own
    sequence unless --normalise says otherwise, one of the attenuations, and compare.yaml. Spikes
    and collisions in the summary are those of 'dlgmd run'.
    """
    options = choose_input(given, {}, "")
    models = _create(variants, engine)
    import_ahead(_NEEDED_LATER + (_NEEDED_FOR_PLOTS if output.formats else ()))
    from dlgmd_cli.results.folder import COMPARISON, ResultFolder

    with (
        Interrupts() as interrupts,
        options.open(input_path) as source,
        ResultFolder(
            output.out, source.info.name, COMPARISON, overwrite=output.overwrite
        ) as folder,
    ):
        from dlgmd_cli.runs.compare import Entry
        from dlgmd_cli.runs.compare import compare as feed

        entries = [
            Entry(model, _size(variant, options, source))
            for variant, model in zip(variants, models, strict=True)
        ]
        recording = entries[0].recording
        with progress(source.info.name, options.n_expected(source.info)) as on_frame:
            complete = interrupts.ends(
                lambda: feed(source, entries, on_frame), lambda: len(recording)
            )
        interrupts.hold()
        if not complete:
            say("Interrupted; writing what was computed.")
        for warning in (*_left_out(variants), *source.progress.warnings):
            warn(f"{input_path}: {warning}")
        if complete:
            _require_an_answer(input_path, source, variants, entries, options)
        results = _read(variants, entries, by_sequence=options.by_sequence)
        doubts = [
            *_doubts(results, source.info.decoder),
            *_unanswered(variants, entries),
            *annotations.outside(*_ends(recording)),
        ]
        for doubt in doubts:
            warn(f"{input_path}: {doubt}")
        record = {
            "input": facts(source, len(recording))["input"],
            "models": [
                _described(variant, entry, results[variant.label], annotations)
                for variant, entry in zip(variants, entries, strict=True)
            ],
            "options": options.to_record(),
            "warnings": [*_left_out(variants), *source.progress.warnings, *doubts],
            "complete": complete,
        }
        column = "mp_abs" if options.normalise == "absolute" else "mp_seq"
        plots = _plots(results, annotations, column, width) if output.formats else {}
        folder.save(partial(_write, results, record, plots, output.formats, interrupts))
    show_comparison(record, folder.target, as_json=as_json)
    interrupts.conclude(folder.target, len(recording), complete=complete)


def _create(variants: list[Variant], engine: str | None) -> "list[Model]":
    """The models; an engine is for those that have several."""
    from dlgmd_cli.models.base import create_model

    if engine and not any(isinstance(one.params, DlgmdParameters) for one in variants):
        raise click.UsageError("--engine is of the D-LGMD, and none is compared. Add --set.")
    models = []
    for variant in variants:
        is_dlgmd = isinstance(variant.params, DlgmdParameters)
        wanted = engine or variant.engine or "auto"
        model = create_model(variant.params, engine=wanted if is_dlgmd else "auto", tell=say)
        models.append(model)
    return models


def _size(variant: Variant, options: InputChoice, source: "Source") -> tuple[int, int]:
    """At which size a variant sees the input: as asked for, else as its file records it."""
    from dlgmd_cli.video.prepare import processed_size

    own = variant.size
    if (options.scale or options.size or own.scale or own.size) is None:
        return source.size_wh
    chosen = own if (options.scale or options.size) is None else options
    info = source.info
    return processed_size(info.width, info.height, scale=chosen.scale, size_wh=chosen.size)


def _require_an_answer(
    name: str,
    source: "Source",
    variants: list[Variant],
    entries: "list[Entry]",
    options: InputChoice,
) -> None:
    """Raise SourceError if the input ends before the first model can answer."""
    if any(entry.recording.n_valid for entry in entries):
        return
    needs = [entry.model.first_valid_frame for entry in entries]
    least = min(needs)
    raise too_short(name, source, variants[needs.index(least)].label, options, least)


def _read(
    variants: list[Variant], entries: "list[Entry]", *, by_sequence: bool
) -> "dict[str, Result]":
    """Everything that follows from the recordings, by label."""
    from dlgmd_cli.runs.reading import Reading

    return {
        variant.label: Reading(
            entry.recording, entry.size_wh, variant.params, by_sequence=by_sequence
        ).whole()
        for variant, entry in zip(variants, entries, strict=True)
    }


def _left_out(variants: list[Variant]) -> list[str]:
    """Which recorded options of which file are not the comparison's, a line a file."""
    return [
        f"of {one.origin} the recorded {', '.join(one.left_out)} {verb} not taken over; give "
        "such options here"
        for one in {one.origin: one for one in variants if one.left_out}.values()
        for verb in ["is" if len(one.left_out) == 1 else "are"]
    ]


def _unanswered(variants: list[Variant], entries: "list[Entry]") -> list[str]:
    """Which models never had a full history, a line each."""
    return [
        f"{variant.label} needs at least {entry.model.first_valid_frame + 1} frames, and gives "
        "no answer"
        for variant, entry in zip(variants, entries, strict=True)
        if entry.recording.n_valid == 0
    ]


def _ends(recording: "Recording") -> tuple[int, int]:
    """Numbers of the first and the last frame."""
    frames = recording.columns()[0]
    return int(frames[0]), int(frames[-1])


def _doubts(results: "Mapping[str, Result]", decoder: str) -> list[str]:
    """What looks wrong, a line each; with the label where it is not so of every result."""
    from dlgmd_cli.results.measures import doubts

    of_each = {label: doubts(result, decoder) for label, result in results.items()}
    lines = []
    for label, found in of_each.items():
        for line in found:
            is_common = all(line in others for others in of_each.values())
            lines.append(line if is_common else f"{label}: {line}")
    return list(dict.fromkeys(lines))


def _described(
    variant: Variant, entry: "Entry", result: "Result", annotations: "Annotations"
) -> dict[str, Any]:
    """What compare.yaml says of one model."""
    from dlgmd_cli.results.measures import distinguishability, sharpness, summarise

    summary = {**summarise(result), "sharpness": _number(sharpness(result))}
    if annotations.false_positive_frame is not None:
        ratio = distinguishability(result, annotations.false_positive_frame)
        summary["distinguishability"] = _number(ratio)
    return {
        "label": variant.label,
        "model": entry.model.name,
        "engine": entry.model.engine_name,
        "width": entry.size_wh[0],
        "height": entry.size_wh[1],
        **variant.params.to_dict(),
        "summary": summary,
    }


def _number(value: float) -> float | None:
    """None for what is undefined."""
    return None if math.isnan(value) else value


def _plots(
    results: "Mapping[str, Result]", annotations: "Annotations", column: str, width: "Width"
) -> dict[str, Callable[[], Any]]:
    """The figures, not drawn yet."""
    from dlgmd_cli.plots.overlays import overlay_attenuation, overlay_mp

    return {
        "compare-mp": partial(overlay_mp, results, annotations, column=column, width=width),
        "compare-attenuation": partial(overlay_attenuation, results, annotations, width=width),
    }


def _write(
    results: "Mapping[str, Result]",
    record: dict[str, Any],
    plots: dict[str, Callable[[], Any]],
    formats: tuple[str, ...],
    interrupts: Interrupts,
    folder: Path,
) -> None:
    """Fill `folder` with the files of a comparison; a Ctrl-C meanwhile only spares the plots."""
    from dlgmd_cli.results.comparison import write_comparison
    from dlgmd_cli.results.folder import COMPARISON
    from dlgmd_cli.results.record import write_record

    write_comparison(folder / "compare.csv", results)
    if plots:
        save_plots(folder, plots, formats, interrupts)
    write_record(folder, record, COMPARISON, engines=[one["engine"] for one in record["models"]])
