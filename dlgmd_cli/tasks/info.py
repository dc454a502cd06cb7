"""`info`: the properties of videos: size, codec, frame rate, duplicate frames, damage."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.errors import DlgmdError, ParameterError, SourceError, argument, printable, warn
from dlgmd_cli.models.rules import MIN_FPS
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.parameters.presets import DEFAULT_WIDTH_PX, PRESETS, load_config
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Cells
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.stream.clock import RATE_TOLERANCE, sampling_step
from dlgmd_cli.tasks.call import Place, Progress, fold, no_progress
from dlgmd_cli.tasks.camera import camera_of
from dlgmd_cli.video.base import DEFAULT_DECODER
from dlgmd_cli.video.containers import HDR
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.opening import processed_size
from dlgmd_cli.video.survey import Survey, survey
from dlgmd_cli.video.timestamps import rate_between_gaps

_log = logging.getLogger(__name__)

# Frame rate (1/s) below which objects approach too fast per frame for the neuron.
_SLOW_FPS = 20.0
_COLUMNS = (
    *("path", "width", "height", "codec", "frames", "duration_s", "fps_stated", "fps_true"),
    *("repeats", "gaps", "decoder"),
)


def info(
    videos: Place | Iterable[Place],
    *,
    input_fps: float | None = None,
    decoder: str | None = None,
    topic: str | None = None,
    write_mask: Place | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Info:
    """Describe videos, each read to its end: size, codec, frame rate, duplicate frames, damage.

    Parameters
    ----------
    videos : str, path, or iterable of them
        Video files, folders of images or patterns. One of several that cannot be read does not stop
        the others.
    input_fps, decoder, topic
        As in `run`. Without `topic`, the first of several topics is described, and all are listed.
    write_mask : str or path, optional
        Write a mask of a single video into this .png, black where pixels never change; an earlier
        file is replaced only with `overwrite`.
    progress
        As in `batch`.

    Returns
    -------
    Info
        `surveys` has the properties, and `failed` the reasons why videos could not be read.

    Raises
    ------
    SourceError
        If a single video cannot be read, or has no pixels that never change.
    ParameterError, MissingExtraError, OutputError, OutputExistsError
        As in `run`.

    Examples
    --------
    >>> info("flight.mp4").surveys[0].repeats  # doctest: +SKIP
    40
    """
    paths = [os.fspath(p) for p in ([videos] if isinstance(videos, str | os.PathLike) else videos)]
    mask = None if write_mask is None else Path(write_mask)
    if mask is None:
        refuse({"overwrite": overwrite}, f"works only with {argument('write_mask')}")
    else:
        if len(paths) > 1:
            raise ParameterError("", f"{argument('write_mask')} works with one INPUT")
        store.refuse_existing(mask, overwrite=overwrite, named_by="write_mask")
    fold(None, None, None, {"decoder": decoder, "topic": topic}).for_any_of(paths)
    surveys: list[Survey] = []
    failed: dict[str, str] = {}
    for path in paths:
        try:
            with progress(path, None, "frame") as on_frame:
                surveyed = survey(
                    path,
                    decoder=decoder or DEFAULT_DECODER,
                    input_fps=input_fps,
                    topic=topic,
                    on_frame=on_frame,
                )
        except DlgmdError as error:
            if len(paths) == 1:
                raise
            _log.error("%s", str(error).rstrip("."))
            failed[path] = printable(str(error))
            continue
        surveys.append(surveyed)
        for warning in surveyed.warnings:
            warn(f"{path}: {warning}")
    result = Info(surveys, failed, paths)
    if mask is not None:
        files = {mask.name: store.file_of(result.mask())}
        with store.claimed(
            mask.parent, names=files, overwrite=overwrite, named_by="write_mask", locks=False
        ) as claim:
            result.paths = claim.write(files)
    return result


@dataclass(eq=False, repr=False)
class Info(Outcome):
    """The properties of videos.

    Attributes
    ----------
    surveys : list of Survey
        The properties of each video that could be read.
    failed : dict of str to str
        The reasons why the other videos could not be read, by their paths.
    asked : sequence of str
        All paths in order.
    """

    TABLES = ("info.csv",)

    surveys: list[Survey]
    failed: dict[str, str]
    asked: Sequence[str]

    def __repr__(self) -> str:
        inputs = "; ".join(
            f"{survey.path}: {survey.width}x{survey.height}, {survey.frames} frames"
            for survey in self.surveys
        )
        return f"<Info on {inputs or 'nothing'}>"

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """The error behind the exit code 1: some inputs failed."""
        if not self.failed:
            return None
        return DlgmdError("", f"{len(self.failed)} of {len(self.asked)} inputs failed")

    def cells(self) -> Cells:
        """One row per video, with its size, rate and faults."""
        rows = [[getattr(survey, name) for name in _COLUMNS] for survey in self.surveys]
        return {"info.csv": (_COLUMNS, rows)}

    def mask(self) -> bytes:
        """A PNG of the first input's size, black in the borders and where pixels never change.

        Raises SourceError if there are no such pixels.
        """
        facts = self.surveys[0]
        if facts.mask is None:
            why = "no pixels stay the same while the others change"
            raise SourceError(facts.path, why, "Paint a mask yourself, or leave it out.")
        _, encoded = cv2.imencode(".png", np.where(facts.mask, np.uint8(0), np.uint8(255)))
        return encoded.tobytes()

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output."""
        surveyed = {survey.path: _facts(survey) for survey in self.surveys}
        errors = {path: {"path": path, "error": why} for path, why in self.failed.items()}
        return {"inputs": [errors.get(path) or surveyed[path] for path in self.asked]}

    def shown(self) -> Iterator[Shown]:
        """A table for each input, and advice for a run."""
        for facts in self.surveys:
            yield ("", printable(facts.path)), _rows(facts)
            yield from map(printable, _advice(facts))
        yield from self.paths


def _rows(facts: Survey) -> list[tuple[str, str]]:
    codec = facts.codec or "unknown"
    if facts.pixel_format:
        codec += f", {facts.pixel_format}, {facts.bits} bits"
    elif facts.fps_stated is not None and facts.decoder == "opencv":
        codec += " (FOURCC; the package 'av' of the extra fast would say more)"
    interlaced = {True: "yes", False: "no", None: "unknown without the package 'av'"}
    repeats = "none"
    if facts.repeats:
        repeats = f"{facts.repeats} of {facts.frames} ({100 * facts.repeats / facts.frames:.0f} %)"
    rows = [
        ("size", f"{facts.width}x{facts.height}"),
        ("codec", codec),
        ("frames", f"{facts.frames}, {facts.duration_s:.3f} s"),
        ("frame rate", _rate(facts)),
        ("duplicate frames", repeats),
        ("interlaced", interlaced[facts.is_interlaced]),
        ("decoder", facts.decoder),
    ]
    turns = [f"{facts.turned_deg}° clockwise"] if facts.turned_deg else []
    turns += ["mirrored"] if facts.is_mirrored else []
    if turns:
        rows.insert(1, ("rotation", f"{', '.join(turns)}, as the file asks"))
    if facts.transfer:
        rows.insert(2, ("transfer", facts.transfer))
    if facts.gaps:
        rows.append(("gaps", f"{facts.gaps}; the model begins anew after each"))
    rows += [("damage", line) for line in facts.damage or ["none found"]]
    rows += [("topic", f"{name}: {what}") for name, what in facts.topics.items()]
    if facts.crop is not None:
        rows.append(("without black borders", str(facts.crop)))
    if facts.still is not None:
        rows.append(("never changes", f"{100 * facts.still_share:.2g} % of the pixels"))
    return rows


def _rate(facts: Survey) -> str:
    """The frame rate as stated and as measured, in words."""
    stated = "none" if facts.fps_stated is None else f"{facts.fps_stated:.6g}"
    if facts.fps_true is None or facts.fps_range is None:
        return stated if facts.fps_stated is None else f"{stated} stated"
    between = "variable, {:.3g} to {:.3g}".format(*facts.fps_range)
    kind = between if facts.is_variable else "constant"
    return f"{stated} stated, {facts.fps_true:.6g} true, {kind}"


def _facts(facts: Survey) -> dict[str, Json]:
    values = {name: value for name, value in vars(facts).items() if name != "still"}
    crop = None if facts.crop is None else str(facts.crop)
    return {**values, "crop": crop, "still_share": facts.still_share, "advice": _advice(facts)}


def _advice(facts: Survey) -> list[str]:
    """Advice for a run on this input, one sentence each."""
    others = (
        (
            facts.is_interlaced,
            "It is interlaced: all commands read it by PyAV and de-interlace it (FFmpeg's bwdif, "
            "one image a frame).",
        ),
        (
            facts.transfer in HDR,
            "It is HDR: all commands read it by PyAV, whose grey levels are those of the file.",
        ),
        (
            (facts.bits or 0) > 8 and facts.decoder == "opencv",
            f"{argument('decoder', 'pyav')} keeps all {facts.bits} bits of a sample, opencv "
            "keeps 8.",
        ),
        (
            facts.damage,
            "Do not trust the response near the damage: copy the file again, or run the part "
            f"before it with {argument('end')}.",
        ),
        (facts.crop, f"The borders are black: {argument('crop')} {facts.crop} leaves them out."),
        (
            facts.still is not None,
            f"{100 * facts.still_share:.2g} % of the pixels never change, as those of an on-screen "
            f"display or of the vehicle itself: {argument('write_mask', 'mask.png')} paints them "
            f"black for {argument('mask')}. Look at it before you use it.",
        ),
    )
    due = [line for is_due, line in others if is_due]
    return [*_rate_advice(facts), _size_advice(facts), *_camera_advice(facts), *due]


def _camera_advice(facts: Survey) -> list[str]:
    """The assumed angles of the camera, which no file states."""
    _, entry = camera_of(InputOptions(), (facts.width, facts.height), facts.path)
    if entry["camera"]["known_by"] != "assumed":
        return []
    fov = f"{entry['camera']['fov']:g}°"
    return [
        f"The file states no camera angles: a level camera of {fov} is assumed. Give the angles "
        f"with {argument('fov')} and {argument('camera_tilt')}."
    ]


def _rate_advice(facts: Survey) -> list[str]:
    lines = []
    fps = facts.fps_true or facts.fps_stated
    model_fps = load_config(PRESETS[0]).model_fps
    if facts.fps_stated is None:
        lines.append(f"Nothing states the frame rate: give it with {argument('input_fps')}.")
    if facts.is_variable:
        lines.append(
            "The frame rate varies. The expansion counts times, but the neuron frames: for the "
            "neuron, record at a constant rate."
        )
    steady_fps = None if facts.is_variable else facts.fps_true
    nominal_fps = rate_between_gaps(facts.fps_stated, steady_fps) or 0.0
    every, _ = sampling_step(nominal_fps, RATE_TOLERANCE * model_fps)
    if every > 1:
        lines.append(
            f"At most {model_fps:g} frames a second are processed by default: one in {every} of "
            f"these. {argument('fps', 'all')} processes every frame."
        )
    n_new = facts.frames - facts.repeats
    if fps is not None and (rate := fps * n_new / max(facts.frames, 1)) < _SLOW_FPS:
        lines.append(
            f"At {rate:.3g} new frames a second an approach looks {model_fps / rate:.2g} times as "
            f"fast to the neuron as at the {model_fps:g} that the parameters are made for. The "
            f"expansion is measured down to {MIN_FPS:g} frames/s; a frame is {1 / rate:.2g} s of "
            "reaction."
        )
    return lines


def _size_advice(facts: Survey) -> str:
    """The size at which the models process the input."""
    source_wh = facts.crop[:2] if facts.crop else (facts.width, facts.height)

    def default(width_px: int) -> str:
        width, height = processed_size(*source_wh, width_px=width_px)
        return f"{width}x{height} px ({argument('scale')} {width / source_wh[0]:.3g})"

    preset = PRESETS[0]
    return (
        f"The preset {preset} processes it at {default(load_config(preset).width_px)}, the "
        f"paper's sets at {default(DEFAULT_WIDTH_PX)}."
    )
