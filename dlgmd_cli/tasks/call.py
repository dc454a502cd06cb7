"""What tasks share: progress, the open input with the claimed folder, and what they say of it."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, counted
from dlgmd_cli.parameters.keys import TTC
from dlgmd_cli.results import store
from dlgmd_cli.tasks.setup import ModelName, Request, choose_all, common_options
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.source import Video
from dlgmd_cli.video.writer import clips_of, make_clips, spans_of

_log = logging.getLogger(__name__)

OnFrame = Callable[[int], None]
# Takes a name, a total (None if unknown) and a unit; yields a callback for the number done, which
# may be followed by another name.
Progress = Callable[[str, int | None, str], AbstractContextManager[Callable[..., None]]]


def silent(*_: Any) -> None:
    """The default callback."""


def no_progress(*_: Any) -> AbstractContextManager[Callable[..., None]]:
    """The default `Progress`."""
    return nullcontext(silent)


def fold(
    model: ModelName | Sequence[ModelName] | None,
    formulation: str | None,
    param: Mapping[str, Any] | None,
    engine: str | None,
    options: Mapping[str, Any],
    video: Openable | None = None,
    *,
    repeats_record: bool = True,
) -> Request:
    """What a task is asked for, from its arguments; raises ParameterError, see `choose_all`.

    Of images in memory, `fps` is their rate unless they have an `input_fps`. A single model from a
    run.yaml brings the options of that run, if the task `repeats_record`.
    """
    given = dict(options)
    is_in_memory = video is not None and not isinstance(video, str | os.PathLike)
    if is_in_memory and given.get("input_fps") is None:
        given["input_fps"] = given.pop("fps", None)
    setups = choose_all(model, param, formulation, engine)
    if given.get("normalise") and any(setup.params.alarm == TTC for setup in setups):
        _log.warning("--normalise changes no alarm of the rule ttc, only spikes")
    return Request(tuple(setups), common_options(setups if repeats_record else (), given))


def require_one_each(labels: Sequence[str], n: int, noun: str, hint: str = "") -> None:
    """Raise ParameterError unless there is a label for each of n things, or none."""
    if labels and len(labels) != n:
        why = f"--label is given {counted(len(labels), 'time')}, for {counted(n, noun)}"
        raise ParameterError("", why, hint)


@contextmanager
def opened(
    video: Openable,
    request: Request,
    record: str,
    out: str | os.PathLike[str] | None,
    *,
    overwrite: bool,
) -> Iterator[tuple[Video, store.ClaimedFolder | None]]:
    """The open input, and the folder of its result below `out`, claimed; None without `out`.

    Raises what `Request.open` and `store.claimed` raise.
    """
    with request.open(video) as source:
        if out is None:
            yield source, None
            return
        folder, identity = store.result_folder(Path(out), source.info.name), source.info.identity
        with store.claimed(folder, record, identity, overwrite=overwrite) as claim:
            yield source, claim


@contextmanager
def clips_written(
    source: str,
    name: str,
    onsets_s: Sequence[float],
    folder: Path,
    of_images: Mapping[str, Any] | None = None,
) -> Iterator[list[Path]]:
    """Write a clip of each alarm into a folder, in place of the earlier ones; see `make_clips`.

    They are made before the context, and appear after it. Raises SourceError if the source cannot
    be decoded, and OutputError if the folder cannot be written; earlier clips are unchanged then.
    """
    spans = spans_of(name, onsets_s)
    earlier = [path.name for path in clips_of(folder, name)]
    with ExitStack() as stack:
        if spans or earlier:
            # Without a lock: a batch writes clips of several videos at once.
            claimed = store.claimed(folder, option="--clips", locks=False)
            stage = stack.enter_context(stack.enter_context(claimed).staged(stale=earlier))
            make_clips(source, spans, stage, of_images)
        yield [folder / clip for clip in spans]


def watched(
    video: Video, request: Request, progress: Progress
) -> AbstractContextManager[Callable[..., None]]:
    """The progress over the frames of an input."""
    return progress(video.info.name, request.options.n_expected(video.info), "frame")


def tell(video: Video, request: Request, warnings: Sequence[str]) -> None:
    """Log the warnings about an input, and which of its frames were processed."""
    for warning in warnings:
        _log.warning("%s: %s", video.info.given, warning)
    if request.options.fps in (None, "all") and (sampling := video.sampling()):
        _log.info("Note: %s: %s.", video.info.given, sampling)
    if (request.options.input_fps or video.info.fps) != video.info.fps:
        said = "Note: %s: it states %.4g frames/s, so that --input-fps is not used."
        _log.info(said, video.info.given, video.info.fps)
