"""The LGMD benchmark: its annotations, its score, and `evaluate` on its layout."""

import json
import pickle
from itertools import pairwise

import numpy as np
import pytest
from conftest import csv_rows, looming_frames, write_video

import dlgmd_cli
from dlgmd_cli.errors import ParameterError, ResultError, SourceError
from dlgmd_cli.parameters.presets import find_model
from dlgmd_cli.results.benchmark import (
    REAL,
    SYNTHETIC,
    Sequence,
    means,
    read_annotations,
    response_of,
    separability,
)
from dlgmd_cli.results.roc import Judged, judged, separation
from dlgmd_cli.results.scoring import Signal, contact_of

pytestmark = pytest.mark.usefixtures("here")


def slow_score(r, g):
    """The score as its definition has it, with loops."""
    n, least = len(g), min(g)

    def area(values):
        return sum((a + b) / 2 for a, b in pairwise(values)) / n * 2

    common = area([min(a, b) - least for a, b in zip(r, g, strict=True)])
    together = area([max(a, b) - least for a, b in zip(r, g, strict=True)])
    if max(g) <= 0.5:
        return 1 - together
    return common / together if together else 0.0


@pytest.mark.parametrize("seed", range(20))
def test_the_score_is_that_of_its_definition(seed):
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.5, 1, n := int(rng.integers(1, 60)))
    for g in (
        np.repeat(0.5, n),
        np.repeat(1.0, n),
        rng.uniform(0.5, 1, n),
        rng.choice([0.5, 1], n),
    ):
        assert separability(r, g) == pytest.approx(slow_score(r, g), abs=1e-9)
    assert separability(np.repeat(0.5, n), np.repeat(0.5, n)) == 1
    assert separability([0.5, 1, 1, 0.5], [0.5, 1, 1, 0.5]) == 1


def test_each_model_gets_the_scale_of_the_benchmark():
    level = np.array([np.nan, 0.0, 0.5, 1.0])
    set9, lgmd, field = (find_model(name)() for name in ("dlgmd", "lgmd", "lgmd-2006"))
    assert response_of(level, set9).tolist() == [0.5, 0.5, 0.75, 1.0]
    for params in (lgmd, field):
        assert response_of(level[2:], params).tolist() == [0.5, 1.0]


def test_annotations_with_either_separator(tmp_path):
    entries = {
        "basic test\\looming square\\a.mp4": {"ground_truth": [0.5, 1], "more": 1},
        "other/./b.avi": {"ground_truth": [0.5]},
        "c.avi": {"ground_truth": []},
        "d.avi": [0.5],
        "e.avi": {"ground_truth": [0.4, 0.5]},
        "f.avi": {"ground_truth": [0.5, None]},
        "other\\b2.avi": {"ground_truth": [0.5]},
        "other/b2.avi": {"ground_truth": [0.5]},
    }
    path = tmp_path / "annotations.json"
    path.write_text(json.dumps(entries), encoding="utf-8-sig")
    found, failed = read_annotations(path)
    assert [(one.name, one.group) for one in found] == [
        ("basic test/looming square/a.mp4", "basic test/looming square"),
        ("other/b.avi", "other"),
    ]
    assert sorted(failed) == ["c.avi", "d.avi", "e.avi", "f.avi", "other/b2.avi"]
    for text in ("video,collision_frame\n", "{}", "[]", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(ResultError):
            read_annotations(path)


def test_a_mean_weighs_classes_by_their_videos():
    names = [f"{SYNTHETIC[0]}/a", f"{SYNTHETIC[0]}/b", f"{REAL[2]}/a", "mine/a"]
    listed = [Sequence(name, name, np.empty(0)) for name in names]
    found = means(dict(zip(names, (0.1, 0.3, 0.8, 1.0), strict=True)), listed)
    assert [*found] == [SYNTHETIC[0], REAL[2], "mine", "synthetic", "real", "weighted mean"]
    assert {title: (n, round(mean, 12)) for title, (n, mean) in found.items()} == {
        SYNTHETIC[0]: (2, 0.2),
        REAL[2]: (1, 0.8),
        "mine": (1, 1.0),
        "synthetic": (2, 0.2),
        "real": (1, 0.8),
        "weighted mean": (3, 0.4),
    }
    assert means({"mine/a": 1.0}, listed[3:])["weighted mean"] == (1, 1.0)


class Counting(dlgmd_cli.Model):
    """Answers with the number and the width of the frames that it got."""

    class Own(dlgmd_cli.Parameters):
        rest = 0.5

    params_class = Own

    def reset(self):
        super().reset()
        self.n = 0

    def step(self, luminance, time_s=None):
        self.n += 1
        return dlgmd_cli.Response(mp=0.5 + self.n / 1000 + luminance.shape[1] / 1e6)


def test_a_response_at_rest_is_no_spike():
    class Plain(dlgmd_cli.Parameters):
        pass

    class Rested(Plain):
        rest = 0.25

    class Given(Rested):
        t_mp: float = dlgmd_cli.key(0.9, low=0, high=1)

    def of_a_model(kind):
        return type("M", (Counting,), {"params_class": kind}).params_class()

    found = [of_a_model(kind) for kind in (Counting.Own, Plain, Rested, Given)]
    assert [one.t_mp for one in found] == pytest.approx([0.7, 0.4, 0.55, 0.9])
    assert found[0].kappa is None
    for wrong in ("0.5", 1.0, -0.1):
        with pytest.raises(ParameterError, match=r"rest = .* is not from 0 to below 1"):
            type("Wrong", (dlgmd_cli.Parameters,), {"rest": wrong})


@pytest.mark.parametrize("name", ["lgmd1-lgmd2", "lgmd2-lgmd1"])
def test_a_worker_process_gets_the_parameters_of_any_model(name):
    params = find_model(name)()
    assert pickle.loads(pickle.dumps(params)) == params


@pytest.fixture
def footage(tmp_path):
    """Two classes: a wide video with duplicate frames, and two of which one has another length."""
    frames = looming_frames(12, width=640, height=48)
    truth = {"moving\\a.avi": [0.5] * 8 + [1] * 8, "still/b.avi": [0.5] * 12, "still/c.avi": [0.5]}
    for name, shown in (("moving/a", [*frames, *frames[-1:] * 4]), ("still/b", frames[:1] * 12)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_video(tmp_path / f"{name}.avi", shown)
    write_video(tmp_path / "still/c.avi", frames)
    write_video(tmp_path / "still/d.avi", frames)
    truth["still/gone.avi"] = [0.5]
    entries = {name: {"ground_truth": values} for name, values in truth.items()}
    (tmp_path / "annotations.json").write_text(json.dumps(entries))
    return tmp_path / "annotations.json"


def test_every_frame_gets_a_response_at_full_size(footage, caplog):
    found = dlgmd_cli.evaluate(footage, [Counting, 9], jobs=1, out=footage.parent / "ev")
    label = next(iter(found.responses))
    answers = found.responses[label]["moving/a.avi"]
    np.testing.assert_allclose(answers, 0.5 + np.arange(1, 17) / 1000 + 640 / 1e6)
    own = found.responses["set9"]["moving/a.avi"]
    level = dlgmd_cli.run(footage.parent / "moving/a.avi", 9, scale=1, fps="all", repeats="keep")
    np.testing.assert_allclose(own, 0.5 + np.nan_to_num(level.mp_abs) / 2)
    assert own[0] == 0.5 and len(own) == 16
    assert found.failed == {
        "still/c.avi": "12 frames, but 1 values of the truth",
        "still/gone.avi": "it is missing",
    }
    assert "still/d.avi" in caplog.text and "2 of 4 videos" in str(found.failure)
    (row,) = (
        r
        for r in csv_rows(footage.parent / "ev/sequences.csv")
        if r["model"] == "set9" and r["frames"] == "16"
    )
    truth = [0.5] * 8 + [1] * 8
    assert float(row["separability"]) == pytest.approx(slow_score(own, truth), abs=1e-8)
    stored = json.loads((footage.parent / "ev/responses.json").read_text())
    assert stored["set9"]["results"]["moving/a.avi"] == own.tolist()
    (axes,) = found.plot().axes
    rows = [label.get_text() for label in axes.get_yticklabels()]
    assert rows == [*(of for of in found.means()["set9"] if of not in ("synthetic", "real"))]
    cells = [text.get_text() for text in axes.texts]
    assert cells[:2] == [f"{100 * found.scores[one]['moving/a.avi']:.0f}" for one in found.scores]
    roc, *_ = found.plot("roc").axes
    assert len(roc.lines) == 3 and roc.lines[1].get_ydata()[-1] == 1


def test_table_files_and_json(dlgmd, footage):
    options = ("--set", 9, "--model", "lgmd-2006", "--jobs", 2, "--out", "ev")
    result = dlgmd("evaluate", footage, *options)
    assert result.exit_code == 1 and "weighted mean" in result.stdout
    assert "Response of set9: 0.5 + mp_abs / 2." in result.stdout
    ranks = {r["model"]: r for r in csv_rows("ev/benchmark.csv") if r["class"] == "weighted mean"}
    best = max(ranks.values(), key=lambda row: float(row["separability"]))
    assert best["rank"] == "1" and {r["rank"] for r in ranks.values()} == {"1", "2"}
    facts = json.loads(dlgmd("--json", "evaluate", footage, *options, "--overwrite").stdout)
    scores = facts["models"]["set9"]["separability"]
    assert scores["weighted mean"] == pytest.approx(float(ranks["set9"]["separability"]), abs=1e-8)
    assert facts["failed"].keys() == {"still/c.avi", "still/gone.avi"}


def test_what_has_no_effect_is_refused(footage):
    for options in ({"speed_m_s": 2}, {"scale": 0.5}, {"results": "x"}, {"alarm": "ttc"}):
        with pytest.raises(ParameterError, match=next(iter(options))):
            dlgmd_cli.evaluate(footage, 9, **options)
    footage.write_text('{"gone.avi": {"ground_truth": [0.5]}}')
    with pytest.raises(SourceError, match="no video could be scored"):
        dlgmd_cli.evaluate(footage, 9, jobs=1)


# AUC, ROC, precision and recall


def sample(n_videos, seed=0, levels=40):
    rng = np.random.default_rng(seed)
    videos = []
    for i in range(n_videos):
        positive = np.arange(30) >= (20 if i % 2 else 30)
        response = np.round(rng.normal(positive, 1.0) * levels) / levels
        response[:1] = np.nan
        videos.append(Judged(response, positive))
    return videos


@pytest.mark.parametrize("levels", [2, 1e9])
def test_the_auc_is_the_share_of_pairs_that_are_in_order(levels):
    videos = sample(60, levels=levels)
    found = separation(videos)
    r = np.concatenate([video.known for video in videos])
    y = np.concatenate([video.is_positive for video in videos])
    pairs = r[y][:, None] - np.where(np.isinf(r[~y]), -1e9, r[~y])
    assert found.auc.value == pytest.approx(np.mean((pairs > 0) + (pairs == 0) / 2))
    order = np.unique(r)[::-1]
    precision = np.array([y[r >= at].mean() for at in order])
    recall = np.array([(y & (r >= at)).sum() / y.sum() for at in order])
    assert found.ap.value == pytest.approx(np.diff(recall, prepend=0) @ precision)
    assert found.auc.low < found.auc.value < found.auc.high < 1
    area = np.trapezoid(np.append(0, found.recall), np.append(0, found.false_positive_rate))
    assert area == pytest.approx(found.auc.value, abs=2e-3) and len(found.recall) <= 1000
    assert (found.recall[-1], found.false_positive_rate[-1]) == (1, 1)


def test_an_interval_is_of_whole_videos():
    """Copies of frames in a video narrow nothing; further videos do."""
    few = sample(12)
    copied = [Judged(np.tile(v.response, 20), np.tile(v.is_positive, 20)) for v in few]
    one, other = separation(few).auc, separation(copied).auc
    assert (one.low, one.high) == pytest.approx((other.low, other.high), abs=1e-9)
    many = separation(sample(120)).auc
    assert many.high - many.low < 0.6 * (one.high - one.low)
    assert np.isnan(separation(sample(5)).auc.low)


def test_a_video_has_its_strongest_response_and_may_have_none():
    video = Judged(np.array([np.nan, 3.0, 1.0]), np.array([False, False, True]))
    assert [*map(np.ndarray.tolist, video.strongest)] == [[3.0], [True]]
    none = separation([Judged(np.ones(3), np.zeros(3, bool))])
    assert none.negatives == 3 and str(none.auc) == "–" and not len(none.recall)


def test_frames_before_a_contact_are_positive_and_those_after_it_are_left_out():
    time_s = np.arange(0, 10, 0.5)
    signal = Signal(time_s, time_s.copy(), (contact_of(6.0),), 0.5)
    found = judged(signal)
    assert found.response[found.is_positive].tolist() == [3, 3.5, 4, 4.5, 5, 5.5, 6]
    negative = found.response[~found.is_positive]
    assert negative.tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 7.5, 8, 8.5, 9, 9.5]
