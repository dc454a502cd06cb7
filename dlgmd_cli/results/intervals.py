"""The interval of a share, a rate or a difference over videos."""

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Series

# The confidence level of all intervals, and the number of resamples.
CONFIDENCE, N_RESAMPLES = 0.95, 1000
# By the "rule of three", what did not happen in n trials has a probability of up to 3/n. So many
# further events are allowed for, at the lower and at the upper bound.
_UNSEEN = 3.0
_SIDES = {"rate": (0.0, _UNSEEN), "difference": (-_UNSEEN, _UNSEEN), "time": (0.0, 0.0)}


def interval(counts: npt.ArrayLike, of: npt.ArrayLike, what: str) -> tuple[Series, Series]:
    """The 95 % interval of Σ counts / Σ of, with the videos drawn anew.

    Events of one video belong together, so whole videos are drawn: as many as there are, each
    perhaps several times. Where all videos agree, draws do not differ; further events keep the
    interval from being empty there (0 of 13: 0 to 0.19; none in 10 minutes: 0 to 0.30 a minute).

    Parameters
    ----------
    counts : array_like, shape (videos,) or (videos, T)
        Of each video: the events, the difference of events of two models, or a time.
    of : array_like, shape (videos,)
        Of each video: what the counts are of, such as contacts or minutes.
    what : str
        "share", "rate", "difference" (both with three further events), or "time" (a share of time,
        without).

    Returns
    -------
    low, high : ndarray, shape () or (T,)
        NaN where Σ of is 0, or where it is that of a single video.
    """
    every, total = np.asarray(counts, np.float64), np.asarray(of, np.float64)
    if np.count_nonzero(total) < 2:
        return np.full(every.shape[1:], np.nan), np.full(every.shape[1:], np.nan)
    n = len(total)
    drawn = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), N_RESAMPLES)
    below = drawn @ total
    above, below = (drawn @ every)[below > 0.0], below[below > 0.0]
    below = below.reshape(-1, *[1] * (every.ndim - 1))
    if what == "share":
        sides = above / (below + _UNSEEN), (above + _UNSEEN) / (below + _UNSEEN)
    else:
        least, most = _SIDES[what]
        sides = above / below + least / total.sum(), above / below + most / total.sum()
    tails = (1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0
    low, high = (np.quantile(side, tail, axis=0) for side, tail in zip(sides, tails, strict=True))
    return np.asarray(low), np.asarray(high)
