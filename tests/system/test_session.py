"""One way from a frame to a row: what `live --record` writes of a file is what `run` writes."""

import re
import sys
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video

from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion, Measured
from dlgmd_cli.models.session import Session
from dlgmd_cli.parameters.presets import load_set
from dlgmd_cli.results.files import RUN, names_of
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.video import live_source

OF_IMAGES = re.compile(rb"\b(black|flat|noise|frozen)\b")
COUNTING = """
import dlgmd_cli

class Counting(dlgmd_cli.Model):
    columns = ("n_active", "frame_s")

    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        if self.receptors.frame < self.first_valid_frame:
            return dlgmd_cli.Response()
        n_active = float((self.receptors.p(0) > 8).sum())
        more = {"n_active": n_active, "frame_s": -1.0 if time_s is None else time_s}
        return dlgmd_cli.Response(1.0, 0.5, n_active, more=more)
"""


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A video of 60 frames/s; of its 90 images, some come twice, and the end is a still image."""
    folder = tmp_path_factory.mktemp("filmed")
    images = looming_frames(60, 96, 72)
    shown = [image for number, image in enumerate(images) for _ in range(1 + (number % 3 == 2))]
    write_video(folder / "a.avi", [*shown, *[shown[-1]] * 10], fps=60.0)
    mask = np.full((72, 96), 255, np.uint8)
    mask[:9] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    return folder


def quick_clock(times):
    """What `live` takes of `time`, so that a file plays faster."""
    begin_s, sleep = time.monotonic(), time.sleep
    return SimpleNamespace(
        monotonic=lambda: begin_s + times * (time.monotonic() - begin_s),
        sleep=lambda s: sleep(s / times),
    )


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (("--set", 3), ()),
        (("--set", 3), ("--fps", "all")),
        (("--set", 9, "--alarm", "ttc"), ("--fps", "all", "--size", "48x36")),
        ((), ("--crop", "80x60+8+6", "--mask", "mask.png")),
        (("--model", "counting:Counting"), ("--fps", "all")),
        (("--set", 3, "--param", "formulation=released-2021"), ()),
    ],
    ids=str,
)
def test_a_recording_has_the_rows_of_a_run(runs, filmed, monkeypatch, tmp_path, model, options):
    """Byte for byte, a model's own columns too, where no frame is dropped.

    `run` does not judge the images: those reasons of `blind` are in the recording alone.
    """
    (tmp_path / "counting.py").write_text(COUNTING)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "counting", raising=False)
    options = [filmed / one if one == "mask.png" else one for one in options]
    source = live_source.LiveSource
    monkeypatch.setattr(
        live_source, "LiveSource", lambda *a, **k: source(*a, **{**k, "drops": False})
    )
    monkeypatch.setattr(live_source, "time", quick_clock(times=20))
    runs("live", filmed / "a.avi", "--realtime", *model, *options, "--record", "recorded")
    runs("run", filmed / "a.avi", *model, *options)
    for name in names_of(RUN, ()) - {RUN}:
        recorded = OF_IMAGES.sub(b"", (tmp_path / "recorded" / name).read_bytes())
        assert recorded == (tmp_path / "dlgmd-out/a" / name).read_bytes(), name
    stored, expected = read_result("recorded"), read_result("dlgmd-out/a")
    assert np.array_equal(stored.is_repeat, expected.is_repeat)
    assert stored.own_columns == expected.own_columns and len(stored) > 15
    keeps = "formulation=released-2021" in model
    assert stored.is_repeat.any() == (not keeps)
    shares = {"blind_share": None}
    assert stored.summary | shares == expected.summary | shares


def test_a_session_has_the_answers_of_each_model_alone():
    """The expansion is measured once beside all; duplicates are skipped, and a gap begins anew."""
    images, params = looming_frames(20, 96, 72), (load_set(3), load_set(9, kappa=1e-4))
    frames = [Frame(n, n / 30 + (n >= 12), one, small=one) for n, one in enumerate(images)]
    # The gap comes before a duplicate.
    gap = Frame(12, 1.39, images[11], is_repeat=True, after_gap=True, small=images[11])
    frames[12:12] = [gap]
    frames[6:6] = [Frame(6, 5.5 / 30, images[5], is_repeat=True, small=images[5])]
    together = Session([create_model(one) for one in params], Expansion())
    alone = [Session([create_model(one)], Expansion()) for one in params]
    bare = Session([create_model(params[0])])
    for number, frame in enumerate(frames):
        answers = together.step(frame)
        for answer, session in zip(answers, alone, strict=True):
            np.testing.assert_equal(vars(answer), vars(*session.step(frame)))
        (without,) = bare.step(frame)
        assert without.mp is answers[0].mp or without.mp == answers[0].mp or not without.is_valid
        for name, unmeasured in vars(Measured()).items():
            np.testing.assert_equal(getattr(without, name), unmeasured)
        assert isinstance(without, Detection) and answers[1].is_valid == (
            3 <= number < 14 or number >= 17
        )
