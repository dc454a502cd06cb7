"""What a busy computer leaves out, by a clock that the tests step."""

import math
from itertools import pairwise

import numpy as np
import pytest
from conftest import looming_frames

from dlgmd_cli import Alarm, load_set
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.rules import Rule
from dlgmd_cli.models.session import EXPANSION, NEURON, Session
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.live_source import LiveSource, Shot
from dlgmd_cli.watch.load import Load, in_words

PARAMS = DlgmdParameters()
IMAGE = np.zeros((30, 40), np.uint8)


class Both(Rule):
    """A custom rule, whose value may use all, whatever its column."""

    column = "level"


def simulated(load, interval_s, cost_s, end_s, came_s=0.0):
    """The answered frames, as (index, delay in s), of a source that answers keep up with or not.

    `cost_s` gives the seconds that an answer takes, of the time and what is left out.
    """
    made_for = {"width_px": 40, "model_fps": 30.0}
    source = LiveSource("camera", lambda: iter(()), InputOptions(fps="all"), **made_for)
    answered, now_s, n_came = [], 0.0, 0
    while now_s < end_s:
        while n_came * interval_s <= now_s or not source._waiting:
            at_s = n_came * interval_s
            source._publish(Shot(IMAGE, (0, 255), at_s, n_came, at_s))
            n_came += 1
        now_s = max(now_s, source._waiting[0].captured_s)
        frame, began_s = source.take(0.0), now_s
        now_s += cost_s(now_s, load.left_out)
        delay_s = began_s - frame.captured_s
        answered.append((frame.index, delay_s))
        if load.step(now_s, delay_s, now_s - began_s, interval_s):
            source.take_every(load.every)
    return np.array(answered)


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_of_frames_that_come_n_times_too_fast_one_in_n_is_answered(n):
    load = Load("")
    answered = simulated(load, 1 / 30, lambda *_: 0.88 * n / 30, 12.0)
    last = answered[len(answered) // 2 :]
    assert set(np.diff(last[:, 0])) == {n} and load.every == n
    assert last[:, 1].max() < 0.05 + n / 30
    assert load.protects == (30 / n >= 6)


def test_what_keeps_up_leaves_out_nothing():
    """A pause of the whole process, of half a second, changes nothing."""
    load = Load(Alarm(PARAMS).spare)
    answered = simulated(load, 1 / 30, lambda now_s, _: 0.5 if 4 < now_s < 4.04 else 0.025, 8.0)
    assert not load.left_out and load.every == 1
    assert set(np.diff(answered[:, 0])[-60:]) == {1}


@pytest.mark.parametrize(
    ("alarm", "spare"), [("expansion", NEURON), ("ttc", NEURON), ("spikes", EXPANSION)]
)
def test_what_the_rule_does_not_use_goes_first_and_comes_back(alarm, spare):
    """All frames are answered without it; it is back once the computer is idle again."""
    load = Load(Alarm(PARAMS, alarm=alarm).spare)

    def cost_s(now_s, left_out):
        is_busy = 2.0 < now_s < 8.0
        return (0.045 if is_busy else 0.012) * (0.5 if left_out else 1.0)

    simulated(load, 1 / 30, cost_s, 7.0)
    assert load.left_out == spare and load.every == 1
    load = Load(Alarm(PARAMS, alarm=alarm).spare)
    answered = simulated(load, 1 / 30, cost_s, 20.0)
    assert load.left_out == "" and load.every == 1
    assert set(np.diff(answered[:, 0])[-200:]) == {1}


def test_a_custom_rule_keeps_both():
    assert Alarm(PARAMS, alarm=Both).spare == ""
    assert Alarm(PARAMS, alarm="spikes").spare == EXPANSION


def test_below_six_answers_a_second_it_protects_no_more():
    load = Load(Alarm(PARAMS).spare)
    simulated(load, 1 / 5, lambda *_: 0.01, 5.0)
    assert in_words(load.to_dict()) == "only 5.0 answers a second: it protects no more"
    assert load.to_dict() == {"answered_fps": 5.0, "every": 1, "protects": False}
    load.reset()
    simulated(load, 1 / 7, lambda *_: 0.01, 5.0)
    assert load.protects and in_words(load.to_dict()) == ""


def test_it_tries_less_and_less_often_to_leave_out_less():
    load, eased = Load(""), []

    def cost_s(now_s, _):
        eased.append((now_s, load.every))
        return 0.045 if load.every == 1 else 0.018  # too slow for all frames, idle without

    simulated(load, 1 / 30, cost_s, 60.0)
    turns = [b for a, b in pairwise(eased) if a[1] > b[1]]
    assert 2 <= len(turns) <= 8


@pytest.mark.parametrize("left_out", [NEURON, EXPANSION])
def test_a_part_that_was_left_out_restarts(left_out):
    """Its numbers are undefined meanwhile; then they are those of a session that begins there."""
    frames = [
        Frame(number, number / 30, grey, small=grey)
        for number, grey in enumerate(looming_frames(24, 64, 48))
    ]

    def session():
        return Session([create_model(load_set(3))], Expansion())

    whole, busy, late = session(), session(), session()
    usual = [whole.step(frame)[0] for frame in frames]
    found = []
    for frame in frames:
        busy.left_out = left_out if 8 <= frame.index < 16 else ""
        found.extend(busy.step(frame))
    again = [late.step(frame)[0] for frame in frames[16:]]
    gone, kept = ("mp", "expansion") if left_out == NEURON else ("expansion", "mp")
    assert all(math.isnan(getattr(one, gone)) for one in found[8:16])
    assert np.array_equal(
        [getattr(one, kept) for one in found], [getattr(one, kept) for one in usual], equal_nan=True
    )
    assert np.array_equal(
        [getattr(one, gone) for one in found[16:]],
        [getattr(one, gone) for one in again],
        equal_nan=True,
    )
