"""What a record says of an input, a model and a result: the entries of run.yaml, and warnings."""

import math
from contextlib import nullcontext, suppress

import numpy as np

from dlgmd_cli.errors import SourceError, argument
from dlgmd_cli.frame import Flags
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.base import Model
from dlgmd_cli.models.expansion import too_small
from dlgmd_cli.models.windows import Camera, beside, outside
from dlgmd_cli.parameters.facts import InputFacts, Processed, Record, RunFacts
from dlgmd_cli.parameters.keys import CORRIDOR
from dlgmd_cli.results import csv
from dlgmd_cli.results.csv import Rows
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.store import is_url
from dlgmd_cli.tasks.call import Setup
from dlgmd_cli.tasks.camera import has_motion, headings_misfit, not_headed
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.opening import content_sha256
from dlgmd_cli.video.source import Video

# The largest input, in bytes, that is hashed by default.
HASHED_BYTES = 2e9


def build_result(
    video: Video,
    setup: Setup,
    model: Model,
    rows: Rows,
    options: InputOptions,
    identity: InputFacts | None = None,
    *,
    is_read: bool,
    more: RunFacts,
) -> Result:
    """The result of a model, see `input_record`; `more` are further entries of its record."""
    record: Record = {
        **input_record(video, setup.size_on(video, options), rows, identity, is_read=is_read),
        **model_record(setup, model),
        "options": options.to_record(),
        **more,
        "warnings": [*video.progress.warnings],
        "complete": is_read and video.progress.is_whole,
        "interrupted": cancel.requested(),
    }
    return Result.of(rows, setup.params, record)


def identified(
    video: Video, options: InputOptions, identity: InputFacts | None = None
) -> InputFacts:
    """The facts that identify an input in a record, with its SHA-256.

    By default, local files and images of up to 2 GB are hashed, but not raw video: hashing takes as
    long as reading it. With the option `hashed`, any file is hashed; raises SourceError if the file
    cannot be read.
    """
    info = video.info
    known: InputFacts = {**(info.identity if identity is None else identity)}
    is_raw = info.codec in ("", "rawvideo")
    is_worth_it = "path" in known and not (is_raw or is_url(known["path"]))
    if options.hashed or (options.hashed is None and is_worth_it):
        most_bytes = math.inf if options.hashed else HASHED_BYTES
        with nullcontext() if options.hashed else suppress(SourceError):
            if digest := content_sha256(info.path, most_bytes):
                known["content_sha256"] = digest
    return known


def changed_since(setup: Setup, identity: InputFacts, name: str) -> str:
    """A warning if a run.yaml is repeated on a file of the same name with other content."""
    recorded = setup.config.recorded
    before, now = recorded.get("content_sha256"), identity.get("content_sha256")
    if not (before and now) or before == now or recorded.get("name") != name:
        return ""
    return f"{name} is not the file of {setup.config.name}: its content differs (SHA-256)"


def model_record(setup: Setup, model: Model) -> Record:
    """The entries of a record about the model: name, parameters and the model's own columns."""
    record: Record = {**setup.config.named, **setup.settings()}
    return {**record, "columns": [*model.columns]} if model.columns else record


def processed_record(size_wh: tuple[int, int], n_frames: int, hidden: Flags | None) -> Processed:
    """The entry `processed` of a record; `hidden`, (H, W), marks the cells that the mask hides."""
    processed: Processed = {"width": size_wh[0], "height": size_wh[1], "frames": n_frames}
    if hidden is not None:
        processed["cells"] = int(np.count_nonzero(~hidden))
    return processed


def input_record(
    video: Video,
    size_wh: tuple[int, int],
    rows: Rows,
    identity: InputFacts | None = None,
    *,
    is_read: bool = True,
) -> RunFacts:
    """The entries `input` and `processed` of a record.

    If the video was not read to the requested end (`is_read`), the counts are those of the result's
    rows, since decoding may be ahead.
    """
    info, progress = video.info, video.progress
    n_frames, last_s = progress.n_decoded, progress.last_time_s
    if not is_read:
        n_frames, last_s = int(rows["frame"][-1]) + 1, float(rows["time_s"][-1])
    contact_s, n_repeats = csv.contact_beside(info.path), progress.n_repeats
    if n_repeats is not None and not is_read:
        n_repeats = int(rows["repeat"].sum())
    facts: InputFacts = {
        "path": info.path,
        "name": info.name,
        "width": info.width,
        "height": info.height,
        "fps": info.fps,
        "frames": n_frames,
        "duration_s": last_s + 1.0 / info.fps,
        "decoder": info.decoder,
    }
    if video.info.is_interlaced:
        facts["deinterlaced"] = "bwdif"
    if contact_s is not None:
        facts["contact_s"] = contact_s
    if n_repeats is not None:
        facts["repeats"] = n_repeats
    known = info.identity if identity is None else identity
    return {
        "input": {**facts, **info.start, **known},
        "processed": processed_record(size_wh, len(rows), video.hidden(size_wh)),
    }


def doubts_of(
    result: Result, camera: Camera, source_wh: tuple[int, int], heading: str | None = None
) -> list[str]:
    """The warnings about a result, its camera, and the table `heading` of its directions.

    `source_wh` is the size of the processed images, (width, height) in px before reduction.
    """
    lines = result.doubts()
    if unmeasured := too_small(source_wh) or outside(camera, source_wh):
        return [*lines, unmeasured] if result.rule.uses_expansion else lines
    if result.rule.uses_expansion:
        lines.append(beside(camera))
    is_told = heading is not None and has_motion(heading)
    if result.rule.name == CORRIDOR and not is_told and not np.isfinite(result.corridor).any():
        lines.append(
            "the drone's motion is unknown, so the rule corridor compares what the window shows; "
            f"give {argument('heading')} with speed and attitude"
        )
    if heading is not None:
        lines.append(not_headed(heading, camera, source_wh, result.frame))
        lines.append(headings_misfit(heading, result))
    return [line for line in lines if line]
