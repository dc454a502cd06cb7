"""Plain stimuli with their ground truth, as arrays or as files."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import argument, counted
from dlgmd_cli.frame import GreyImage
from dlgmd_cli.machine import cancel
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import stating
from dlgmd_cli.results import store
from dlgmd_cli.results.benchmark import ANNOTATIONS, TRUTH
from dlgmd_cli.results.csv import Cells, Table, table_of
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.scenes.benchmark import FPS as BASIC_FPS
from dlgmd_cli.scenes.benchmark import BasicVideo, basic_videos
from dlgmd_cli.scenes.objects import SCENES, find_scene
from dlgmd_cli.scenes.scene import Scene, Truth, invalid
from dlgmd_cli.tasks.call import Progress, no_progress
from dlgmd_cli.video.base import parse_size
from dlgmd_cli.video.writer import MAX_TICKS_PER_S, write_video

_log = logging.getLogger(__name__)

BENCHMARK = "benchmark"


@stating({n: f.type for one in SCENES.values() for n, f in one.options().items()})
def synth(
    scene: str,
    out: str | os.PathLike[str] | None = None,
    *,
    lossless: bool = True,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> RenderedClip | RenderedBenchmark:
    """Render a plain stimulus with its ground truth, as `dlgmd synth` does.

    Parameters
    ----------
    scene : str
        ``"looming"``, ``"receding"``, ``"ball"``, ``"capsule"``, ``"looming-cube"``,
        ``"looming-ball"``, ``"receding-cube"``, ``"translating"``, ``"translating-cubes"``,
        ``"elongating"``, ``"shortening"``, ``"grating"``, ``"rotating"``, or ``"benchmark"``: the
        sixteen basic videos of the LGMD benchmark.
    out : str or path, optional
        Folder for the files of `dlgmd synth`, with `overwrite`. Without it, the images are kept in
        memory.
    lossless : bool, optional
        Write FFV1 in .avi; False: MPEG-4 in .mp4, in which slow frames may become duplicates.
    progress
        As in `batch`.
    options
        Options of the scene: `size` (``"480x270"``), `fps`, `frames`, `seed`, `speed`, `noise` and
        the other options of `dlgmd synth --help`.

    Raises
    ------
    ParameterError
        If the scene or an option does not exist, or the values cannot be rendered.
    OutputError, OutputExistsError
        If a file cannot be written, or may not be replaced.

    Examples
    --------
    >>> cube = synth("looming", speed=5)  # doctest: +SKIP
    >>> run(cube.frames, 9, fps=cube.fps)  # doctest: +SKIP
    """
    if scene == BENCHMARK:
        refuse(_of_scene(options), f"does not work with {BENCHMARK}, whose videos are as they are")
        videos = RenderedBenchmark({f"{one.group}/{one.name}": one for one in basic_videos()})
        if out is not None:
            videos.paths = _write_benchmark(videos, Path(out), lossless, overwrite, progress)
        return videos
    if options.get("noise") is None:
        refuse({"seed": options.get("seed")}, f"works only with {argument('noise')}")
    stimulus = find_scene(scene).configured(_of_scene(options))
    truth = table_of(Truth._fields, stimulus.truth())
    clip = RenderedClip(stimulus.name, stimulus.fps, truth)
    if out is not None:
        clip.paths = _write(clip, stimulus, Path(out), lossless, overwrite, progress)
        return clip
    with progress(scene, len(clip.truth), "frame") as on_frame:
        clip.frames = np.stack(list(_watched(stimulus.frames(), on_frame)))
    return clip


@dataclass(eq=False, repr=False)
class RenderedClip(Outcome):
    """A rendered stimulus; `save` writes its images as NAME.npy and its truth as NAME.csv.

    Attributes
    ----------
    name : str
        The scene's name.
    fps : float
        Frames per second.
    truth : structured ndarray, shape (n,)
        The ground truth of each frame; its columns are those of the CSV.
    frames : ndarray, shape (n, H, W), uint8, or None
        The images, for `run(clip.frames, fps=clip.fps)`; None if they were written to files.
    paths : tuple of Path
        The files, the video first.
    """

    name: str
    fps: float
    truth: Table
    frames: npt.NDArray[np.uint8] | None = None
    paths: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        where = f" in {self.paths[0]}" if self.paths else ""
        return f"<RenderedClip {self.name}: {counted(len(self.truth), 'frame')}{where}>"

    def cells(self) -> Cells:
        """The columns and rows of the truth."""
        return {f"{self.name}.csv": (self.truth.dtype.names or (), self.truth.tolist())}

    def tables(self) -> dict[str, store.Write]:
        """The functions that write the truth, and the images if they are in memory."""
        tables = super().tables()
        if self.frames is not None:
            tables[f"{self.name}.npy"] = partial(_write_array, array=self.frames)
        return tables


def _write_array(path: Path, array: GreyImage) -> None:
    with path.open("wb") as file:  # given a path, NumPy would append .npy to a temporary name
        np.save(file, array)


def _of_scene(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are set, in the form for scenes: sizes are (H, W)."""
    given = {
        name: value
        for name, value in options.items()
        if value is not None and value is not False and value != ()
    }
    if "size" in given:
        given["size"] = parse_size(given["size"])[::-1]
    return given


def _watched(frames: Iterable[GreyImage], on_frame: Callable[..., None]) -> Iterator[GreyImage]:
    """The frames; `on_frame` gets the number of each frame before the frame."""
    for number, frame in enumerate(frames, start=1):
        cancel.check()
        on_frame(number)
        yield frame


def _write(
    clip: RenderedClip,
    scene: Scene,
    folder: Path,
    lossless: bool,
    overwrite: bool,
    progress: Progress,
) -> tuple[Path, ...]:
    """Write ``folder/NAME.avi``, or .mp4, and ``folder/NAME.csv``; returns both paths."""
    codec, suffix = ("ffv1", "avi") if lossless else ("mpeg4", "mp4")
    _check_storable(codec, scene)
    if scene.noise > 0.0 and not lossless:
        kept = "Note: MPEG-4 smooths the noise; %s keeps every pixel of it."
        _log.info(kept, argument("lossless"))
    video, truth = (folder / f"{clip.name}.{end}" for end in (suffix, "csv"))
    # The truth is the record: it must never stand beside the images of another clip.
    videos = [f"{clip.name}.avi", f"{clip.name}.mp4"]
    names = [*videos, truth.name]
    with (
        store.claimed(folder, truth.name, names=names, overwrite=overwrite) as claim,
        progress(clip.name, len(clip.truth), "frame") as on_frame,
        claim.staged(what=video, stale=videos) as stage,
    ):
        images = _watched(scene.frames(), on_frame)
        shape, fps = scene.shape, scene.fps
        write_video(stage / video.name, images, shape, fps, codec=codec, target=video)
        for name, write in clip.tables().items():
            write(stage / name)
    return video, truth


@dataclass(eq=False, repr=False)
class RenderedBenchmark(Outcome):
    """The sixteen basic videos of the LGMD benchmark; `save` writes the frames of each as NAME.npy.

    Attributes
    ----------
    videos : dict of str to BasicVideo
        The videos, with `name`, `frames` and `truth`, by class and name.
    paths : tuple of Path
        The files, annotations.json last.
    """

    videos: dict[str, BasicVideo]
    paths: tuple[Path, ...] = ()

    @property
    def frames(self) -> npt.NDArray[np.uint8]:
        """The frames of all videos, shape (16, 50, 240, 432)."""
        return np.stack([one.frames for one in self.videos.values()])

    def __repr__(self) -> str:
        where = f" in {self.paths[-1].parent}" if self.paths else ""
        return f"<RenderedBenchmark of {counted(len(self.videos), 'video')}{where}>"

    def tables(self) -> dict[str, store.Write]:
        """The functions that write the frames of each video."""
        videos = self.videos.values()
        return {f"{one.name}.npy": partial(_write_array, array=one.frames) for one in videos}

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the number of videos, and the annotations."""
        yield f"{counted(len(self.videos), 'video')} in the folders of their classes"
        yield from self.paths[-1:]


def _write_benchmark(
    rendered: RenderedBenchmark, folder: Path, lossless: bool, overwrite: bool, progress: Progress
) -> tuple[Path, ...]:
    """Write the videos into the folders of their classes, and ``folder/annotations.json``."""
    codec, suffix = ("ffv1", "avi") if lossless else ("mpeg4", "mp4")
    names = {f"{name}.{suffix}": one for name, one in rendered.videos.items()}
    truth = {name: {TRUTH: one.truth.tolist()} for name, one in names.items()}
    others = [f"{name}.{'mp4' if lossless else 'avi'}" for name in rendered.videos]
    taken = [*names, *others, ANNOTATIONS]
    with (
        store.claimed(folder, ANNOTATIONS, names=taken, overwrite=overwrite) as all_,
        progress(BENCHMARK, len(names), "video") as on_video,
    ):
        # The annotations are the record: they never stand beside other videos than theirs.
        store.remove(folder, [ANNOTATIONS, *others])
        for group in dict.fromkeys(one.group for one in names.values()):
            with store.claimed(folder / group) as claim, claim.staged() as stage:
                for number, (name, one) in enumerate(names.items(), start=1):
                    if one.group == group:
                        cancel.check()
                        on_video(number)
                        path, shape = stage / Path(name).name, one.frames.shape[1:]
                        write_video(path, iter(one.frames), shape, BASIC_FPS, codec=codec)
        (last,) = all_.write({ANNOTATIONS: store.file_of(json.dumps(truth))})
    return (*(folder / name for name in names), last)


def _check_storable(codec: str, scene: Scene) -> None:
    """Raise ParameterError if a video cannot store the exact size or frame rate."""
    height, width = scene.shape
    if height % 2 or width % 2:  # OpenCV would silently cut off a row or a column
        why = f"{width}x{height} is odd, and a video needs an even width and height"
        raise invalid("size", why, f"Choose {width + width % 2}x{height + height % 2}.")
    rounded = round(scene.fps, 3)
    if rounded != scene.fps:
        why = f"{scene.fps!r} has more than three decimals, which this video does not keep"
        raise invalid("fps", why, f"Choose {rounded:g}.")
    if codec == "mpeg4" and Fraction(str(rounded)).numerator > MAX_TICKS_PER_S:
        why = f"MPEG-4 cannot hold {rounded:g}"
        raise invalid("fps", why, f"Choose fewer decimals, or {argument('lossless')}.")
