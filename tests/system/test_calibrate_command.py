"""`dlgmd calibrate`: thresholds found again, folds that are held out, searches that continue."""

import json
import re
from contextlib import closing

import pytest
from conftest import looming_frames, write_video

from dlgmd_cli import load_config
from dlgmd_cli.errors import OutputExistsError
from dlgmd_cli.machine import cancel
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.tasks.calibrate.search import Choice, Search, best_trial, parse_range, with_values
from dlgmd_cli.tasks.call import Setup

pytestmark = pytest.mark.slow


def ranges_of(*texts):
    return dict(parse_range(text, DlgmdParameters()) for text in texts)


def test_ranges_wider_than_tenfold_are_searched_by_their_logarithm(tmp_path):
    ranges = ranges_of("sigma_e=0.1:2", "r=2:8", "width_px=100:500")
    with closing(Search(tmp_path, ranges, {})) as search:
        found = search.distributions.values()
    kinds = [(one.log, isinstance(one.low, int)) for one in found]
    assert kinds == [(True, False), (False, True), (False, True)]


def test_a_search_continues_from_its_trials(tmp_path):
    setup = Setup(DlgmdParameters(), "set9")
    ranges = ranges_of("sigma_i=1:4", "width_px=100:500")
    seen = []

    def measure(changed):
        """Better the nearer sigma_i is to 2.5; fold 1 likes wide frames."""
        seen.append((changed.params.sigma_i, changed.width_px))
        one = Choice(2, 0.1, (1 - abs(changed.params.sigma_i - 2.5), -0.5, 0.2))
        return one, one, Choice(3, 0.2, (changed.width_px / 500, 0.0, 0.0))

    with closing(Search(tmp_path, ranges, {"a": 1})) as search:
        assert list(search.run(3, setup, measure)) == [1, 2, 3]
    assert seen[0] == (4.0, 480)  # the setup's own, within the range
    with closing(Search(tmp_path, ranges, {"a": 1})) as search:
        assert len(search) == 3 and list(search.run(6, setup, measure)) == [4, 5, 6]
        trials = search.trials()
    assert [(one.values["sigma_i"], one.values["width_px"]) for one in trials] == seen
    assert best_trial(trials).values["sigma_i"] == min(seen, key=lambda s: abs(s[0] - 2.5))[0]
    assert best_trial(trials, 2).values["width_px"] == max(width for _, width in seen)
    assert trials[0].found == measure(with_values(setup, trials[0].values))
    with pytest.raises(OutputExistsError, match="another search"):
        Search(tmp_path, ranges, {"a": 2})
    with closing(Search(tmp_path, ranges, {"a": 2}, overwrite=True)) as search:
        assert len(search) == 0


def test_an_interrupted_search_begins_with_the_own_values_again(tmp_path):
    setup, seen = Setup(DlgmdParameters(), "set9"), []

    def measure(changed):
        seen.append(changed.params.sigma_i)
        if len(seen) == 1:
            raise cancel.Interrupted
        return (Choice(2, 0.1, (1.0, 0.0, 0.0)),) * 2

    with closing(Search(tmp_path, ranges_of("sigma_i=1:9"), {})) as search:
        with pytest.raises(cancel.Interrupted):
            list(search.run(2, setup, measure))
        assert list(search.run(2, setup, measure)) == [1, 2]
    assert seen[:2] == [5.0, 5.0] and seen[2] != 5.0


def test_values_that_do_not_go_together_are_passed_over(tmp_path):
    setup = Setup(DlgmdParameters(), "set9")
    with closing(Search(tmp_path, ranges_of("alpha=-9:-5"), {})) as search:
        assert list(search.run(3, setup, lambda changed: pytest.fail("impossible"))) == [1, 2, 3]
        assert search.trials() == []


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


def test_a_preset_that_does_what_it_says(runs, footage, tmp_path):
    labels = footage / "labels.csv"
    common = ["calibrate", labels, "--set", 3, "--jobs", 1, "--folds", 3, "--name", "mine"]
    result = runs(*common, "--size", "32x24")
    assert "held out (3 folds)" in result.stdout and "before (set3)" in result.stdout
    assert "only 4 videos have a collision" in result.stderr
    verdict = next(line for line in result.stdout.splitlines() if line.startswith("Held out, "))
    keeps, rate = re.search(r"It (\w+) the limit: ([0-9.]+) of 1\.$", verdict).groups()
    assert " set3: recall " in verdict and (keeps == "keeps") == (float(rate) <= 1)
    assert (tmp_path / "dlgmd-out/mine.png").stat().st_size > 5000
    preset = tmp_path / "dlgmd-out/mine.yaml"
    text = preset.read_text(encoding="utf-8")
    assert "6 videos, 4 collisions" in text and "# Held out (3 folds): recall" in text
    assert load_config(preset).options == {"size": "32x24"}
    facts = json.loads(runs(*common, "--size", "32x24", "--overwrite", "--json").stdout)
    assert preset.read_text(encoding="utf-8") == text and len(facts["folds"]) == 3
    assert facts["verdict"] == verdict and facts["preset"].endswith("mine.yaml")
    same = facts["same_videos"]
    assert same["recall"] >= 0.75 and same["false_alarms"] == 0
    more = ("--config", preset, "--jobs", 1, "--json", "--no-plots", "--no-baselines")
    found = json.loads(runs("evaluate", labels, *more).stdout)["models"]["mine"]
    for key in ("recall", "false_alarms_per_min", "lead_s", "auc", "minutes", "n_sp"):
        assert found[key] == pytest.approx(same[key] if key in same else facts["parameters"][key])


def test_a_preset_of_the_rule_ttc_gets_a_time_to_contact(dlgmd, runs, footage, tmp_path):
    labels = footage / "labels.csv"
    common = ["calibrate", labels, "--jobs", 1, "--folds", 2, "--repeats", "keep"]
    common += ["--alarm", "ttc"]
    facts = json.loads(runs(*common, "--json").stdout)
    params, before = facts["parameters"], load_config("flight").values
    assert params["ttc_alarm"] != before["ttc_alarm"] and params["alarm"] == "ttc"
    assert params["kappa"] == before["kappa"]
    assert all(one.keys() == {"ttc_alarm"} for one in facts["folds"])
    preset = tmp_path / "dlgmd-out/calibrated.yaml"
    assert "# Calibrated: ttc_alarm." in preset.read_text(encoding="utf-8")
    more = ("--config", preset, "--jobs", 1, "--json", "--no-plots", "--no-baselines")
    found = json.loads(runs("evaluate", labels, *more).stdout)["models"]["calibrated"]
    assert found["threshold"] == params["ttc_alarm"] and found["rule"] == "ttc"
    for key in ("recall", "false_alarms_per_min", "lead_s", "auc"):
        assert found[key] == pytest.approx(facts["same_videos"][key])
    refused = dlgmd(*common, "--search", "sigma_i=1:5", "--name", "other")
    assert refused.exit_code == 2 and "add --alarm spikes" in refused.stderr


def test_each_kind_is_scored_and_one_limits_the_false_alarms(runs, footage, tmp_path):
    rows = (footage / "labels.csv").read_text().splitlines()
    kinds = ["kind", "real", "rendered", "real", "rendered", "real", "rendered"]
    labels = footage / "kinds.csv"
    labels.write_text("\n".join(map(",".join, zip(rows, kinds, strict=True))))
    common = ["calibrate", labels, "--set", 3, "--jobs", 1, "--max-false-per-min", "2:real"]
    result = runs(*common)
    shown = [line.split()[0] for line in result.stdout.splitlines()[3:12]]
    assert shown == ["held", "real", "rendered", "on", "real", "rendered", "before", *shown[1:3]]
    text = (tmp_path / "dlgmd-out/calibrated.yaml").read_text(encoding="utf-8")
    assert "2 false alarms per minute on videos of the kind real." in text
    assert "# Held out, real: recall" in text and "# Held out, rendered: recall" in text
    facts = json.loads(runs(*common, "--overwrite", "--json").stdout)
    assert [one["videos"] for one in facts["held_out"]["by_kind"].values()] == [3, 3]


def test_a_search_from_the_command_line(dlgmd, runs, footage, tmp_path):
    common = ["calibrate", footage / "labels.csv", "--set", 3, "--jobs", 1, "--out", "cal"]
    search = ["--search", "r=2:4", "--search", "width_px=24:32", "--json"]
    result = runs(*common, *search, "--trials", 2)
    params = json.loads(result.stdout)["parameters"]
    assert 2 <= params["r"] <= 4 and 24 <= params["width_px"] <= 32
    text = (tmp_path / "cal/calibrated.yaml").read_text(encoding="utf-8")
    assert "2 trials: r = 2:4, width_px = 24:32" in text
    more = runs(*common, *search, "--trials", 3, "--name", "more")
    assert "2 trials are done already" in more.stderr
    other = dlgmd(*common, "--search", "r=2:5", "--name", "other")
    assert other.exit_code == 2 and "another search" in other.stderr


def test_one_collision_is_too_few(dlgmd, footage):
    labels = footage / "one.csv"
    labels.write_text("video,collision_frame\nnear0.avi,19\nfar.avi,\n")
    result = dlgmd("calibrate", labels, "--set", 3, "--jobs", 1)
    assert result.exit_code == 1 and "at least 2" in result.stderr
