"""Rules as objects: a third one is treated rightly by all that ask it; unknown ones are refused."""

import json
import os
import pickle
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import documents
import looming
import numpy as np
import pytest
from conftest import csv_rows, looming_frames, make_result, write_video, yaml_of
from figures import approach

import dlgmd_cli
from dlgmd_cli import Alarm, load_set
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.rules import rule_named, rule_of
from dlgmd_cli.parameters.keys import RULES, changed, recorded_parameters
from dlgmd_cli.results.reading import read_comparison

LOOM = looming_frames(40, 240, 136)
PARAM = {"alarm": "either", "kappa": 3e-4, "n_sp": 1, "ttc_alarm": 1.0}
OPTIONS = [part for item in PARAM.items() for part in ("--param", "{}={}".format(*item))]


@pytest.fixture(scope="module", autouse=True)
def either():
    """The third rule, known as long as these tests run."""
    yield import_module("either").Either
    del RULES["either"], sys.modules["either"]


@pytest.fixture(scope="module")
def results():
    """One approach by each rule."""
    found = {}
    for name in RULES:
        param = PARAM | {"alarm": name}
        if name in ("spikes", "expansion", "corridor"):
            del param["ttc_alarm"]
        found[name] = dlgmd_cli.run(LOOM, 9, fps=30, param=param, repeats="keep")
    return found


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Two approaches and a still scene; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    still = LOOM[:1] * 12
    for name, frames in {"a": LOOM, "b": still + LOOM, "still": still}.items():
        write_video(folder / f"{name}.avi", frames)
    text = "video,collision_frame\na.avi,39\nb.avi,51\nstill.avi,\n"
    (folder / "labels.csv").write_text(text)
    return folder


def test_a_run_raises_the_alarms_of_both_and_says_so(results):
    ours, spikes, ttc = (results[name] for name in ("either", "spikes", "ttc"))
    assert 0 < spikes.alarms.sum() != ttc.alarms.sum() > 0
    np.testing.assert_array_equal(ours.alarms, spikes.alarms | ttc.alarms)
    assert ours.summary["rule"] == "either"
    assert {alarm.to_dict()["rule"] for alarm in ours.alarm_list} == {"either"}
    (_, rows), *_ = ours.shown()
    assert ("alarm rule", f"either: {ours.rule.quantity} of 1 or more") in rows
    # It needs the expansion, of which too slow a video tells little.
    slow = approach("either")
    slow.rows["time_s"] *= 2.0  # 5 frames/s
    assert any("expansion rates are unreliable" in line for line in slow.doubts())


@pytest.mark.usefixtures("here")
def test_it_is_scored_and_calibrated_by_its_own_strength(runs, footage):
    common = (footage / "labels.csv", "--set", 9, *OPTIONS, "--repeats", "keep")
    command = ("evaluate", *common, "--no-baselines", "--out", "ev", "--json")
    (facts,) = json.loads(runs(*command).stdout)["models"].values()
    assert (facts["rule"], facts["threshold"], facts["n_sp"]) == ("either", 1.0, 1)
    rows = csv_rows("ev/curves.csv")
    assert {(row["rule"], row["excitation"]) for row in rows} == {("either", "")}
    # An alarm of the curve is one of a run at that threshold.
    best = facts["best"]["threshold"]
    result = dlgmd_cli.run(footage / "a.avi", 9, param=PARAM, repeats="keep")
    changed_rule = result.rule.tuned(best, 1)
    again = dlgmd_cli.run(footage / "a.avi", changed_rule, repeats="keep")
    np.testing.assert_array_equal(again.alarms, result.strength >= best)
    assert (facts["best"]["hits"] > 0) == again.alarms.any()
    assert yaml_of("ev/evaluate.yaml")["models"][0]["alarm"] == "either"
    found = json.loads(runs("calibrate", *common, "--folds", 2, "--json").stdout)
    params = found["parameters"]
    assert params["t_mp"] / 0.4 == pytest.approx(1.0 / params["ttc_alarm"])
    assert {*found["folds"][0]} == {"threshold"}


def test_there_is_no_c_version(dlgmd):
    result = dlgmd("export", "--set", 9, "--param", "alarm=either")
    assert result.exit_code == 2
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error")]
    assert (
        line
        == "Error: there is no C version of the rule either. Choose spikes or ttc or expansion."
    )


def test_processes_import_it_where_they_get_its_parameters(monkeypatch):
    params = load_set(9, alarm="either")
    recorded = recorded_parameters({"model": "own:Model", **params.to_dict()})
    pickled = pickle.dumps((params, recorded))
    monkeypatch.delitem(RULES, "either")
    assert pickle.loads(pickled) == (params, recorded)
    assert rule_of(params).name == "either"
    (_, text), *_ = results_of(text_of, [params], 2)
    assert text == rule_of(params).text


def text_of(params):
    return rule_of(params).text


def test_unknown_rules_are_refused(dlgmd, tmp_path):
    with pytest.raises(
        ParameterError, match=r"'eithr' is not one of spikes, expansion, corridor, ttc"
    ):
        load_set(9, alarm="eithr")
    with pytest.raises(ParameterError, match=r"there is no rule 'eithr'\. Did you mean 'either'"):
        rule_named("eithr")
    with pytest.raises(ParameterError, match="is not one of"):
        recorded_parameters({"model": "own:Model", **changed(load_set(9)).to_dict(), "alarm": 3})
    (tmp_path / "code.yaml").write_text("preset: flight\nalarm: code:Both\n")
    line = "code.yaml: its alarm code:Both is Python code, which no file may start. If you trust"
    assert line in dlgmd("run", "x.mp4", "--config", "code.yaml").stderr
    (tmp_path / "own.yaml").write_text("preset: flight\nalarm: foo\n")
    make_result(np.arange(9.0)).save(tmp_path / "r")
    record = tmp_path / "r/run.yaml"
    record.write_text(record.read_text().replace("alarm: spikes\n", "alarm: foo\n"))
    for command in (
        ("run", "x.mp4", "--config", "own.yaml"),
        ("run", "x.mp4", "--alarm", "foo"),
        ("run", "x.mp4", "--param", "alarm=foo"),
        ("run", "x.mp4", "--config", "r/run.yaml"),
        ("live", "0", "--config", "own.yaml"),
        ("export", "--config", "r/run.yaml"),
        ("plot", "mp", "r"),
        ("view", "r", "--no-film"),
    ):
        result = dlgmd(*command)
        (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error")]
        assert result.exit_code in (1, 2) and "foo" in line and "spikes" in line, result.stderr


@pytest.mark.usefixtures("here")
def test_stored_results_of_an_unknown_rule_are_not_scored(dlgmd, runs, footage, tmp_path):
    runs("batch", footage / "a.avi", "--set", 9, "--out", "b")
    record = tmp_path / "b/a/run.yaml"
    record.write_text(record.read_text().replace("alarm: spikes\n", "alarm: foo\n"))
    labels = tmp_path / "labels.csv"
    labels.write_text(f"video,collision_frame\n{footage / 'a.avi'},39\n")
    result = dlgmd("evaluate", labels, "--results", "b")
    assert result.exit_code == 1
    assert "alarm = 'foo' is not one of spikes, expansion, corridor, ttc" in result.stderr


LASTING = documents.code_of("docs/own-models.md", "lasting.py")
MINE = f"""{LASTING}

class Both(dlgmd_cli.Rule):
    quantity = "MP and expansion over their thresholds"

    def value(self, row):
        rate = row.expansion / self.params.expansion_alarm
        return min(row.level / self.params.t_mp, rate)


class NoValue(dlgmd_cli.Rule):
    pass


class NoKey(Both):
    key = "none"


class Text(dlgmd_cli.Rule):
    def value(self, row):
        return "much"


class Infinite(dlgmd_cli.Rule):
    def value(self, row):
        return float("inf")


class Undefined(dlgmd_cli.Rule):
    def value(self, row):
        return float("nan")


class Fails(dlgmd_cli.Rule):
    key = "expansion_alarm"

    def value(self, row):
        return 1 / (row.frame - 3)


class NoReset(Fails):
    def reset(self):
        self.rows.clear()
"""


@pytest.fixture
def mine(here, tmp_path, monkeypatch):
    """The rules above, in the working folder; forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "mine:Both"
    sys.modules.pop("mine", None)
    for name in [name for name in RULES if name.startswith("mine:")]:
        del RULES[name]


@pytest.fixture(scope="module")
def planes(tmp_path_factory):
    """Two planes that come closer, one sooner, and labels."""
    folder = tmp_path_factory.mktemp("planes")
    for name, contact_s in (("c", 2.7), ("d", 2.9)):
        frames = looming.approach(60, 25.0, contact_s, (240, 136))
        write_video(folder / f"{name}.avi", frames)
    (folder / "labels.csv").write_text("video,collision_frame\nc.avi,59\nd.avi,59\n")
    return folder


def lasting(rates, times_s):
    """The signal of the page's rule: what 60 % of the rates of the last second reach."""
    known, times_s = np.nan_to_num(rates), np.asarray(times_s)
    return [
        np.quantile(known[(times_s <= t) & (t - times_s <= 1.0)], 0.4) if t >= 0.9 else np.nan
        for t in times_s
    ]


def test_a_rule_with_a_memory_raises_the_same_alarms_in_every_command(mine, runs, planes):
    mine, video, labels = "mine:Lasting", planes / "c.avi", planes / "labels.csv"
    by_rule = ("--alarm", mine, "--format=none")
    runs("run", video, *by_rule, "--out", "run")
    own = dlgmd_cli.read_result("run/c")
    expected = own.signal >= own.params.expansion_alarm
    (onset,) = own.alarm_onsets.tolist()
    assert own.alarms.tolist() == expected.tolist() and 30 < onset < 59
    again = dlgmd_cli.run(video, alarm=sys.modules["mine"].Lasting, threshold=0.6)
    np.testing.assert_allclose(again.signal, lasting(again.expansion, again.time_s))
    np.testing.assert_allclose(again.signal, own.signal, rtol=1e-6)
    assert again.alarms.tolist() == (again.signal >= 0.6).tolist() != own.alarms.tolist()
    runs("batch", planes, *by_rule, "--out", "batch")
    assert dlgmd_cli.read_result("batch/c").alarms.tolist() == own.alarms.tolist()
    runs("compare", video, *by_rule, "--set", "flight", "--model", "lgmd", "--out", "compare")
    for one in read_comparison("compare/c").values():
        assert one.alarms.tolist() == own.alarms.tolist()
    runs("evaluate", labels, *by_rule, "--no-baselines", "--out", "ev")
    runs("evaluate", labels, "--results", "batch", "--no-baselines", "--format=none", "--out", "st")
    for folder in ("ev", "st"):
        rows = [row for row in csv_rows(f"{folder}/alarms.csv") if row["at"] == "default"]
        assert {row["rule"] for row in rows} == {mine}
        assert [int(row["frame"]) for row in rows if row["video"] == "c.avi"] == [onset]
    facts = json.loads(runs("calibrate", labels, "--alarm", mine, "--folds", 2, "--json").stdout)
    assert 0.0 < facts["parameters"]["expansion_alarm"] != own.params.expansion_alarm
    found = dlgmd_cli.layers(video, alarm=mine, film="film.mp4")
    assert found.result.alarms.tolist() == own.alarms.tolist()
    runs("layers", video, "--param", f"alarm={mine}", "--out", "layers")
    assert yaml_of("layers/c/layers.yaml")["frames"][0] == onset
    runs("plot", "overview", "run/c", "--out", "f.png")
    runs("view", "run/c", "--no-film", "--out", "page.html")


def test_processes_have_the_rule_of_the_working_folder(planes, tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    command = [sys.executable, "-m", "dlgmd_cli", "batch", str(planes), "--alarm", "mine:Lasting"]
    options = ["--format", "none", "--jobs", "2"]
    environment = {**os.environ, "PYTHONPATH": str(Path(dlgmd_cli.__file__).parents[1])}
    subprocess.run([*command, *options], cwd=tmp_path, env=environment, check=True)
    for row in csv_rows(tmp_path / "dlgmd-out/summary.csv"):
        assert row["status"] == "done" and int(row["alarms"]) == 1


def test_an_alarm_frame_by_frame_has_the_memory_and_forgets_it_at_a_gap(mine, planes):
    frames = looming.approach(60, 25.0, 2.7, (240, 136))
    alarm = Alarm(alarm="mine:Lasting", times="capture")
    whole = [alarm.step(image, t / 25.0) for t, image in enumerate(frames)]
    rates = [row.expansion for row in whole]
    np.testing.assert_allclose([row.signal for row in whole], lasting(rates, np.arange(60) / 25.0))
    alarm.reset()
    cut = [alarm.step(image, t / 25.0 + 9.0 * (t >= 30)) for t, image in enumerate(frames)]
    assert cut[30].gap and not np.isnan(cut[29].signal)
    assert np.isnan([row.signal for row in cut[30:53]]).all() and cut[59].signal > 0.0


def test_what_a_built_in_rule_warns_of_holds_for_a_rule_of_ones_own(mine, dlgmd, planes):
    """Frames come too slowly, or are too small, to measure the expansion."""
    for name in ("expansion", mine):
        alone = ("--alarm", name, "--format=none", "--overwrite")
        for command in (
            ("run", planes / "c.avi", "--fps", 5, *alone),
            ("batch", planes, "--fps", 5, *alone, "--out", "b"),
            ("compare", planes / "c.avi", "--fps", 5, "--set", "flight", *alone),
            ("evaluate", planes / "labels.csv", "--fps", 5, *alone, "--out", "e"),
        ):
            result = dlgmd(*command)
            told = result.stderr + str(result.stdout)
            if command[0] == "batch":
                told = yaml_of("b/c/run.yaml")["warnings"][0]
            assert "expansion rates are unreliable" in told, (name, command[0])
        beside = ("run", planes / "c.avi", "--crop", "40x30+0+0", *alone)
        assert "there is no expansion" in dlgmd(*beside).stderr


def test_a_threshold_is_an_argument_wherever_it_is_an_option(mine, planes):
    video = planes / "c.avi"
    evaluation = dlgmd_cli.evaluate(planes / "labels.csv", threshold=0.9, baselines=False)
    for found in (
        dlgmd_cli.run(video, threshold=0.9).params,
        dlgmd_cli.compare(video, ["flight"], threshold=0.9).results["flight"].params,
        dlgmd_cli.layers(video, threshold=0.9, frames=[20]).result.params,
        dlgmd_cli.batch(planes, threshold=0.9, out="b").job.request.setup.params,
        next(iter(evaluation.candidates.by_label.values())).params,
    ):
        assert found.expansion_alarm == 0.9
    assert dlgmd_cli.run(video, 9, threshold=0.5).params.t_mp == 0.5
    how = {"brake": "px4"}
    slow, fast = (dlgmd_cli.run(video, speed_m_s=v, **how).params for v in (2.0, 3.0))
    assert 0.47 > slow.expansion_alarm > fast.expansion_alarm
    with pytest.warns(dlgmd_cli.DlgmdWarning, match="do not brake by the alarm above 3 m/s"):
        dlgmd_cli.run(video, speed_m_s=5.0)
    for options, why in (
        ({"threshold": -1}, "threshold: expansion_alarm = -1"),
        ({"threshold": 1, "speed_m_s": 2}, "speed_m_s and threshold exclude each other"),
        ({"speed_m_s": 2, "model": 9}, "speed_m_s works only with the rules expansion, corridor"),
        ({"threshold": 1, "alarm": mine}, "the rule mine:Both has no threshold"),
    ):
        with pytest.raises(ParameterError, match=why):
            dlgmd_cli.run(video, **options)
    for options in ({"alarm": mine}, {"param": {"alarm": mine}}, {"threshold": 0.5}):
        with pytest.raises(ParameterError, match="alarms of a sweep are those of the rule spikes"):
            dlgmd_cli.sweep(video, x="kappa=1,2", y="n_sp=1,2", **options)


def test_stored_results_of_ones_own_rule_start_no_code(mine, dlgmd, runs, footage):
    runs("run", footage / "a.avi", "--set", 9, "--alarm", mine, "--out", "out", "--format=none")
    runs("batch", footage, "--set", 9, "--alarm", mine, "--out", "ba", "--format=none")
    alarms = dlgmd_cli.read_result("out/a").alarms
    del RULES[mine], sys.modules["mine"]
    again = dlgmd_cli.read_result("out/a")
    assert again.alarms.tolist() == alarms.tolist() and "mine" not in sys.modules
    assert again.until(20).summary["rule"] == mine
    labels = (footage / "labels.csv", "--results", "ba", "--no-baselines", "--format=none")
    table = runs("evaluate", *labels, "--out", "ev").stdout
    assert mine in table and "best threshold" not in table  # alarms are stored, no strengths
    runs("plot", "overview", "out/a", "--out", "f.png")
    done = runs("view", "out/a", "--out", "page.html", "--collisions", footage / "labels.csv")
    assert "no film" not in done.stderr and "mine" not in sys.modules
    refused = dlgmd("run", footage / "a.avi", "--config", "out/a/run.yaml", "--out", "x")
    assert refused.exit_code != 0 and "is Python code" in refused.stderr
    assert "mine" not in sys.modules
    runs("run", footage / "a.avi", "--config", "out/a/run.yaml", "--alarm", mine, "--out", "x")
    assert dlgmd_cli.read_result("x/a").alarms.tolist() == alarms.tolist()


def test_what_is_no_rule_is_refused_in_a_line(mine, dlgmd, footage):
    for name, why in (
        ("pathlib:Path", "is not a subclass of dlgmd_cli.Rule"),
        ("mine:Nothing", "the rule mine:Nothing cannot be imported"),
        ("other:Both", "the rule other:Both cannot be imported"),
    ):
        result = dlgmd("run", footage / "a.avi", "--alarm", name)
        assert result.exit_code == 2 and why in result.stderr
    for name, why in (
        ("NoValue", "value(), frame 0: the rule fails with NotImplementedError"),
        ("NoKey", "__init__(): the rule fails with AttributeError"),
        ("Text", "value(), frame 0: it returns str, not a number"),
        ("Infinite", "value(), frame 0: it returns infinity"),
        ("Fails", "value(), frame 3: the rule fails with ZeroDivisionError: "),
        ("NoReset", "reset(): the rule fails with AttributeError"),
    ):
        video, labels = footage / "a.avi", footage / "labels.csv"
        commands = [("run", video), ("evaluate", labels)]
        if name == "Fails":
            commands += [(one, video) for one in ("batch", "compare", "layers")]
            commands.append(("calibrate", labels))
        for command in commands:
            rule = ("--alarm", f"mine:{name}")
            if command[0] == "layers":
                rule = ("--param", f"alarm=mine:{name}")
            result = dlgmd(*command, *rule, "--set", 9, "--out", f"{name}-{command[0]}")
            assert result.exit_code == 1 and f"mine:{name}, {why}" in result.stderr, command
            assert "internal" not in result.stderr
    result = dlgmd("run", footage / "a.avi", "--set", 9, "--alarm", "mine:Undefined")
    assert "mine:Undefined, value(): it returns NaN in all frames" in result.stderr
    result = dlgmd("calibrate", footage / "labels.csv", "--set", 9, "--alarm", mine)
    assert result.exit_code != 0 and "has no parameter to calibrate" in result.stderr


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ("run {} --threshold 0.4", "expansion: expansion of 0.4/s or more"),
        ("run {} --alarm ttc --threshold 0.9", "ttc: time to contact of 0.9 s or less"),
        ("run {} --set 9 --threshold 0.6", "spikes: 2 in a row, at a normalised MP of 0.6 or more"),
        ("run {} --speed-m-s 3", "expansion: expansion of 0.47/s or more"),
        ("batch {} --speed-m-s 3 --brake 1s --jobs 1", "expansion: expansion of 0.4/s or more"),
        ("live {} --threshold 0.4 --realtime --record o", "expansion: expansion of 0.4/s or more"),
    ],
)
def test_a_threshold_is_that_of_the_rule_that_holds(runs, here, clips, tmp_path, line, rule):
    runs(*line.format(clips / "loom.avi").split())
    (record,) = tmp_path.rglob("run.yaml")
    assert dlgmd_cli.read_result(record.parent).rule.text == rule
