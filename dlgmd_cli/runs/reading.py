"""From a recording to a result, as a whole or piece by piece."""

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass

import numpy as np

from dlgmd_cli.models.readout import extremes, read_out
from dlgmd_cli.params import Parameters
from dlgmd_cli.results.tables import Result
from dlgmd_cli.runs.recording import PIECE_FRAMES, Recording


@dataclass(frozen=True)
class Reading:
    """Everything that follows from a recording, computed each time that it is asked for.

    Iterated over, any number of times, it gives the result in pieces of equal length, the last
    one shorter: the memory for it does not depend on how long the recording is.

    Attributes
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

    recording: Recording
    size_wh: tuple[int, int]
    params: Parameters
    _: KW_ONLY
    by_sequence: bool

    def __iter__(self) -> Iterator[Result]:
        return self._pieces(PIECE_FRAMES)

    def whole(self) -> Result:
        """The result in one piece."""
        return next(self._pieces(len(self.recording)))

    def _pieces(self, n_frames: int) -> Iterator[Result]:
        """The result in pieces of at most so many frames, each entry as it is in the whole."""
        ends = extremes(columns[-1] for columns in self.recording.pieces(n_frames))
        n_before = 0
        for frame, time_s, p_sum, s_sum, attenuation_db, mp in self.recording.pieces(n_frames):
            readout = read_out(
                mp,
                self.size_wh[0] * self.size_wh[1],
                kappa=self.params.kappa,
                threshold=self.params.t_mp,
                n_sp=self.params.n_sp,
                by_sequence=self.by_sequence,
                ends=ends,
                n_before=n_before,
            )
            n_before = int(readout.in_a_row[-1])
            yield Result(
                frame=frame.astype(np.int64),
                time_s=time_s,
                p_sum=p_sum,
                s_sum=s_sum,
                attenuation_db=attenuation_db,
                mp=mp,
                mp_abs=readout.mp_abs,
                mp_seq=readout.mp_seq,
                level=readout.level,
                threshold=np.full_like(mp, self.params.t_mp),
                spike=readout.spike,
                collision=readout.collision,
            )
