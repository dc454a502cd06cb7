"""The one loop: a session on an open video, its rows frame by frame, and the results of models."""

import math
from collections.abc import Callable, Iterator, Sequence

from dlgmd_cli.errors import SourceError, argument, counted
from dlgmd_cli.frame import Frame, small_wh
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import opencv_threads
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.session import Session
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.results.csv import RowList
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import OnFrame, Progress, Request, Setup
from dlgmd_cli.tasks.camera import camera_of, read_headings
from dlgmd_cli.tasks.describing import build_result, changed_since, doubts_of, identified
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.source import Video, read_ahead

# The thread that decodes hands over so many frames at a time, with at most so many cells in all:
# waking another thread takes longer than a step on a small image.
MOST_TOGETHER, TOGETHER_PX = 8, 500_000


def session_on(
    video: Video, setups: Sequence[Setup], options: InputOptions, camera: Camera | None = None
) -> Session:
    """The models, each at its frame size on a video, without the cells that the mask hides.

    With a camera, the session also measures the expansion.
    """
    sizes_wh = [setup.size_on(video, options) for setup in setups]
    models = [create_model(setup.params) for setup in setups]
    picture_wh = video.info.width, video.info.height
    seen_by = camera or camera_of(options, picture_wh, video.info.path)[0]
    for model, size_wh in zip(models, sizes_wh, strict=True):
        model.look(seen_by)
        model.ignore(video.hidden(size_wh))
    if camera is None:
        return Session(models, sizes_wh=sizes_wh)
    expansion = Expansion(camera=camera)
    expansion.ignore(video.hidden(small_wh(*video.source_wh)))
    headings = None if options.heading is None else read_headings(options.heading)
    return Session(models, expansion, sizes_wh, headings)


def responses(
    video: Video,
    session: Session,
    *,
    layers: Callable[[Frame], bool] = lambda frame: False,
    picture_wh: tuple[int, int] | None = None,
    on_frame: OnFrame = call.silent,
) -> Iterator[tuple[Frame, list[Detection]]]:
    """Take a session through an input that is read once; the loop of all commands.

    Parameters
    ----------
    video : Video
        The source of the frames; a thread reads ahead.
    session : Session
        The models, each with its frame size, or None for the video's size; and the expansion.
    layers : callable
        Whether the answers to a frame have the layers.
    picture_wh : (int, int), optional
        Also give the images, at this size, see `Video.frames`.
    on_frame : callable
        Called after each frame with the number of input frames done.

    Yields
    ------
    frame, answers : Frame, list of Detection
        Each frame with the answer of each model. The stop flag ends the loop after a frame.
    """
    sizes_wh = [size_wh or video.size_wh for size_wh in session.sizes_wh]
    measures = session.expansion is not None
    frames = video.frames(*sizes_wh, small=measures, picture_wh=picture_wh)
    n_cells = sum(width * height for width, height in (*sizes_wh, picture_wh or (0, 0)))
    together = min(max(1, TOGETHER_PX // n_cells), MOST_TOGETHER)
    # OpenCV's threads would only compete with the decoder's threads.
    with opencv_threads(1), read_ahead(frames, together=together) as ahead:
        for frame in ahead:
            yield frame, session.step(frame, layers=layers(frame))
            on_frame(frame.index + 1)
            if cancel.requested():
                return


def run_models(
    video: Video,
    request: Request,
    *,
    identity: InputFacts | None = None,
    on_frame: OnFrame = call.silent,
) -> list[Result]:
    """Read `video` once, run every model on it, and measure its expansion beside them.

    Parameters
    ----------
    video : Video
        The source of the frames.
    request : Request
        The models, and the options of the video, for the records and the normalisation.
    identity : InputFacts, optional
        What identifies the input in the records, if it is not the video's own.
    on_frame : callable
        Called after each frame with the number of input frames done.

    Returns
    -------
    list of Result
        One per setup. Their records say ``complete: false`` if not all of the input was used, and
        ``interrupted: true`` if the stop flag ended the loop.

    Raises
    ------
    Interrupted
        If the stop flag ended the loop before the first frame.
    SourceError
        If an image in memory is not as it must be; the error has the results up to it.
    """
    options = request.options
    camera, entry = camera_of(options, (video.info.width, video.info.height), video.info.path)
    session = session_on(video, request.setups, options, camera)
    collected = [RowList(model.columns) for model in session.models]
    fault: SourceError | None = None
    try:
        for _, answers in responses(video, session, on_frame=on_frame):
            for row_list, answer in zip(collected, answers, strict=True):
                row_list.append(answer)
    except SourceError as error:
        if not collected[0]:
            raise
        fault = error
    is_read, results = not (cancel.requested() or fault), []
    if not collected[0]:
        cancel.check()
    for setup, model, row_list in zip(request.setups, session.models, collected, strict=True):
        rows = row_list.rows()
        result = build_result(
            video, setup, model, rows, options, identity, is_read=is_read, more=entry
        )
        result.warnings.extend(doubts_of(result, camera, video.source_wh, options.heading))
        if change := changed_since(setup, identity or {}, video.info.name):
            result.warnings.append(change)
        results.append(result)
    if fault is not None:
        fault.results = tuple(results)
        raise fault
    return results


def answers_of(video: Video, request: Request, progress: Progress) -> list[Result]:
    """The results of all models, with their failure if all images were black or frozen."""
    with call.watched(video, request, progress) as advance:
        identity = identified(video, request.options)
        results = run_models(video, request, identity=identity, on_frame=advance)
    if video.progress.blind:
        for result in results:
            result.failure = SourceError(video.info.given, video.progress.blind)
    return results


def require_response(video: Video, request: Request, results: Sequence[Result]) -> None:
    """Raise SourceError if the input ended before any model had a full history."""
    if any(result.n_valid for result in results) or results[0].interrupted:
        return
    needs = [create_model(setup.params).first_valid_frame + 1 for setup in request.setups]
    n_needed = min(needs)
    raise too_short(video, request.setups[needs.index(n_needed)].label, n_needed, request.options)


def too_short(video: Video, label: str, n_needed: int, options: InputOptions) -> SourceError:
    """The error for an input with fewer frames than a model needs."""
    name, n_read, n_new = video.info.given, video.progress.n_decoded, video.progress.n_new
    if options.start or options.end is not None or options.fps not in (None, "all"):
        last_s = video.progress.last_time_s
        end = "" if math.isnan(last_s) else f"Its last frame read is at {last_s:.3f} s."
        cut = f"{argument('start')}, {argument('end')} and {argument('fps')}"
        why = f"{cut} leave fewer than the {n_needed} frames that {label} needs"
        return SourceError(name, why, end)
    frames = counted(n_read, "frame")
    needs = f"but {label} needs at least {n_needed}"
    if n_new < n_needed <= n_read:
        why = f"{frames}, of which the model processes {n_new}, {needs}"
        every = f"{argument('repeats', 'keep')} and {argument('fps', 'all')}"
        return SourceError(name, why, f"Use a longer clip, or {every}.")
    return SourceError(name, f"{frames}, {needs}", "Use a longer clip.")
