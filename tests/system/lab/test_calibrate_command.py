"""`dlgmd calibrate`: thresholds found again, folds that are held out, searches that continue."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import looming_frames, write_video

from dlgmd_cli import load_config
from dlgmd_cli.errors import OutputExistsError, ParameterError
from dlgmd_cli.lab.evaluation.cases import strength_at
from dlgmd_cli.lab.evaluation.crossvalidation import (
    Choice,
    Choices,
    Rules,
    choose,
    fold_of,
    score_held_out,
    score_same_videos,
    with_choice,
)
from dlgmd_cli.lab.evaluation.scoring import Signal
from dlgmd_cli.lab.evaluation.search import Search, best_trial, parse_ranges, with_values
from dlgmd_cli.models.detection import absolute
from dlgmd_cli.parameters import DlgmdParameters, LgmdParameters
from dlgmd_cli.runs.setup import Setup

pytestmark = pytest.mark.slow

FPS = 30.0


def signal(bursts, contact=None):
    """200 frames of faint noise, and bursts of `(first, n_frames, strength)`."""
    strength = 0.01 * np.random.default_rng(0).random(200)
    for first, n, level in bursts:
        strength[first : first + n] = level
    return Signal(
        np.arange(200) / FPS, strength, () if contact is None else (contact / FPS,), 1 / FPS
    )


def material(n=10):
    """Collisions announced by three frames of 0.5 and more; short flashes are stronger."""
    levels = np.linspace(0.5, 0.9, n)
    near = [signal([(20, 2, 2.0), (60, 8, 0.3), (135, 3, level)], 150) for level in levels]
    return near + [signal([(50, 2, 3.0), (90, 20, 0.4)]) for _ in range(n)]


def test_the_threshold_and_the_count_are_found_again():
    signals, rules = material(), Rules(max_false_per_min=0.0)
    folds = fold_of([bool(one.contacts_s) for one in signals], rules)
    found = choose(signals, folds, rules)
    for choice in (found.overall, *found.of_folds):
        assert choice.n_sp == 3 and 0.4 < choice.threshold <= 0.55
        assert choice.rank[:2] == (1.0, 0.0)
    scores = score_held_out([signals] * 5, folds, found.of_folds, rules)
    assert scores.collisions == 10 and scores.false_alarms == 0
    # Whether the weakest is announced depends on the others alone.
    assert scores.hits >= 9
    assert score_same_videos(signals, found.overall, rules).measures["recall"].value == 1.0
    # With room for mistakes it announces no more, and so makes none.
    assert choose(signals, folds, Rules(max_false_per_min=60.0)).overall == found.overall


def test_recall_is_bought_with_the_false_alarms_that_are_allowed():
    signals = [signal([(135, 3, 0.5)], 150), signal([(135, 3, 0.2)], 150), signal([(50, 9, 0.3)])]
    minutes = sum(one.minutes for one in signals)
    allowed, strict = (
        Rules(max_false_per_min=1.01 / minutes),
        Rules(max_false_per_min=0.99 / minutes),
    )
    folds = [0, 1, 0]
    assert choose(signals, folds, allowed).overall.rank[0] == 1.0
    assert choose(signals, folds, strict).overall.rank[0] == 0.5


def test_no_video_judges_what_was_chosen_on_it():
    signals, rules = material(), Rules(max_false_per_min=0.0)
    folds = fold_of([bool(one.contacts_s) for one in signals], rules)
    # The videos of fold 0 are ten times as strong: what is chosen without them stays, and fails.
    scaled = [
        replace(one, strength=10 * one.strength) if fold == 0 else one
        for one, fold in zip(signals, folds, strict=True)
    ]
    found = choose(scaled, folds, rules)
    assert 0.4 < found.of_folds[0].threshold <= 0.55
    scores = score_held_out([scaled] * 5, folds, found.of_folds, rules)
    assert scores.false_alarms > 0 < score_same_videos(scaled, found.overall, rules).hits < 10


@pytest.mark.parametrize(("n_with", "n_without", "n_folds"), [(10, 15, 5), (3, 4, 5), (2, 0, 5)])
def test_folds_are_even(n_with, n_without, n_folds):
    has = [True] * n_with + [False] * n_without
    folds = np.array(fold_of(has, Rules(folds=n_folds)))
    assert set(folds) == set(range(min(n_folds, len(has))))
    for chosen in (folds, folds[:n_with]):
        counts = np.bincount(chosen, minlength=min(n_folds, len(has)))
        assert counts.max() - counts.min() <= 1
    assert fold_of(has, Rules(folds=n_folds)) == folds.tolist()


@pytest.mark.parametrize("params", [DlgmdParameters(), DlgmdParameters(t_mp=1.0), LgmdParameters()])
def test_the_choice_becomes_parameters(params):
    found = with_choice(params, Choice(3, 0.0123456, (1.0, 0.0, 0.0)))
    assert found.n_sp == 3
    assert absolute(0.0123456, 1, found.kappa) == pytest.approx(found.t_mp, rel=1e-3)
    assert strength_at(found.t_mp, found.kappa) == pytest.approx(0.0123456, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sigma_e", "is not KEY=LOW:HIGH"),
        ("sigma_e=2:1", "does not rise"),
        ("sigma_e=nan:1", "not a finite number"),
        ("sigma_x=1:2", "unknown parameter"),
        ("kappa=0.1:1", "is calibrated without a search"),
        ("ffi_gd=0:1", "is not a number"),
        ("r=0:4", "r = 0 is not at least 1"),
        ("r=1.5:4", "is not a whole number"),
        ("width_px=1:100", "width_px = 1 is not at least 16"),
    ],
)
def test_ranges_that_cannot_be_searched(text, why):
    with pytest.raises(ParameterError, match=why):
        parse_ranges([text], DlgmdParameters())


def test_ranges_wider_than_tenfold_are_searched_by_their_logarithm():
    found = parse_ranges(["sigma_e=0.1:2", "r=2:8", "width_px=100:500"], DlgmdParameters())
    assert [(one.is_wide, one.is_whole) for one in found.values()] == [
        (True, False),
        (False, True),
        (False, True),
    ]


def test_a_search_continues_from_its_trials(tmp_path):
    setup = Setup(DlgmdParameters(), "set9")
    ranges = parse_ranges(["sigma_i=1:4", "width_px=100:500"], setup.params)
    seen = []

    def measure(changed):
        """Better the nearer sigma_i is to 2.5; fold 1 likes wide frames."""
        seen.append((changed.params.sigma_i, changed.width_px))
        recall = 1 - abs(changed.params.sigma_i - 2.5)
        one = Choice(2, 0.1, (recall, -0.5, 0.2))
        return Choices(one, (one, Choice(3, 0.2, (changed.width_px / 500, 0.0, 0.0))))

    search = Search(tmp_path, ranges, {"a": 1})
    assert list(search.run(3, setup, measure)) == [1, 2, 3]
    search.close()
    assert seen[0] == (4.0, 480)  # the setup's own, within the range
    again = Search(tmp_path, ranges, {"a": 1})
    assert len(again) == 3 and list(again.run(6, setup, measure)) == [4, 5, 6]
    trials = again.trials()
    assert [(one.values["sigma_i"], one.values["width_px"]) for one in trials] == seen
    assert best_trial(trials).values["sigma_i"] == min(seen, key=lambda s: abs(s[0] - 2.5))[0]
    assert best_trial(trials, 1).values["width_px"] == max(width for _, width in seen)
    assert trials[0].found == measure(with_values(setup, trials[0].values))
    again.close()
    with pytest.raises(OutputExistsError, match="trials of another search"):
        Search(tmp_path, ranges, {"a": 2})
    anew = Search(tmp_path, ranges, {"a": 2}, overwrite=True)
    assert len(anew) == 0
    anew.close()


def test_values_that_do_not_go_together_are_passed_over(tmp_path):
    setup = Setup(DlgmdParameters(), "set9")
    search = Search(tmp_path, parse_ranges(["alpha=-9:-5"], setup.params), {})
    assert list(search.run(3, setup, lambda changed: pytest.fail("impossible"))) == [1, 2, 3]
    assert search.trials() == []
    search.close()


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Squares that loom, one clip in which nothing is hit, and a still one; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    still = [looming_frames(1)[0]] * 12
    lines = ["video,collision_frame"]
    for number in range(4):
        write_video(folder / f"near{number}.avi", still[: 2 * number] + looming_frames())
        lines.append(f"near{number}.avi,{19 + 2 * number}")
    write_video(folder / "far.avi", [*looming_frames()[:14], *still])
    write_video(folder / "still.avi", still)
    (folder / "labels.csv").write_text("\n".join([*lines, "far.avi,", "still.avi,"]))
    return folder


def test_a_preset_that_does_what_it_says(dlgmd, footage, tmp_path):
    common = ["calibrate", footage / "labels.csv", "--set", 3, "--jobs", 1, "--folds", 3]
    result = dlgmd(*common, "--name", "mine", "--size", "32x24")
    assert result.exit_code == 0, result.output
    assert "held out (3 folds)" in result.stdout and "before (set3)" in result.stdout
    assert "only 4 videos have a collision" in result.stderr
    preset = tmp_path / "dlgmd-out/mine.yaml"
    text = preset.read_text(encoding="utf-8")
    assert (
        "on labels.csv: 6 videos, 4 collisions" in text and "# Held out (3 folds): recall" in text
    )
    assert load_config(preset).options == {"size": "32x24"}
    again = dlgmd(*common, "--name", "mine")
    assert again.exit_code == 2 and "already exists" in again.stderr
    as_json = dlgmd(*common, "--name", "mine", "--size", "32x24", "--overwrite", "--json")
    facts = json.loads(as_json.stdout)
    assert preset.read_text(encoding="utf-8") == text and len(facts["folds"]) == 3
    assert facts["same_videos"]["recall"] >= 0.75 and facts["same_videos"]["false_alarms"] == 0
    judged = dlgmd(
        *["evaluate", footage / "labels.csv", "--config", preset, "--jobs", 1, "--json"],
        *["--no-plots", "--no-baselines"],
    )
    found = json.loads(judged.stdout)["models"]["mine"]
    same = facts["same_videos"]
    for key in ("recall", "false_alarms_per_min", "lead_s", "auc", "minutes", "n_sp"):
        assert found[key] == pytest.approx(same[key] if key in same else facts["parameters"][key])


def test_a_search_from_the_command_line(dlgmd, footage, tmp_path):
    common = ["calibrate", footage / "labels.csv", "--set", 3, "--jobs", 1, "--out", "cal"]
    search = ["--search", "r=2:4", "--search", "width_px=24:32", "--json"]
    result = dlgmd(*common, *search, "--trials", 2)
    assert result.exit_code == 0, result.output
    params = json.loads(result.stdout)["parameters"]
    assert 2 <= params["r"] <= 4 and 24 <= params["width_px"] <= 32
    text = (tmp_path / "cal/calibrated.yaml").read_text(encoding="utf-8")
    assert "searched in 2 trials: r = 2:4, width_px = 24:32" in text
    more = dlgmd(*common, *search, "--trials", 3, "--name", "more")
    assert more.exit_code == 0 and "2 trials are done already" in more.stderr
    other = dlgmd(*common, "--search", "r=2:5", "--name", "other")
    assert other.exit_code == 2 and "trials of another search" in other.stderr


@pytest.mark.parametrize(
    ("options", "code", "why"),
    [
        (["--normalise", "sequence"], 2, "leaves no threshold"),
        (["--name", "../x"], 2, "is not the name of a file"),
        (["--search", "n_sp=1:4"], 2, "calibrated without a search"),
        ([], 1, "needs at least 2"),
    ],
)
def test_what_cannot_be_calibrated(dlgmd, footage, options, code, why):
    labels = footage / "one.csv"
    labels.write_text("video,collision_frame\nnear0.avi,19\nfar.avi,\n")
    result = dlgmd("calibrate", labels, "--set", 3, "--jobs", 1, *options)
    assert result.exit_code == code and why in result.stderr
