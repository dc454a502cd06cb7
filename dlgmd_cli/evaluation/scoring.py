"""What the alarms of one video come to: hits, alarms at contact, false ones, for any threshold.

An alarm counts at its onset, the n_sp-th spike. What it is depends on when that is:

- within the horizon before a collision: a *hit*; the collision is announced, and the lead is the
  time left. Of several, the first counts;
- from the collision to 3 frames after it: *at contact*, neither a hit nor false;
- later: *ignored*, up to the horizon before the video's next collision, if it has one;
- before: *false*. Within 2 s before the first collision it is *early*, too, and still false.

Minutes run to the first collision, or to the end of the video: after a collision no alarm is false.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.detection import MERGE_S, ROUNDING_S, Flags, Series

HORIZON_S, EARLY_S, CONTACT_FRAMES = 1.0, 2.0, 3

FALSE, EARLY, HIT, AT_CONTACT, IGNORED = range(5)
KINDS = ("false", "early", "hit", "contact", "ignored")


@dataclass(frozen=True)
class Course:
    """What is thresholded of one video, and when it shows collisions.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the frames, in seconds, increasing; n of at least 1.
    strength : ndarray, shape (n,)
        What a spike's threshold is compared with; NaN where undefined, and no spike.
    contacts_s : tuple of float
        Times of the collisions, in seconds, increasing.
    frame_s : float
        How long a frame of the video lasts.
    repeated : ndarray, shape (n,), bool, optional
        Frames that repeat the one before: they hold its strength, and count no spike.
    frame : int ndarray, shape (n,), optional
        Numbers of the frames in the video; from 0 unless given.
    """

    time_s: Series
    strength: Series
    contacts_s: tuple[float, ...]
    frame_s: float
    repeated: Flags | None = None
    frame: npt.NDArray[np.int64] | None = None

    def held(self, n_sp: int) -> Series:
        """The strength that the last n_sp frames reach, shape (n,); -inf before there are so many.

        Frames that repeat another are not among them.
        """
        filled = np.where(np.isnan(self.strength), -np.inf, self.strength)
        seen = np.ones(len(filled), np.bool_) if self.repeated is None else ~self.repeated
        seen[:1] = True
        padded = np.concatenate((np.full(n_sp - 1, -np.inf), filled[seen]))
        least = np.lib.stride_tricks.sliding_window_view(padded, n_sp).min(axis=-1)
        return np.asarray(least[np.cumsum(seen) - 1])

    @property
    def minutes(self) -> float:
        """Time in which an alarm is false, horizons included."""
        end_s = min([float(self.time_s[-1]) + self.frame_s, *self.contacts_s[:1]])
        return max(end_s - float(self.time_s[0]), 0.0) / 60.0


@dataclass(frozen=True)
class Tally:
    """What the alarms of one video come to at each of T thresholds.

    Attributes
    ----------
    lead_s : ndarray, shape (collisions, T)
        Time from the first hit to the collision, in seconds; NaN where it is not announced.
    at_contact : ndarray, shape (collisions, T), bool
        Whether it is not announced, but an alarm begins at contact.
    n_false, n_early : int ndarray, shape (T,)
        False alarms; those among them that are early.
    minutes : float
        Time in which alarms are false.
    """

    lead_s: Series
    at_contact: Flags
    n_false: npt.NDArray[np.intp]
    n_early: npt.NDArray[np.intp]
    minutes: float

    @property
    def hits(self) -> Flags:
        """Whether each collision is announced, shape (collisions, T)."""
        return ~np.isnan(self.lead_s)


def onset_thresholds(course: Course, n_sp: int) -> tuple[Series, Series]:
    """Thresholds at which an alarm begins at each row: above `low` and up to `high`.

    The alarm is on where the strength held reaches the threshold. It begins at a row unless it is
    on at the row before, or at any within the `MERGE_S` before: the greatest strength held there
    is `low`.

    Returns
    -------
    low, high : ndarray, shape (n,)
        No threshold lies between them where `low` is not less than `high`.
    """
    time_s, high = course.time_s, course.held(n_sp)
    low = np.concatenate(([-np.inf], high[:-1]))
    # The first row that is too near for a pause between them.
    first = np.searchsorted(time_s, time_s - (MERGE_S - ROUNDING_S), side="right")
    rows = np.arange(len(high))
    for back in range(2, int((rows - first).max(initial=0)) + 1):
        near = rows[back:][rows[back:] - back >= first[back:]]
        low[near] = np.maximum(low[near], high[near - back])
    return low, high


def kinds(course: Course, horizon_s: float) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.intp]]:
    """What an alarm would be that began at each row, and of which collision.

    Returns
    -------
    kind : int ndarray, shape (n,)
        `FALSE`, `EARLY`, `HIT`, `AT_CONTACT` or `IGNORED`.
    collision : int ndarray, shape (n,)
        Number of the collision, of hits and alarms at contact; otherwise -1.
    """
    time_s = course.time_s
    kind = np.full(len(time_s), FALSE, np.int8)
    collision = np.full(len(time_s), -1)
    over_s = -np.inf  # when the collision before is
    for number, contact_s in enumerate(course.contacts_s):
        grace_s = contact_s + CONTACT_FRAMES * course.frame_s + ROUNDING_S
        before = (time_s < contact_s - ROUNDING_S) & (time_s > over_s)
        if number == 0:
            kind[before & (time_s >= contact_s - EARLY_S - ROUNDING_S)] = EARLY
        is_hit = before & (time_s >= contact_s - horizon_s - ROUNDING_S)
        is_at_contact = (time_s >= contact_s - ROUNDING_S) & (time_s <= grace_s)
        kind[time_s > grace_s] = IGNORED
        kind[is_hit], kind[is_at_contact] = HIT, AT_CONTACT
        collision[is_hit | is_at_contact] = number
        over_s = grace_s
    return kind, collision


def tally(
    course: Course, n_sp: int, thresholds: npt.ArrayLike, horizon_s: float = HORIZON_S
) -> Tally:
    """Count what the alarms of a video are, at each of T thresholds, shape (T,)."""
    at = np.atleast_1d(np.asarray(thresholds, np.float64))
    low, high = onset_thresholds(course, n_sp)
    kind, collision = kinds(course, horizon_s)
    may_begin = low < high

    def count(wanted: Flags) -> npt.NDArray[np.intp]:
        """How many rows an alarm begins at."""
        lows, highs = np.sort(low[wanted]), np.sort(high[wanted])
        return np.searchsorted(lows, at, side="left") - np.searchsorted(highs, at, side="left")

    lead_s = np.full((len(course.contacts_s), len(at)), np.nan)
    at_contact = np.zeros(lead_s.shape, np.bool_)
    for number, contact_s in enumerate(course.contacts_s):
        is_own = may_begin & (collision == number)
        rows = np.flatnonzero(is_own & (kind == HIT))
        for row in rows[::-1]:  # so that the first stands at last
            begins = (low[row] < at) & (at <= high[row])
            lead_s[number, begins] = contact_s - course.time_s[row]
        at_contact[number] = (count(is_own & (kind == AT_CONTACT)) > 0) & np.isnan(lead_s[number])
    n_early = count(may_begin & (kind == EARLY))
    n_false = count(may_begin & (kind == FALSE)) + n_early
    return Tally(lead_s, at_contact, n_false, n_early, course.minutes)


def alarms(
    course: Course, n_sp: int, threshold: float, horizon_s: float = HORIZON_S
) -> list[tuple[int, int]]:
    """Row and kind of every alarm at one threshold, in order."""
    low, high = onset_thresholds(course, n_sp)
    kind, _ = kinds(course, horizon_s)
    return [
        (int(row), int(kind[row]))
        for row in np.flatnonzero((low < threshold) & (threshold <= high))
    ]


def peaks(course: Course, n_sp: int, horizon_s: float = HORIZON_S) -> tuple[Series, Series]:
    """The highest strength held within each horizon, and within each stretch as long outside.

    Returns
    -------
    inside : ndarray, shape (collisions,)
        -inf where the video does not reach back so far that the model could answer.
    outside : ndarray, shape (m,)
        Stretches as long as the horizon, backwards from the first horizon or, without a
        collision, from the end of the video; a rest of at least half of that counts, too.
    """
    strongest = course.held(n_sp)
    kind, collision = kinds(course, horizon_s)
    inside = [
        np.max(strongest[(kind == HIT) & (collision == number)], initial=-np.inf)
        for number in range(len(course.contacts_s))
    ]
    start_s, outside = float(course.time_s[0]), []
    end_s = start_s + 60.0 * course.minutes - (horizon_s if course.contacts_s else 0.0)
    while end_s - start_s >= horizon_s / 2:
        is_in = (course.time_s >= end_s - horizon_s) & (course.time_s < end_s - ROUNDING_S)
        if is_in.any():
            outside.append(strongest[is_in].max())
        end_s -= horizon_s
    return np.array(inside), np.array(outside)
