"""The response's peak time against l/|v|, as recorded from the locust's LGMD, and its fit."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.results.intervals import line
from dlgmd_cli.results.result import Result


class LoomingFit(NamedTuple):
    """The line t_peak = slope · ``l/|v|`` - delay through the peaks of n approaches.

    Each value has a 95 % interval: NaN with fewer than three approaches.

    Attributes
    ----------
    slope, slope_low, slope_high : float
        α, without a unit.
    delay_s, delay_low_s, delay_high_s : float
        δ in seconds: minus the intercept.
    angle_deg, angle_low_deg, angle_high_deg : float
        The angular threshold 2 arctan(1/α) in degrees; 180 for a slope of 0 or less.
    r_squared : float
        The share of the variance that the line explains.
    n : int
        Number of approaches with a peak.
    """

    slope: float
    slope_low: float
    slope_high: float
    delay_s: float
    delay_low_s: float
    delay_high_s: float
    angle_deg: float
    angle_low_deg: float
    angle_high_deg: float
    r_squared: float
    n: int


def looming_fit(l_over_v_s: npt.ArrayLike, peak_s: npt.ArrayLike) -> LoomingFit:
    """Fit the time of the peak against ``l/|v|``, from stimuli or from any table of approaches.

    An object of half-size l that approaches at speed v subtends 2 arctan(``l/|v|`` / t) at time t
    before contact. If the response peaks a delay δ after a threshold angle θ, then
    t_peak = α ``l/|v|`` - δ with θ = 2 arctan(1/α) [Gabbiani1999].

    Parameters
    ----------
    l_over_v_s : array_like, shape (approaches,)
        Half-size of the object over its speed, in seconds.
    peak_s : array_like, shape (approaches,)
        Time of the peak before contact in seconds, see `peak_before_contact`; approaches with NaN
        are left out.

    Returns
    -------
    LoomingFit
        With intervals of Student's t, exact if the peaks' errors are independent and normal.

    Raises
    ------
    ParameterError
        If the shapes differ, a ``l/|v|`` is not above 0, or fewer than two values of it have a
        peak.

    Notes
    -----
    [Gabbiani1999] F. Gabbiani, H. G. Krapp and G. Laurent, Journal of Neuroscience 19(3),
    1122-1141, doi:10.1523/JNEUROSCI.19-03-01122.1999.

    Examples
    --------
    >>> fit = looming_fit([0.02, 0.04, 0.06, 0.08], [0.03, 0.07, 0.12, 0.16])
    >>> round(fit.slope, 2), round(1000 * fit.delay_s), round(fit.angle_deg)
    (2.2, 15, 49)
    """
    x, y = np.asarray(l_over_v_s, np.float64), np.asarray(peak_s, np.float64)
    if x.shape != y.shape or x.ndim != 1:
        raise ParameterError("", f"l/|v| has the shape {x.shape}, the peaks have {y.shape}")
    if (x <= 0.0).any():
        raise ParameterError("", f"l/|v| = {x.min():g} is not above 0")
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if len(np.unique(x)) < 2:
        why = f"{len(np.unique(x))} values of l/|v| have a peak; a line needs two or more"
        raise ParameterError("", why)
    fit = line(x, y)
    slopes = fit.slope, fit.slope - fit.slope_half, fit.slope + fit.slope_half
    angle, high, low = (math.degrees(2.0 * math.atan2(1.0, max(a, 0.0))) for a in slopes)
    if math.isnan(fit.slope_half):
        low = high = math.nan
    delay, half = -fit.intercept, fit.intercept_half
    delays, angles = (delay, delay - half, delay + half), (angle, low, high)
    return LoomingFit._make((*slopes, *delays, *angles, fit.r_squared, len(x)))


def peak_before_contact(result: Result, contact_s: float | None = None) -> float:
    """Time from the greatest membrane potential to the contact, in seconds.

    `contact_s` is the time of the contact in the video, in seconds; by default, that of the
    result's `collision_frame`, or of a stimulus. Later frames do not count. NaN if the model never
    responds. Raises ParameterError if the contact is not known.
    """
    contact_s = result.contact_s if contact_s is None else contact_s
    if contact_s is None:
        hint = "Give its time, or result.until(140) with its frame."
        raise ParameterError("", f"the contact of {result.name} is not known", hint)
    mp = np.where(result.time_s <= contact_s, np.nan_to_num(result.mp), 0.0)
    if not mp.max(initial=0.0) > 0.0:
        return math.nan
    return float(contact_s - result.time_s[int(mp.argmax())])
