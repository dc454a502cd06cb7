"""From a recording to a result, as a whole or piece by piece."""

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass

import numpy as np

from dlgmd_cli.models.detection import absolute, detect, sequence
from dlgmd_cli.parameters import Parameters
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
        whole = self.recording.columns()
        mp_abs = absolute(whole[-1], self.size_wh[0] * self.size_wh[1], self.params.kappa)
        mp_seq = sequence(whole[-1])
        level = mp_seq if self.by_sequence else mp_abs
        spike, alarm = detect(level, self.params.t_mp, self.params.n_sp)
        for first in range(0, len(mp_abs), n_frames):
            part = slice(first, first + n_frames)
            frame, time_s, p_sum, s_sum, attenuation_db, mp = whole[:, part]
            yield Result(
                frame=frame.astype(np.int64),
                time_s=time_s,
                p_sum=p_sum,
                s_sum=s_sum,
                attenuation_db=attenuation_db,
                mp=mp,
                mp_abs=mp_abs[part],
                mp_seq=mp_seq[part],
                level=level[part],
                threshold=np.full_like(mp, self.params.t_mp),
                spike=spike[part],
                collision=alarm[part],
            )
