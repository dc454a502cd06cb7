"""One input through one model."""

from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.models.readout import read_out
from dlgmd_cli.params import Parameters
from dlgmd_cli.results.tables import Result
from dlgmd_cli.runs.ahead import ReadAhead, opencv_threads
from dlgmd_cli.sources.base import KEPT_PICTURES, Frame
from dlgmd_cli.sources.prepare import Source

_COLUMNS = 6


class Recording:
    """Responses kept as plain numbers, 48 bytes a frame, so that an interrupt loses none."""

    def __init__(self) -> None:
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._values) // _COLUMNS

    def append(self, frame: Frame, response: Response) -> None:
        """Add one frame's response."""
        # One call, so that Ctrl-C finds the row whole or absent.
        self._values.extend(
            (
                frame.index,
                frame.time_s,
                response.p_sum,
                response.s_sum,
                response.attenuation_db,
                response.mp,
            )
        )

    def cut(self, n_frames: int) -> None:
        """Forget what comes after the first `n_frames`."""
        del self._values[n_frames * _COLUMNS :]

    @property
    def n_valid(self) -> int:
        """How many frames the model could answer to."""
        return int(np.count_nonzero(~np.isnan(self.columns()[-1])))

    def columns(self) -> npt.NDArray[np.float64]:
        """A copy, shape (6, n): frame, time_s, p_sum, s_sum, attenuation_db, mp."""
        return np.array(self._values, dtype=np.float64).reshape(-1, _COLUMNS).T.copy()


def run(
    source: Source,
    model: Model,
    recording: Recording,
    on_frame: Callable[[int], None] = lambda n_decoded: None,
) -> None:
    """Feed every frame of `source` to `model` and keep the responses.

    Parameters
    ----------
    source : Source
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
    source: Source,
    model: Model,
    visit: Callable[[Frame, Response], bool],
    wants_layers: Callable[[int], bool] = lambda index: True,
) -> None:
    """Show every frame and the model's response to `visit`, for as long as that returns True.

    Parameters
    ----------
    source : Source
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
            if not visit(frame, model.step(frame.grey, layers=wants_layers(frame.index))):
                return


@contextmanager
def frames_ahead(source: Source) -> Iterator[Iterable[Frame]]:
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


def read_recording(
    recording: Recording, size_wh: tuple[int, int], params: Parameters, *, by_sequence: bool
) -> Result:
    """Everything that follows from a recording.

    Parameters
    ----------
    recording : Recording
        At least one frame.
    size_wh : (int, int)
        Width and height of the processed frames, in px.
    params : Parameters
        The model's; `kappa`, `t_mp` and `n_sp` are used.
    by_sequence : bool
        Spikes follow the potential normalised by its own sequence, not the absolute one.
    """
    frame, time_s, p_sum, s_sum, attenuation_db, mp = recording.columns()
    readout = read_out(
        mp,
        size_wh[0] * size_wh[1],
        kappa=params.kappa,
        threshold=params.t_mp,
        n_sp=params.n_sp,
        by_sequence=by_sequence,
    )
    return Result(
        frame=frame.astype(np.int64),
        time_s=time_s,
        p_sum=p_sum,
        s_sum=s_sum,
        attenuation_db=attenuation_db,
        mp=mp,
        mp_abs=readout.mp_abs,
        mp_seq=readout.mp_seq,
        level=readout.level,
        threshold=np.full_like(mp, params.t_mp),
        spike=readout.spike,
        collision=readout.collision,
    )
