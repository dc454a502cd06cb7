"""The layers P, S and G of a model: as arrays, as a contact sheet, and as a film."""

import logging
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli import cancel
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import collision_frames, labels_of, read_by_video
from dlgmd_cli.results.layers import LayerSheet, write_npz
from dlgmd_cli.results.record import read_record, record_text
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.layers import LayerRun, absent, run_layers, strongest_frames
from dlgmd_cli.runs.run import (
    Progress,
    given_options,
    no_progress,
    open_input,
    require_response,
    responses,
    run_models,
    stepper_on,
    too_short,
)
from dlgmd_cli.runs.setup import ModelName, Setup, choose, input_options
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.source import Video
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

if TYPE_CHECKING:
    from dlgmd_cli.plots.film import Film
    from dlgmd_cli.plots.overlay import Overlay
    from dlgmd_cli.plots.style import Figure

_log = logging.getLogger(__name__)

# More frames are not readable at the width of two columns of a paper.
MAX_FRAMES = 12
_ARRAYS = ("frame", "time_s", "luminance", "p", "s", "g")


@dataclass(frozen=True, eq=False, repr=False)
class LayerResult:
    """The layers of a model at selected frames.

    The arrays of the sheet are attributes: `frame` and `time_s`, shape (n,), and `luminance`, `p`,
    `s` and `g`, shape (n, H, W), see `LayerSheet`.

    Attributes
    ----------
    sheet : LayerSheet or None
        The arrays; None if no frame was asked for.
    result : Result
        The response at all frames that were processed.
    """

    run: LayerRun
    video: Video
    setup: Setup
    options: InputOptions
    wanted: tuple[int, ...]

    @property
    def sheet(self) -> LayerSheet | None:
        return self.run.sheet

    @property
    def result(self) -> Result:
        return self.run.result

    def __getattr__(self, name: str) -> Any:
        if name not in _ARRAYS or self.sheet is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(self.sheet, name)

    def __repr__(self) -> str:
        shown = ", ".join(map(str, self.result.record["frames"])) or "none"
        return f"<LayerResult {self.video.info.name}, {self.setup.label}: frames {shown}>"

    def plot(self) -> "Figure":
        """Heat maps of the layers."""
        from dlgmd_cli.plots.layers import plot_layers

        return plot_layers(self._sheet())

    def files(
        self, formats: Sequence[str] = (), dpi: int = 200, *, npz: bool = False
    ) -> dict[str, store.Write]:
        """File name -> function that writes the file: figures, layers.npz, layers.yaml."""
        from dlgmd_cli.plots.style import figure_files

        sheet, record = self._sheet(), self.result.record
        return {
            **({"layers.npz": partial(write_npz, sheet=sheet)} if npz else {}),
            **figure_files({"layers": self.plot}, formats, dpi),
            store.LAYERS: store.file_of(record_text(record, [record["engine"]])),
        }

    def save(
        self,
        folder: str | os.PathLike[str],
        formats: Sequence[str] = (),
        dpi: int = 200,
        *,
        npz: bool = True,
    ) -> None:
        """Write layers.npz, the figure in `formats`, and layers.yaml; replaces earlier ones.

        Raises OutputError if the folder cannot be written.
        """
        place = Path(folder)
        files = self.files(formats, dpi, npz=npz)
        store.log_undrawn(place, store.commit(place, store.LAYERS, files))

    def film(
        self,
        path: str | os.PathLike[str],
        *,
        overlay: bool = False,
        overwrite: bool = False,
        progress: Progress = no_progress,
    ) -> int:
        """Write an .mp4 of the input, S, G and the MP; returns the number of frames in it.

        With `overlay`, it shows the input at full size, with the active cells tinted. The input is
        read again, and the model runs again. The stop flag cuts the film short.

        Raises
        ------
        SourceError
            If the input cannot be read again, or is too short.
        OutputError, OutputExistsError
            If the film cannot be written, or may not replace a file.
        """
        path = Path(path)
        check_film(path, self.video, overwrite=overwrite)
        run = self.run
        if not all(map(math.isfinite, run.ranges["s"])):  # it was not run over the whole input
            run = layers_of(self.video, self.setup, self.options, (), True, progress).run
        if not run.result.n_valid:
            n_needed = run.model.first_valid_frame + 1
            raise too_short(self.video, self.setup.label, n_needed, self.options)
        film = self._film(run, overlay=overlay)
        with self.video as video:
            return self._render(film, video, len(run.result), path, progress)

    def _sheet(self) -> LayerSheet:
        if self.sheet is None:
            raise ParameterError("", "there are no layers without frames", "Give some.")
        return self.sheet

    def _film(self, run: LayerRun, *, overlay: bool) -> "Film | Overlay":
        from dlgmd_cli.plots.film import Film
        from dlgmd_cli.plots.heat import Scale
        from dlgmd_cli.plots.overlay import Overlay

        video, scales = self.video, (Scale.over(*run.ranges["s"]), Scale.over(*run.ranges["g"]))
        if overlay:
            return Overlay(run.result, video.source_wh[::-1], scales[1].high)
        label = f"{video.info.name} · {self.setup.label}"
        return Film(run.result, video.size_wh[::-1], scales, run.model.layer_units[1:], label)

    def _render(
        self, film: "Film | Overlay", video: Video, n_frames: int, path: Path, progress: Progress
    ) -> int:
        """Write the film while the model runs over the input again."""
        from dlgmd_cli.plots.film import Film

        fps = playable_fps(video.rate_fps)
        if abs(fps / video.rate_fps - 1.0) > 0.01:
            _log.warning("%s plays at %g frames a second, not at %g", path, fps, video.rate_fps)
        n_rendered = 0
        picture_wh = None if isinstance(film, Film) else video.source_wh
        look: Any = {"codec": best_codec(), "is_colour": True, "option": "--video"}
        steppers = [stepper_on(video, self.setup, self.options)]
        found = responses(video, steppers, layers=lambda _: True, picture_wh=picture_wh)
        with (
            progress(f"{video.info.name} → {path.name}", n_frames, "frame") as on_frame,
            video_writer(path, film.shape, fps, **look) as write,
        ):
            for n_rendered, (frame, (response,)) in zip(
                range(1, n_frames + 1), found, strict=False
            ):
                layers: Any = response.layers
                picture: Any = frame.picture
                if isinstance(film, Film):
                    write(film.picture(n_rendered - 1, frame.luminance, layers.s, layers.g))
                else:
                    write(film.picture(n_rendered - 1, picture, layers.g))
                on_frame(n_rendered)
        return n_rendered


def layers(
    video: Openable,
    frames: Iterable[int] | None = None,
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    collision_frame: int | None = None,
    collisions: str | os.PathLike[str] | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> LayerResult:
    """Run a model for its layers: photoreceptors P, summation S and grouping G.

    Parameters
    ----------
    video : str, path, or iterable of ndarray
        The input, as in `run`. An iterator can be read only once: give `frames` then.
    frames : iterable of int, optional
        Numbers of frames, from 0, 12 at most; those with the strongest responses unless given.
    set, config, model, formulation, param, engine
        The model, as in `run`.
    collision_frame, collisions : int, path, optional
        A collision, or a table of labelled ones: no frame after it is chosen.
    progress
        As in `batch`.
    options
        Options of the input, as in `run`.

    Returns
    -------
    LayerResult
        `p`, `s` and `g` are arrays of shape (n, H, W); `plot`, `save` and `film` make what
        `dlgmd layers` writes.

    Raises
    ------
    SourceError
        If nothing can be decoded, or none of the frames is there.
    ParameterError, MissingExtraError
        As in `run`.

    Examples
    --------
    >>> found = layers("flight.mp4", frames=[50, 65, 75], set=9)  # doctest: +SKIP
    >>> found.g.shape  # doctest: +SKIP
    (3, 270, 480)
    >>> found.film("layers.mp4")  # doctest: +SKIP
    """
    setup = choose(set, config, model, param, formulation, engine)
    shared = input_options(setup, given_options(video, options))
    wanted = None if frames is None else chosen_frames(frames)
    contact = contact_of(video, collision_frame, collisions)
    with open_input(video, [setup], shared) as opened:
        return layers_of(opened, setup, shared, wanted, wanted == (), progress, contact=contact)


def chosen_frames(frames: Iterable[int]) -> tuple[int, ...]:
    """The frames of a sheet in order, each once; raises ParameterError if they are too many."""
    chosen = tuple(sorted({*frames}))
    if len(chosen) > MAX_FRAMES:
        why = f"{len(chosen)} frames are too many for one sheet"
        raise ParameterError("Invalid value for '--frames'", why, f"Choose up to {MAX_FRAMES}.")
    return chosen


def contact_of(
    video: Openable, frame: int | None, labels_path: str | os.PathLike[str] | None
) -> int | None:
    """The first collision: the one given, that of a table, or that of a rendered flight."""
    if frame is not None or not isinstance(video, str | os.PathLike):
        return frame
    if labels_path:
        listed = labels_of(read_by_video(Path(labels_path)), os.path.abspath(video))
        if listed is None:
            _log.warning("%s does not list %s", labels_path, video)
        return min(collision_frames(listed or ()), default=None)
    truth = read_record(Path(video).with_suffix(".yaml")) if Path(video).is_file() else {}
    found = truth.get("collision_frame") if "scene" in truth else None
    return found if isinstance(found, int) else None


def layers_of(
    video: Video,
    setup: Setup,
    options: InputOptions,
    frames: tuple[int, ...] | None,
    whole: bool,
    progress: Progress = no_progress,
    *,
    contact: int | None = None,
) -> LayerResult:
    """The layers at some frames of an open video; if `whole`, it is read to its end, for a film.

    For None, a run before chooses the frames with the strongest responses up to the `contact`.
    """
    name, n_frames = video.info.name, options.n_expected(video.info)
    if frames is None:
        warnings = [*video.progress.warnings]
        with progress(name, n_frames, "frame") as on_frame:
            results = run_models(video, [setup], options, on_frame=on_frame)
        cancel.check()
        require_response(video, [setup], results, options)
        blind_s = video.progress.blind_s
        frames = strongest_frames(results[0], contact=contact, blind_s=blind_s)
        video.progress.warnings[:] = warnings
    if not whole:
        n_frames = min(n_frames or sys.maxsize, max(frames) + 1)
    with progress(name, n_frames, "frame") as on_frame:
        run = run_layers(video, setup, options, frames, whole=whole, on_frame=on_frame)
    if not cancel.requested():
        result = run.result
        why_not = absent(sorted({*frames} - {*result.record["frames"]}), video, options.end)
        if frames and run.sheet is None:
            raise SourceError(video.info.given, why_not, "Choose other frames.")
        result.warnings.extend([why_not] if why_not else [])
        result.warnings.extend(result.doubts() if whole else [])
    return LayerResult(run, video, setup, options, frames)


def check_film(path: Path, video: Video, *, overwrite: bool) -> None:
    """Raise now if the film could not be written at the end."""
    store.refuse_existing(path, overwrite=overwrite, option="--video")
    source = Path(video.info.path)
    if path.exists() and source.exists() and path.samefile(source):
        raise ParameterError("", "--video would replace INPUT", "Choose another file.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise store.unwritable(path, error, "--video") from None
