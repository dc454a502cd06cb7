"""Confidence intervals over videos, tests of differences, and the straight line through points.

Events of one video belong together: false alarms come in clusters. What is drawn or flipped is
therefore always a whole video.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Series

# The confidence level of all intervals, the number of resamples, and the probability beyond an end.
CONFIDENCE, N_RESAMPLES = 0.95, 1000
_TAIL = (1.0 - CONFIDENCE) / 2.0
# If no event was seen, up to _UNSEEN events may have been expected: exp(-_UNSEEN) = _TAIL. Each
# bound therefore allows for as many further events: what -> (lower bound, upper bound).
_UNSEEN = -math.log(_TAIL)
_SIDES = {"rate": (0.0, _UNSEEN), "difference": (-_UNSEEN, _UNSEEN), "time": (0.0, 0.0)}
# With fewer videos, the lowest to the highest value has the median in less than 95 % of the cases:
# 1 - 2 / 2^n. An interval without further events needs as many videos.
_LEAST_TIMES = 6
# A test flips all signs in each possible way up to so many videos that differ, else at random.
_ALL_FLIPS, _N_FLIPS = 12, 9999


def interval(counts: npt.ArrayLike, of: npt.ArrayLike, what: str) -> tuple[Series, Series]:
    """The 95 % interval of Σ counts / Σ of, by resampling the videos.

    Each resample draws whole videos, with replacement, as many as there are, and the bounds allow
    for 3.7 further events, as many as may be expected if none was seen (none in 10 minutes: 0 to
    0.37 per minute). If all n videos agree on a share of 0 or 1, resamples do not differ: the exact
    (Clopper-Pearson) bound takes their place, 0.025^(1/n) for 1 (13 of 13: 0.75 to 1).

    Parameters
    ----------
    counts : array_like, shape (videos,) or (videos, T)
        For each video: number of events, difference between two models' numbers, or a time.
    of : array_like, shape (videos,)
        For each video: the denominator, such as number of contacts or minutes.
    what : str
        "share", "rate" or "difference" (with further events), or "time" (a share of time, without
        further events).

    Returns
    -------
    low, high : ndarray, shape () or (T,)
        NaN where the data give none: fewer than two videos with a denominator above 0, for "time"
        fewer than six, and videos that agree on a rate or a share of time above 0.
    """
    every, total = np.asarray(counts, np.float64), np.asarray(of, np.float64)
    every, total = every[total > 0.0], total[total > 0.0]
    n = len(total)
    if n < (_LEAST_TIMES if what == "time" else 2):
        return np.full(every.shape[1:], np.nan), np.full(every.shape[1:], np.nan)
    drawn = resampled(n)
    above, below = drawn @ every, (drawn @ total).reshape(-1, *[1] * (every.ndim - 1))
    if what == "share":
        sides = above / (below + _UNSEEN), (above + _UNSEEN) / (below + _UNSEEN)
    else:
        least, most = _SIDES[what]
        sides = above / below + least / total.sum(), above / below + most / total.sum()
    tails = _TAIL, 1.0 - _TAIL
    low, high = (np.quantile(side, tail, axis=0) for side, tail in zip(sides, tails, strict=True))
    if what != "difference":
        low, high = _where_all_agree(np.asarray((every.T / total).T), what, low, high)
    return np.asarray(low), np.asarray(high)


def resampled(n: int) -> npt.NDArray[np.int64]:
    """How often each of n videos occurs in each resample, shape (N_RESAMPLES, n)."""
    return np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), N_RESAMPLES)


def of_resamples(values: Series, n_videos: int) -> tuple[float, float]:
    """The 95 % interval of a measure from its values in `resampled` videos, NaN where undefined.

    NaN with fewer than six videos, and if all resamples agree.
    """
    known = values[~np.isnan(values)]
    if n_videos < _LEAST_TIMES or np.ptp(known) == 0.0:
        return math.nan, math.nan
    low, high = np.quantile(known, (_TAIL, 1.0 - _TAIL))
    return float(low), float(high)


def _where_all_agree(values: Series, what: str, low: Series, high: Series) -> tuple[Series, Series]:
    """The bounds, exact or NaN where all videos have the same value, shape (videos, T) or less."""
    agree, none = np.ptp(values, axis=0) == 0.0, np.max(values, axis=0) == 0.0
    if what != "share":
        unknown = agree & ~none if what == "rate" else agree
        return np.where(unknown, np.nan, low), np.where(unknown, np.nan, high)
    every, bound = np.min(values, axis=0) == 1.0, _TAIL ** (1.0 / len(values))
    low = np.where(none, 0.0, np.where(every, bound, low))
    return low, np.where(every, 1.0, np.where(none, 1.0 - bound, high))


def p_value(differences: npt.ArrayLike) -> float:
    """The probability of a sum at least as far from 0 if two models did not differ.

    Parameters
    ----------
    differences : array_like, shape (videos,)
        The number of events of one model minus that of the other, for each video.

    Returns
    -------
    float
        Two-sided, by a sign-flip test: if the models do not differ, each difference might as well
        have the other sign. n videos that differ cannot give less than 2 / 2^n; none give 1.
    """
    sizes = np.asarray(differences, np.float64)
    sizes = sizes[sizes != 0.0]
    n, seen = len(sizes), abs(sizes.sum()) - 1e-9
    if n <= _ALL_FLIPS:
        signs = 1 - 2 * (np.arange(2**n)[:, None] >> np.arange(n) & 1)
        return float(np.mean(np.abs(signs @ sizes) >= seen))
    signs = 1 - 2 * np.random.default_rng(0).integers(0, 2, (_N_FLIPS, n))
    return float((np.count_nonzero(np.abs(signs @ sizes) >= seen) + 1) / (_N_FLIPS + 1))


def holm(p_values: Sequence[float]) -> list[float]:
    """The p-values corrected for their number, in the same order (Holm 1979).

    The k-th smallest of m is multiplied by m - k + 1; none is below a smaller one, or above 1.
    """
    p, order = np.asarray(p_values, np.float64), np.argsort(p_values, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(corrected, 1.0).tolist()


class StraightLine(NamedTuple):
    """A least-squares line y = slope · x + intercept, with the half-widths of 95 % intervals.

    The half-widths are NaN with fewer than three points. `r_squared` is the explained share.
    """

    slope: float
    intercept: float
    slope_half: float
    intercept_half: float
    r_squared: float


def line(x: Series, y: Series) -> StraightLine:
    """The least-squares line of n points with exact intervals, if errors are normal, shape (n,).

    The intervals are those of Student's t with n - 2 degrees of freedom. `x` has two values or
    more.
    """
    n, from_mean = len(x), x - x.mean()
    spread = float(from_mean @ from_mean)
    slope = float(from_mean @ y) / spread
    intercept = float(y.mean()) - slope * float(x.mean())
    left = y - slope * x - intercept
    total = float(np.sum((y - y.mean()) ** 2))
    r_squared = 1.0 - float(left @ left) / total if total else math.nan
    if n < 3:
        return StraightLine(slope, intercept, math.nan, math.nan, r_squared)
    half = _student_t(n - 2) * math.sqrt(float(left @ left) / (n - 2) / spread)
    return StraightLine(slope, intercept, half, half * math.sqrt(float(x @ x) / n), r_squared)


def _student_t(n: int) -> float:
    """The t that |t| does not exceed in 95 % of the cases, with n degrees of freedom."""
    low, high = 0.0, math.pi / 2.0
    for _ in range(60):  # for the angle arctan(t / √n), the probability is a finite sum
        angle = (low + high) / 2.0
        sine, cosine = math.sin(angle), math.cos(angle)
        term = total = 0.0 if n == 1 else cosine if n % 2 else 1.0
        for k in range(3 if n % 2 else 2, n - 1, 2):
            term *= cosine * cosine * (k - 1) / k
            total += term
        inside = (2.0 / math.pi) * (angle + sine * total) if n % 2 else sine * total
        low, high = (angle, high) if inside < CONFIDENCE else (low, angle)
    return math.sqrt(n) * math.tan(low)
