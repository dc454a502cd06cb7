"""`dlgmd run`: one video to its membrane potential, attenuation and spikes."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._ahead import import_ahead
from dlgmd_cli.commands._console import (
    Command,
    print_json,
    print_path,
    print_table,
    progress,
    say,
    warn,
)
from dlgmd_cli.commands._figures import save_plots
from dlgmd_cli.commands._input import choose_input, input_options
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._model import ModelChoice, engine_option, model_options
from dlgmd_cli.commands._types import Output, output_options

if TYPE_CHECKING:
    from dlgmd_cli.results.folder import ResultFolder
    from dlgmd_cli.runs.findings import Findings

_NEEDED_LATER = (
    "dlgmd_cli.models.engines.opencv",
    "dlgmd_cli.runs.findings",
    "dlgmd_cli.results.folder",
    "rich.table",
)
_NEEDED_FOR_PLOTS = ("dlgmd_cli.plots.traces", "matplotlib.backends.backend_agg")


@click.command(
    cls=Command,
    epilog="Example: dlgmd run flight.mp4 --set 9 --scale 0.5 --start 00:00:10 --format pdf",
)
@click.argument("input_path", metavar="INPUT")
@model_options
@engine_option
@input_options
@output_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
def run(
    input_path: str,
    choice: ModelChoice,
    engine: str | None,
    given: dict[str, Any],
    output: Output,
    as_json: bool,
) -> None:
    """Run the model over a video: its membrane potential and spikes.

    INPUT is a video, a folder of pictures, or a pattern of pictures such as 'frames/%04d.png'.

    Writes OUT/NAME/ with mp.csv, attenuation.csv and spikes.csv, a plot of each, and run.yaml,
    which --config takes to repeat the run.
    """
    options = choose_input(given, choice.recorded_options, choice.origin)
    detector = choice.create(engine, tell=say)
    import_ahead(_NEEDED_LATER + (_NEEDED_FOR_PLOTS if output.formats else ()))
    with (
        Interrupts() as interrupts,
        options.open(input_path) as source,
        _folder(output, source.info.name) as folder,
    ):
        from dlgmd_cli.runs import single
        from dlgmd_cli.runs.compare import Entry
        from dlgmd_cli.runs.findings import Asked, conclude
        from dlgmd_cli.video.fingerprint import fingerprint

        identity = fingerprint(input_path)
        entry = Entry(detector, source.size_wh)
        recording = entry.recording
        with progress(source.info.name, options.n_expected(source.info)) as on_frame:
            complete = interrupts.ends(
                lambda: single.run(source, detector, recording, on_frame), lambda: len(recording)
            )
        interrupts.hold()
        if not complete:
            say("Interrupted; writing what was computed.")
        asked = Asked(choice.params, choice.label, options, identity)
        findings = conclude(input_path, source, entry, asked, complete=complete)
        for warning in findings.warnings:
            warn(f"{input_path}: {warning}")
        if findings.shortage is not None:
            raise findings.shortage
        folder.save(partial(_write, findings, output.formats, interrupts))
    record = findings.record
    _show(record, folder.target, as_json)
    interrupts.conclude(folder.target, len(recording), complete=complete)


def _folder(output: Output, name: str) -> "ResultFolder":
    """Where the result goes, refused at once if it may not."""
    from dlgmd_cli.results.folder import ResultFolder

    return ResultFolder(output.out, name, overwrite=output.overwrite)


def _write(
    findings: "Findings", formats: tuple[str, ...], interrupts: Interrupts, folder: Path
) -> None:
    """Fill `folder` with the files of a result; a Ctrl-C meanwhile only spares the plots."""
    from dlgmd_cli.runs.findings import write_findings

    write_findings(folder, findings)
    if formats:
        from dlgmd_cli.plots.traces import PLOTS

        plots = {name: partial(plot, findings.result) for name, plot in PLOTS.items()}
        save_plots(folder, plots, formats, interrupts)


def _show(record: dict[str, Any], target: Path, as_json: bool) -> None:
    """The summary on stdout."""
    summary, processed = record["summary"], record["processed"]
    if as_json:
        facts = {"result": str(target), "complete": record["complete"]}
        print_json({**facts, "frames": processed["frames"], **summary})
        return
    shown = {key: value for key, value in summary.items() if value is not None}
    peak = "{mp_max:.6g} at frame {mp_max_frame}, {mp_max_time_s:.3f} s"
    spikes = "{spikes}, the first at {first_spike_time_s:.3f} s"
    collisions = (
        "{collisions}, the first at frame {first_collision_frame}, {first_collision_time_s:.3f} s"
    )
    print_table(
        ("", ""),
        [
            ("frames", "{frames} at {width}x{height}".format(**processed)),
            ("peak MP", peak.format(**shown) if summary["mp_max"] else "none"),
            ("spikes", spikes.format(**shown) if summary["spikes"] else "none"),
            ("collisions", collisions.format(**shown) if summary["collisions"] else "none"),
            (
                "mean attenuation",
                "{mean_attenuation_db:.2f} dB".format(**shown)
                if "mean_attenuation_db" in shown
                else "none",
            ),
        ],
    )
    print_path(target)
