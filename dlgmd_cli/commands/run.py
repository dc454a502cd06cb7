"""`dlgmd run`: run a model over one video."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import (
    Command,
    detail,
    print_json,
    print_path,
    print_table,
    say,
)
from dlgmd_cli.commands.frame import job
from dlgmd_cli.commands.options import (
    Output,
    clips_option,
    input_argument,
    input_options,
    model_options,
    run_output_options,
)
from dlgmd_cli.words import counted, frames_text

if TYPE_CHECKING:
    from dlgmd_cli.models.detection import AlarmSpan
    from dlgmd_cli.results.result import Result
    from dlgmd_cli.runs.setup import Setup

# Alarms that the table lists.
_MAX_LISTED = 5


@click.command(
    cls=Command,
    epilog="Example: dlgmd run flight.mp4 --set 9 --scale 0.5 --start 00:00:10 --format pdf",
)
@input_argument
@model_options
@input_options
@run_output_options
@clips_option
def run(
    input_path: str, setup: "Setup", given: dict[str, Any], output: Output, clips: Path | None
) -> None:
    """Run a model over a video.

    INPUT is a video file, a folder of pictures, a quoted pattern such as 'frames/%04d.png' or
    'frames/*.png', or a .npy array of shape (n, H, W) or (n, H, W, 3).

    Writes OUT/NAME/ with mp.csv (the membrane potential, MP), attenuation.csv, spikes.csv (spikes
    and alarms of each frame), a figure of each, alarms.csv (when each alarm begins and ends, and
    the side it comes from), and run.yaml, which repeats the run with --config.

    A spike is a frame whose normalised MP reaches the threshold t_mp. n_sp spikes in a row (default
    2; 3 in the preset flight) raise an alarm, and pauses under 0.3 s do not end it.
    """
    from dlgmd_cli.results import store
    from dlgmd_cli.runs import run as runs
    from dlgmd_cli.runs.setup import input_options as recorded
    from dlgmd_cli.video.clips import refuse_clips, write_clips

    options = recorded(setup, given)
    with job(input_path, [setup], options, output, store.RUN) as one:
        if clips is not None and not output.overwrite:
            refuse_clips(clips, one.video.info.name)
        with one.progress() as on_frame:
            (result,) = runs.run_models(one.video, [setup], options, on_frame=on_frame)
        one.warn(result.warnings)
        for line in details(result):
            detail(line)
        runs.require_response(one.video, [setup], [result], options)
        one.commit(result.files(output.formats, output.dpi))
        if clips is not None and result.record["complete"]:
            onsets_s = [alarm.start_s for alarm in result.alarm_list]
            name = one.video.info.name
            made = write_clips(input_path, name, onsets_s, clips, options.input_fps)
            say(f"{counted(len(made), 'clip')} in {clips}.")
    _show(result, one.folder, output.as_json)
    one.end(len(result), complete=result.record["complete"])


def details(result: "Result") -> list[str]:
    """Input, processed frames, and model with its parameters, one line each, for --verbose."""
    record, params = result.record, result.params.to_dict()
    source, processed = record["input"], record["processed"]
    values = ", ".join(f"{key} = {value}" for key, value in params.items())
    return [
        f"Input: {source['path']}, {source['width']}x{source['height']}, {source['fps']:.6g} "
        f"frames a second, decoded by {source['decoder']}",
        f"Processed: {processed['frames']} frames of {processed['width']}x{processed['height']}",
        f"Model: {record['model']}, computed by {record['engine']}, with {values}",
    ]


def _listed(alarms: "list[AlarmSpan]") -> list[str]:
    """The first alarms, one line each, and how many more there are."""
    lines = [
        f"{one.start_s:.3f} to {one.end_s:.3f} s, frames {one.start_frame} to {one.end_frame}"
        f"{', ' if one.side else ''}{one.side}, peak MP {one.peak_mp_abs:.2f}"
        for one in alarms[:_MAX_LISTED]
    ]
    n_more = len(alarms) - len(lines)
    return [*lines, f"and {n_more} more in alarms.csv"] if n_more else lines


def _show(result: "Result", folder: Path, as_json: bool) -> None:
    summary, processed = result.summary, result.record["processed"]
    if as_json:
        facts = {"result": str(folder), "complete": result.record["complete"]}
        facts["warnings"] = result.warnings
        alarm_list = [one.to_dict() for one in result.alarm_list]
        print_json({**facts, "frames": processed["frames"], **summary, "alarm_list": alarm_list})
        return
    peak = spikes = attenuation = "none"
    if summary["mp_max"] == 0.0:
        peak = "0: everything was suppressed"
    elif summary["mp_max"] is not None:
        peak = "{mp_max:.6g} at frame {mp_max_frame}, {mp_max_time_s:.3f} s".format(**summary)
    if summary["spikes"]:
        spikes = "{spikes}, the first at {first_spike_time_s:.3f} s".format(**summary)
    if summary["mean_attenuation_db"] is not None:
        attenuation = "{mean_attenuation_db:.2f} dB, over {attenuation_frames} of {frames} frames"
        attenuation = attenuation.format(**summary, **processed)
    rows = [
        ("frames", "{} at {width}x{height}".format(frames_text(result.record), **processed)),
        ("peak MP", peak),
        ("spikes", spikes),
        ("alarms", f"{summary['alarms'] or 'none'}"),
        *(("", line) for line in _listed(result.alarm_list)),
        ("mean attenuation", attenuation),
    ]
    print_table(("", ""), rows)
    print_path(folder)
