"""One input through many models, decoded once."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from dlgmd_cli.models.base import Model
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import Frame, Video
from dlgmd_cli.video.prefetch import ReadAhead, opencv_threads


@dataclass
class Entry:
    """A model that takes part, and what it answered so far.

    `size_wh` is the width and height in px of the frames that it is fed.
    """

    model: Model
    size_wh: tuple[int, int]
    recording: Recording = field(default_factory=Recording)


def compare(
    source: Video,
    entries: Sequence[Entry],
    on_frame: Callable[[int], None] = lambda n_decoded: None,
) -> None:
    """Feed every frame of `source` to every model and keep the responses.

    Parameters
    ----------
    source : Video
        Where the frames come from; its own size does not matter.
    entries : sequence of Entry
        At least one. Whatever ends the comparison, their recordings hold what was computed, the
        same frames in each.
    on_frame : callable, optional
        Called after each frame with the number of frames of the input that are done.
    """
    sizes = list(dict.fromkeys(entry.size_wh for entry in entries))

    def frames() -> Iterator[dict[tuple[int, int], Frame]]:
        # Many models keep this thread's counterpart busy, so that frames are made here.
        for picture in source.pictures():
            yield {size: source.frame(picture, size) for size in sizes}

    try:
        with opencv_threads(1), ReadAhead(frames()) as ahead:
            for of_each_size in ahead:
                for entry in entries:
                    frame = of_each_size[entry.size_wh]
                    entry.recording.append(frame, entry.model.step(frame.grey, frame.time_s))
                on_frame(of_each_size[sizes[0]].index + 1)
    finally:
        n_frames = min(len(entry.recording) for entry in entries)
        for entry in entries:
            entry.recording.cut(n_frames)
