"""The confidence interval of a share, a rate or a difference over videos."""

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Series

# The confidence level of all intervals, and the number of resamples.
CONFIDENCE, N_RESAMPLES = 0.95, 1000
# By the "rule of three", an event that did not happen in n trials has a probability of up to 3/n.
# Each bound therefore allows for three further events: what -> (lower bound, upper bound).
_UNSEEN = 3.0
_SIDES = {"rate": (0.0, _UNSEEN), "difference": (-_UNSEEN, _UNSEEN), "time": (0.0, 0.0)}


def interval(counts: npt.ArrayLike, of: npt.ArrayLike, what: str) -> tuple[Series, Series]:
    """The 95 % interval of Σ counts / Σ of, by resampling the videos.

    Events of one video belong together. Each resample therefore draws whole videos, with
    replacement, as many as there are. If all videos agree, all resamples are equal; three further
    events widen the interval (0 of 13: 0 to 0.19; none in 10 minutes: 0 to 0.30 per minute).

    Parameters
    ----------
    counts : array_like, shape (videos,) or (videos, T)
        For each video: number of events, difference between two models' numbers, or a time.
    of : array_like, shape (videos,)
        For each video: the denominator, such as number of contacts or minutes.
    what : str
        "share", "rate" or "difference" (with three further events), or "time" (a share of time,
        without further events).

    Returns
    -------
    low, high : ndarray, shape () or (T,)
        NaN if fewer than two videos have a denominator above 0.
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
