"""One input through one model."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import KEPT_PICTURES, Frame, Video
from dlgmd_cli.video.prefetch import ReadAhead, opencv_threads


def run(
    source: Video,
    model: Model,
    recording: Recording,
    on_frame: Callable[[int], None] = lambda n_decoded: None,
) -> None:
    """Feed every frame of `source` to `model` and keep the responses.

    Parameters
    ----------
    source : Video
        Where the frames come from.
    model : Model
        Reset before the first frame.
    recording : Recording
        Takes the responses. Whatever ends the run, it holds those that were computed.
    on_frame : callable, optional
        Called after each frame with the number of frames of the input that are done.
    """

    def visit(frame: Frame, response: Response) -> bool:
        recording.append(frame, response)
        on_frame(frame.index + 1)
        return True

    watch(source, model, visit, wants_layers=lambda index: False)


def watch(
    source: Video,
    model: Model,
    visit: Callable[[Frame, Response], bool],
    wants_layers: Callable[[int], bool] = lambda index: True,
) -> None:
    """Show every frame and the model's response to `visit`, for as long as that returns True.

    Parameters
    ----------
    source : Video
        Where the frames come from.
    model : Model
        Reset before the first frame.
    visit : callable
        Called with each frame and response in turn; neither is kept here.
    wants_layers : callable, optional
        Says of a frame's number whether the response is to hold layers; all do unless given.
    """
    model.reset()
    # The decoder has threads of its own; OpenCV's would only be in its way.
    with opencv_threads(1), frames_ahead(source) as frames:
        for frame in frames:
            if not visit(
                frame, model.step(frame.grey, frame.time_s, layers=wants_layers(frame.index))
            ):
                return


@contextmanager
def frames_ahead(source: Video) -> Iterator[Iterable[Frame]]:
    """The frames, with the work of making them where there is time for it.

    On frames that are not reduced the model takes longer than the decoder, otherwise the decoder,
    so that grey and resizing are left to this thread.
    """
    if source.size_wh == (source.info.width, source.info.height):
        with ReadAhead(source) as frames:
            yield frames
    else:
        with ReadAhead(source.pictures(KEPT_PICTURES)) as pictures:
            yield map(source.frame, pictures)
