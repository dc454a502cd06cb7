"""The layers P, S and G of a model: as arrays, as a contact sheet, and as a film."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, ParameterError, SourceError, argument, counted, warn
from dlgmd_cli.frame import BgrImage, FloatImage, Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.base import Layers, Response
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.facts import InputFacts, Value, stating
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import RowList, Table, table_of
from dlgmd_cli.results.files import LAYER_ARRAYS
from dlgmd_cli.results.labels import first_collision, tell_outside
from dlgmd_cli.results.outcome import Outcome
from dlgmd_cli.results.record import record_text
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.sheet import ARRAYS, LayerSheet
from dlgmd_cli.tasks import call, stepping
from dlgmd_cli.tasks.call import RUN_ARGUMENTS, ModelName, OnFrame, Progress, Request, no_progress
from dlgmd_cli.tasks.camera import camera_of
from dlgmd_cli.tasks.describing import build_result, doubts_of, identified
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.source import Video
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

# Greatest number of frames that are readable at the width of two columns of a paper.
MAX_SHOWN_FRAMES = 12
# Number of frames to choose, and the share of the peak that their responses should reach.
N_CHOSEN, _RESPONDING = 5, 0.01
# Number of frames after a black or frozen span in which a model responds to the returning image.
_COMING_BACK = 5

# Lowest and highest value of a layer.
Range = tuple[float, float]


@stating(RUN_ARGUMENTS)
def layers(
    video: Openable,
    model: ModelName | None = None,
    *,
    frames: Iterable[int] | None = None,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    collision_frame: int | None = None,
    collisions: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    npz: bool = False,
    film: str | os.PathLike[str] | None = None,
    overlay: bool = False,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> LayerResult:
    """Run a model for its layers: photoreceptors P, summation S and grouping G.

    Parameters
    ----------
    video : str, path, or iterable of ndarray
        The input, as in `run`. An iterator can be read only once: give `frames` then.
    model, formulation, param
        The model, as in `run`.
    frames : iterable of int, optional
        Numbers of frames, from 0, 12 at most; by default, spread from the first alarm to the
        contact, see `telling_frames`.
    collision_frame, collisions : int, path, optional
        The frame of a collision, or a table of labels: no frame after the collision is chosen.
    out : str or path, optional
        Write the files of `dlgmd layers` into ``out/NAME``: the figure in `formats` (PNG with
        `dpi`), layers.yaml and, with `npz`, the arrays; `overwrite` replaces earlier files.
    film : str or path, optional
        Write a film, see `LayerResult.film`, also with `overlay`. With a film, `frames` is empty
        unless given.
    progress
        As in `batch`.
    options
        Options of the input, as in `run`.

    Returns
    -------
    LayerResult
        `p`, `s` and `g` are arrays of shape (n, H, W); `plot`, `save` and `film` make the files of
        `dlgmd layers`.

    Raises
    ------
    SourceError
        If nothing can be decoded, or the video has none of the frames.
    ParameterError, MissingExtraError, OutputError, OutputExistsError
        As in `run`.

    Examples
    --------
    >>> found = layers("flight.mp4", 9, frames=[50, 65, 75])  # doctest: +SKIP
    >>> found.g.shape  # doctest: +SKIP
    (3, 270, 480)
    >>> found.film("layers.mp4")  # doctest: +SKIP
    """
    if isinstance(model, Iterable) and not isinstance(model, str):
        hint = "Give the frames by name: layers(video, 9, frames=[50, 65])."
        raise ParameterError("", "the second argument is one model", hint)
    request = call.fold(model, formulation, param, options, video)
    call.require_measured(request.setups, options)
    wanted = chosen_frames(frames) if frames is not None else () if film is not None else None
    contact = first_collision(video, collision_frame, collisions)
    formats = store.known_formats(formats, store.LAYERS)
    film = None if film is None else Path(film)
    place = None if wanted == () else out
    with call.opened(video, request, store.LAYERS, place, overwrite=overwrite) as (source, claim):
        if film is not None:
            if claim is not None and film.resolve().parent == Path(claim.folder).resolve():
                why = f"{argument('film')} lies in {claim.folder}, where the sheet goes"
                raise ParameterError("", why, "Choose another place.")
            check_film(film, source, overwrite=overwrite)
        whole = film is not None or wanted == ()
        outcome = layers_of(source, request, wanted, whole, progress, contact=contact)
        call.warn_of_input(source, request, outcome.warnings)
        if claim is not None and outcome.sheet is not None:
            outcome.write(claim, outcome.files(formats, dpi, npz=npz))
    if film is None or (outcome.paths and cancel.requested()):
        return outcome
    try:
        outcome.film(film, overlay=overlay, overwrite=True, progress=progress)
    except DlgmdError as error:
        if not outcome.paths:
            raise
        outcome.failure = error
    return outcome


@dataclass(eq=False, repr=False)
class LayerResult(Outcome):
    """The layers of a model at selected frames.

    The arrays of the sheet are attributes: `frame` and `time_s`, shape (n,), and `luminance`, `p`,
    `s` and `g`, shape (n, H, W), see `LayerSheet`.

    Attributes
    ----------
    result : Result
        The response at all frames that were processed; its record lists the `frames` of the sheet.
    sheet : LayerSheet or None
        The arrays; None if no frame was requested.
    label : str
        The model's name.
    wanted : tuple of int
        The requested or chosen frames.
    ranges : dict
        The extremes of `s` and `g` over all frames, if the whole input was run.
    video, request : Video, Request
        The input and the request, from which a film is rendered.
    rendered : (int, int) or None
        The number of rendered images of the film, and the number of images of the whole film.
    """

    RECORD = store.LAYERS
    FIGURES = {"layers": "sheets.plot_layers"}  # noqa: RUF012

    result: Result
    sheet: LayerSheet | None
    label: str
    wanted: tuple[int, ...]
    ranges: dict[str, tuple[float, float]]
    video: Video
    request: Request
    rendered: tuple[int, int] | None = None

    def __getattr__(self, name: str) -> npt.NDArray:
        if name not in ARRAYS or self.sheet is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(self.sheet, name)

    @property
    def computed(self) -> list[int]:
        """The frames whose layers were computed."""
        frames = self.result.record["frames"]
        return frames if isinstance(frames, list) else []

    def __repr__(self) -> str:
        shown = ", ".join(map(str, self.computed)) or "none"
        return f"<LayerResult {self.result.name}, {self.label}: frames {shown}>"

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result, one line each."""
        return self.result.warnings

    @property
    def table(self) -> Table:
        """Number and time of each frame of the sheet."""
        sheet = self._sheet()
        return table_of(ARRAYS[:2], zip(sheet.frame, sheet.time_s, strict=True))

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The sheet."""
        return (self._sheet(),)

    def files(
        self,
        formats: Iterable[str] = (),
        dpi: int | None = None,
        *,
        npz: bool = True,
        **options: Any,
    ) -> dict[str, store.Write]:
        """File name -> function that writes the file: layers.npz, figures, layers.yaml."""
        arrays: dict[str, store.Write] = {LAYER_ARRAYS: self._sheet().write} if npz else {}
        return {**arrays, **super().files(formats, dpi, **options)}

    def record_text(self) -> str:
        """The text of layers.yaml."""
        return record_text(self.result.record)

    def identity(self) -> InputFacts:
        """The facts that identify the input."""
        return self.result.identity()

    def film(
        self,
        path: str | os.PathLike[str],
        *,
        overlay: bool = False,
        overwrite: bool = False,
        progress: Progress = no_progress,
    ) -> int:
        """Write an .mp4 of the input, S, G and the MP; returns the number of frames in it.

        With `overlay`, the film shows the input at full size, with the active cells tinted. The
        input is read again, and the model runs again. The stop flag cuts the film short.

        Raises
        ------
        SourceError
            If the input cannot be read again, or is too short.
        OutputError, OutputExistsError
            If the film cannot be written, or may not replace a file.
        """
        video, request, path = self.video, self.request, Path(path)
        check_film(path, video, overwrite=overwrite)
        is_whole = all(map(math.isfinite, self.ranges["s"]))
        over_all = self if is_whole else layers_of(video, request, (), True, progress)
        session = stepping.session_on(video, [request.setup], request.options)
        (model,) = session.models
        result, n_frames = over_all.result, len(over_all.result)
        if not result.n_valid:
            n_needed = model.first_valid_frame + 1
            raise stepping.too_short(video, self.label, n_needed, request.options)
        draw, shape = _drawing(over_all, model.layer_units[1:], overlay=overlay)
        fps, n_rendered = playable_fps(video.rate_fps), 0
        if abs(fps / video.rate_fps - 1.0) > 0.01:
            warn(f"{path} plays at {fps:g} frames a second, not at {video.rate_fps:g}")
        with (
            video,
            progress(f"{video.info.name} → {path.name}", n_frames, "frame") as on_frame,
            store.claimed(path.parent, named_by="film", locks=False) as claim,
            claim.staged(what=path) as stage,
            video_writer(
                stage / path.name,
                shape,
                fps,
                codec=best_codec(),
                is_colour=True,
                target=path,
                named_by="film",
            ) as write,
        ):
            picture_wh = video.source_wh if overlay else None
            steps = stepping.responses(video, session, layers=lambda _: True, picture_wh=picture_wh)
            for row, (frame, (answer,)) in zip(range(n_frames), steps, strict=False):
                write(draw(row, frame, answer.layers or Layers()))
                n_rendered = row + 1
                on_frame(n_rendered)
        self.paths, self.rendered = (*self.paths, path), (n_rendered, n_frames)
        return n_rendered

    @property
    def complete(self) -> bool:
        """Whether all frames were reached, and the whole film, if any, was rendered."""
        n_rendered, n_frames = self.rendered or (0, 0)
        return self.result.complete and n_rendered == n_frames

    def kept(self) -> str:
        """A line about the frames and images kept after an interruption."""
        if self.rendered is not None:
            return "{} holds the first {} of {} frames".format(self.paths[-1], *self.rendered)
        return f"{self.paths[0]} holds {len(self.computed)} of {len(self.wanted)} frames"

    def _sheet(self) -> LayerSheet:
        if self.sheet is None:
            raise ParameterError("", "there are no layers without frames", "Give some.")
        return self.sheet


def chosen_frames(frames: Iterable[int]) -> tuple[int, ...]:
    """The frames of a sheet in order, each once; raises ParameterError for more than 12."""
    if not isinstance(frames, Iterable) or isinstance(frames, str):
        raise ParameterError("", "frames is not a list", "Write frames=[50, 65].")
    chosen = tuple(sorted({*frames}))
    if len(chosen) > MAX_SHOWN_FRAMES:
        why = f"{len(chosen)} frames are too many for one sheet"
        raise ParameterError("", why, f"Choose up to {MAX_SHOWN_FRAMES}.", "frames")
    return chosen


def layers_of(
    video: Video,
    request: Request,
    frames: tuple[int, ...] | None,
    whole: bool,
    progress: Progress = no_progress,
    *,
    contact: int | None = None,
) -> LayerResult:
    """The layers at some frames of an open video; `whole` reads the video to its end, for a film.

    If `frames` is None, a first run chooses frames, see `telling_frames`.
    """
    if frames is None:
        frames = _chosen(video, request, progress, contact)
    n_frames = request.options.n_expected(video.info)
    if not whole:
        n_frames = min(n_frames or sys.maxsize, max(frames) + 1)
    with progress(video.info.name, n_frames, "frame") as on_frame:
        outcome = run_layers(video, request, frames, whole=whole, on_frame=on_frame)
    if not cancel.requested():
        result = outcome.result
        missing = sorted({*frames} - {*outcome.computed})
        why_not = absent(missing, len(result))
        if frames and outcome.sheet is None:
            hint = f"Choose from {result.frame[0]} to {result.frame[-1]}."
            raise SourceError(video.info.given, why_not, hint)
        result.warnings.extend([why_not] if why_not else [])
    return outcome


def _chosen(
    video: Video, request: Request, progress: Progress, contact: int | None
) -> tuple[int, ...]:
    """The frames that tell most, from a run over the video."""
    with call.watched(video, request, progress) as on_frame:
        results = stepping.run_models(video, request, on_frame=on_frame)
    cancel.check()
    stepping.require_response(video, request, results)
    tell_outside(video.info.name, results[0].frame, [] if contact is None else [contact])
    return telling_frames(results[0], contact=contact, blind_s=video.progress.blind_s)


def run_layers(
    video: Video,
    request: Request,
    frames: Collection[int] = (),
    *,
    whole: bool = True,
    on_frame: OnFrame = call.silent,
) -> LayerResult:
    """Run a model until all of `frames` are processed or, if `whole`, to the end of the input.

    Raises Interrupted if the stop flag ended the run before the first requested frame.
    """
    setup, options = request.setup, request.options
    camera, _ = camera_of(options, (video.info.width, video.info.height), video.info.path)
    measured_by = camera if rule_of(setup.params).uses_expansion else None
    session, rows = stepping.session_on(video, [setup], options, measured_by), RowList()
    kept: list[tuple[Frame, Response]] = []
    ranges = dict.fromkeys("sg", (math.inf, -math.inf))
    last = -1 if whole else max(frames)
    is_read = True

    def is_kept(frame: Frame) -> bool:
        return frame.index in frames and not frame.is_repeat

    shows = (lambda _: True) if whole else is_kept
    steps = stepping.responses(video, session, layers=shows, on_frame=on_frame)
    for frame, (response,) in steps:
        rows.append(response)
        if is_kept(frame):
            kept.append((frame, response))
        if whole:
            _widen(ranges, response)
        elif frame.index >= last:
            is_read = False
            on_frame(frame.index + 1)
            break
    stopped = cancel.requested()
    if stopped and not kept:
        raise cancel.Interrupted
    (model,) = session.models
    identity, shown = identified(video, options), [frame.index for frame, _ in kept]
    is_read = is_read and not stopped
    result = build_result(
        video, setup, model, rows.rows(), options, identity, is_read=is_read, more={"frames": shown}
    )
    result.record["complete"] = not stopped or len(kept) == len(frames)
    if whole and not stopped:
        result.warnings.extend(doubts_of(result, camera, video.source_wh))
    units = model.layer_units
    sheet = _sheet(kept, units, f"{video.info.name} · {setup.label}") if kept else None
    return LayerResult(result, sheet, setup.label, tuple(frames), ranges, video, request)


def telling_frames(
    result: Result,
    n_frames: int = N_CHOSEN,
    *,
    contact: int | None = None,
    blind_s: Sequence[tuple[float, float]] = (),
) -> tuple[int, ...]:
    """Numbers of frames spread evenly from the first alarm to the contact, in order.

    Without a known `contact` (by default, of a rendered clip), they end at the strongest response.
    If there is no such alarm, or too few frames follow, the frames with the strongest responses are
    chosen, see `strongest_frames`. Frames are left out after the contact, and within or just after
    the black or frozen spans `blind_s` (s), unless no others remain.
    """
    known = result.until(contact).contact_s
    result = _seen(result, contact, blind_s)
    new = np.flatnonzero(~result.is_repeat)
    if result.alarm_onsets.size:
        strongest = int(np.argmax(np.nan_to_num(result.mp)))
        last = strongest if known is None else len(result) - 1
        new = new[(new >= result.alarm_onsets[0]) & (new <= last)]
        if len(new) >= n_frames:
            even = np.linspace(0, len(new) - 1, n_frames).round().astype(int)
            return tuple(result.frame[new[even]].tolist())
    return strongest_frames(result, n_frames)


def _seen(result: Result, contact: int | None, blind_s: Sequence[tuple[float, float]]) -> Result:
    """The result without frames after the contact and blind frames, unless no others remain."""
    shown = np.ones(len(result), np.bool_)
    for begin_s, end_s in blind_s:
        blind = np.flatnonzero((result.time_s >= begin_s) & (result.time_s <= end_s))
        shown[blind.min(initial=len(result)) : blind.max(initial=-1) + 1 + _COMING_BACK] = False
    if contact is not None:
        shown &= result.frame <= contact
    elif result.contact_s is not None:
        shown &= result.time_s <= result.contact_s
    return replace(result, rows=result.rows[shown]) if shown.any() else result


def strongest_frames(result: Result, n_frames: int = N_CHOSEN) -> tuple[int, ...]:
    """Numbers of the frames with the strongest responses, spread out, in order.

    Frames are chosen by decreasing response, skipping frames near a chosen frame. If there is no
    response, the chosen frames are spread over all.
    """
    strength = np.where(result.is_repeat, 0.0, np.nan_to_num(result.mp))
    n_strong = np.count_nonzero(strength >= _RESPONDING * strength.max())
    n_candidates = min(max(int(n_strong), n_frames), np.count_nonzero(strength))
    rows = np.sort(np.argsort(-strength, kind="stable")[:n_candidates])
    if not rows.size:
        even = np.linspace(0, len(result) - 1, min(n_frames, len(result)))
        rows = np.unique(even.round().astype(int))
    gap = max(1, len(rows) // (2 * n_frames))
    chosen: list[int] = []
    for place in np.argsort(-strength[rows], kind="stable"):
        if len(chosen) < n_frames and all(abs(place - other) >= gap for other in chosen):
            chosen.append(int(place))
    return tuple(int(result.frame[rows[place]]) for place in sorted(chosen))


def absent(missing: list[int], n_processed: int) -> str:
    """The missing ones of the requested frames, and a likely reason; empty if none is missing."""
    if not missing:
        return ""
    first, last, rate = map(argument, ("start", "end", "fps"))
    return (
        f"none of the {counted(n_processed, 'frame')} that were processed is frame "
        f"{', '.join(map(str, missing))}; {first}, {last}, {rate} and duplicates leave frames out"
    )


def _widen(ranges: dict[str, Range], response: Response) -> None:
    """Extend the ranges by the layers of one frame."""
    for name, (lowest, highest) in ranges.items():
        layer = getattr(response.layers or Layers(), name)
        if layer is not None:
            ranges[name] = min(lowest, float(layer.min())), max(highest, float(layer.max()))


def _sheet(
    kept: list[tuple[Frame, Response]], units: tuple[str, str, str], label: str
) -> LayerSheet:
    """The sheet of the kept frames, at least one."""
    undefined = np.full(kept[0][0].grey.shape, np.nan, dtype=np.float32)

    def stack(name: str) -> FloatImage:
        layers = [getattr(response.layers, name) for _, response in kept]
        return np.stack([undefined if layer is None else layer for layer in layers])

    frames = [frame for frame, _ in kept]
    return LayerSheet(
        np.array([frame.index for frame in frames]),
        np.array([frame.time_s for frame in frames]),
        np.stack([frame.luminance for frame in frames]),
        stack("p"),
        stack("s"),
        stack("g"),
        units,
        label,
    )


def _drawing(
    of: LayerResult, units: tuple[str, str], *, overlay: bool
) -> tuple[Callable[[int, Frame, Layers], BgrImage], tuple[int, int]]:
    """The function that draws the image of a film at a row, and the shape of the images."""
    from dlgmd_cli.plots.film import Film
    from dlgmd_cli.plots.heat import Overlay, Scale

    video, s, g = of.video, Scale.over(*of.ranges["s"]), Scale.over(*of.ranges["g"])
    if overlay:
        tinted = Overlay(of.result, video.source_wh[::-1], g.high)
        return lambda row, frame, layers: tinted.picture(row, frame.picture, layers.g), tinted.shape
    title = f"{video.info.name} · {of.label}"
    film = Film(of.result, video.size_wh[::-1], (s, g), units, title)
    return (
        lambda row, frame, layers: film.picture(row, frame.luminance, layers.s, layers.g),
        film.shape,
    )


def check_film(path: Path, video: Video, *, overwrite: bool) -> None:
    """Raise an error before the run if the film could not be written after it."""
    store.refuse_existing(path, overwrite=overwrite, named_by="film")
    source = Path(video.info.path)
    if path.exists() and source.exists() and path.samefile(source):
        raise ParameterError("", f"{argument('film')} would replace INPUT", "Choose another file.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise store.unwritable(path, error, "film") from None
