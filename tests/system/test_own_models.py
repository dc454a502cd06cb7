"""Models of one's own: on the commands that take `--model`, in Python, and read back."""

import copy
import pickle
import sys
from dataclasses import FrozenInstanceError, dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video

import dlgmd_cli
from dlgmd_cli.errors import ModelError, ParameterError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.parameters import presets as parameters
from dlgmd_cli.parameters.keys import OWN_MODELS
from dlgmd_cli.plots.sweeps import axis_name
from dlgmd_cli.results.grid import Axis

MINE = """
import dlgmd_cli

class FastParameters(dlgmd_cli.Parameters):
    floor: float = dlgmd_cli.key(0.05, low=0, high=1, meaning="change that counts")

class Fast(dlgmd_cli.Model):
    params_class = FastParameters

    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        if self.receptors.frame < self.first_valid_frame:
            return dlgmd_cli.Response()
        p = self.receptors.p(0) * self.receptors.unit
        active = p > self.params.floor
        return dlgmd_cli.Response(p.sum(), p[active].sum(), mp=active.sum())

class Answers(dlgmd_cli.Model):
    params_class = FastParameters
    first_valid_frame = 2

    def respond(self):
        p = self.receptors.layer()
        active = (p > self.params.floor).astype("float32")
        return p, p * active, active, {"ffi": self.n_cells}

class Variant(dlgmd_cli.DLGMD):
    pass

class Raises(dlgmd_cli.Model):
    def step(self, luminance, time_s=None, *, layers=False):
        return [][luminance.ndim]

class Returns(dlgmd_cli.Model):
    def step(self, luminance, time_s=None):
        return 3.0

class Adapting(dlgmd_cli.Model):
    def reset(self):
        super().reset()
        self.slow = None

    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        if self.receptors.frame < self.first_valid_frame:
            return dlgmd_cli.Response()
        p = self.receptors.p(0) * self.receptors.unit
        self.slow = p if self.slow is None else 0.9 * self.slow + 0.1 * p
        g = abs(p - self.slow).astype("float32")
        shown = dlgmd_cli.Layers(p, p, g) if layers else None
        return dlgmd_cli.Response(p.sum(), p.sum(), mp=g.sum(), layers=shown)

class Bare(dlgmd_cli.Model):
    def step(self, luminance, time_s=None, *, layers=False):
        return dlgmd_cli.Response(mp=1.0)

class Forgetful(dlgmd_cli.Model):
    def reset(self):
        self.slow.clear()

class Unready(dlgmd_cli.Model):
    def __init__(self, params=None):
        self.gain = params.gain
"""
FAST = ("--model", "mymodel:Fast")


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The module `mymodel`, importable here and in worker processes; forgotten afterwards."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "mymodel.py").write_text(MINE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "mymodel", raising=False)
    import mymodel

    yield mymodel
    sys.modules.pop("mymodel", None)


@pytest.fixture
def gone(own, monkeypatch):
    """Call it, and the module cannot be imported any more, as in another process."""

    def remove():
        for model in [name for name in OWN_MODELS if name.startswith("mymodel:")]:
            monkeypatch.delitem(OWN_MODELS, model)
        monkeypatch.setitem(sys.modules, "mymodel", None)

    return remove


def test_a_class_may_answer_with_its_layers_alone(own):
    frames = np.random.default_rng(6).integers(0, 256, (3, 12, 16), np.uint8)
    answers, fast = create_model(own.Answers().params), create_model(own.Fast().params)
    found = [answers.step(frame, layers=True) for frame in frames]
    expected = [fast.step(frame) for frame in frames][-1]
    assert [one.is_valid for one in found] == [False, False, True] and found[1].p_sum > 0
    assert found[2].mp == expected.mp and found[2].ffi == 12 * 16
    assert found[2].s_sum == pytest.approx(expected.s_sum)
    assert found[2].layers.g.sum() == expected.mp


@pytest.mark.parametrize("command", ["run", "layers", "batch", "sweep"])
def test_a_state_may_be_set_in_reset_alone(runs, clips, own, command, tmp_path, here):
    axes = ["--x", "n_sp=1,2", "--y", "t_mp=0.1:0.3:0.1"] if command == "sweep" else []
    film = ["--video", "film.mp4"] if command == "layers" else []
    runs(command, clips / "loom.avi", "--model", "mymodel:Adapting", *axes, *film)
    assert not film or (tmp_path / "film.mp4").stat().st_size > 1000
    assert dlgmd_cli.Alarm(own.Adapting().params).step(np.zeros((9, 9), np.uint8))


def test_pages_have_films_of_models_with_undefined_frames(runs, clips, own, tmp_path):
    named = ["--model", "mymodel:Adapting"]
    runs("run", clips / "loom.avi", *named)
    made = runs("view", "dlgmd-out/loom", *named, "--out", "page.html")
    assert "layers" not in made.stderr, made.stderr
    assert b"<video" in (tmp_path / "page.html").read_bytes()


def test_reads_back_with_and_without_the_module(dlgmd, runs, clips, own, gone, tmp_path):
    runs("run", clips / "loom.avi", *FAST, "--param", "kappa=0.3")
    folder = tmp_path / "dlgmd-out/loom"
    before = dlgmd_cli.read_result(folder)
    assert before.params == own.FastParameters(kappa=0.3)
    gone()
    after = dlgmd_cli.read_result(folder)
    assert after.params.to_dict() == before.params.to_dict()
    assert after.params.model == "mymodel:Fast"
    # Evaluating compares them, and worker processes get them.
    assert after.params == dlgmd_cli.read_result(folder).params != before.params
    assert pickle.loads(pickle.dumps(after.params)) == copy.deepcopy(after.params) == after.params
    np.testing.assert_array_equal(after.mp_abs, before.mp_abs)
    np.testing.assert_array_equal(after.spikes, before.spikes)
    runs("plot", "overview", folder, "--out", "overview.png")
    assert (tmp_path / "overview.png").exists()
    with pytest.raises(ParameterError, match="mymodel:Fast is Python code"):
        create_model(after.params)
    again = ["run", clips / "loom.avi", "--config", folder / "run.yaml", "--out", "again"]
    refused, unknown = dlgmd(*again), dlgmd(*again, *FAST)
    assert refused.exit_code == 2 and "run.yaml: its model mymodel:Fast is" in refused.stderr
    assert unknown.exit_code == 2 and "mymodel:Fast cannot be imported" in unknown.stderr


def test_a_record_without_a_threshold_is_damaged(runs, clips, own, gone, tmp_path):
    runs("run", clips / "loom.avi", *FAST)
    record = tmp_path / "dlgmd-out/loom/run.yaml"
    record.write_text(record.read_text().replace("t_mp: 0.4", "t_mp: high"))
    gone()
    with pytest.raises(dlgmd_cli.DlgmdError, match="states no t_mp"):
        dlgmd_cli.read_result(record.parent)


def test_a_batch_computes_again_where_the_model_s_file_changed(runs, clips, own, here):
    write_video("videos/a.avi", looming_frames())
    batch = ("batch", "videos", *FAST, "--jobs", 1, "--out", "b")
    file = Path(own.__file__)
    assert "(1 before)" not in runs(*batch).stdout and "(1 before)" in runs(*batch).stdout
    file.write_text(MINE.replace("mp=active.sum()", "mp=2 * active.sum()"))
    assert "(1 before)" not in runs(*batch).stdout and "(1 before)" in runs(*batch).stdout


def test_a_sweep_without_input_says_why_there_is_no_attenuation(dlgmd, own):
    axes = ("--x", "t_mp=0.3,0.4", "--y", "n_sp=1,2")
    few = ("--speed", 4, "--size", "64x48", "--cube-size", 10)
    result = dlgmd("sweep", *axes, "--model", "mymodel:Bare", *few, "--jobs", 1)
    assert result.exit_code == 0
    assert "no attenuation, since the model returns no sums of P and S; with INPUT" in result.stderr
    again = dlgmd("sweep", *axes, *FAST, *few, "--jobs", 1, "--out", "fast")
    assert again.exit_code == 0 and "no attenuation" not in again.stderr


@pytest.fixture(autouse=True)
def videos(tmp_path):
    (tmp_path / "videos").mkdir()


def test_is_evaluated_and_calibrated(runs, own, tmp_path, here):
    for name in "ab":
        write_video(tmp_path / f"videos/{name}.avi", looming_frames())
    labels = tmp_path / "videos/labels.csv"
    labels.write_text("video,collision_frame\na.avi,19\nb.avi,19\n")
    common = [*FAST, "--jobs", 2]
    runs("evaluate", labels, *common, "--set", 9, "--no-baselines", "--out", "ev")
    text = (tmp_path / "ev/evaluate.csv").read_text()
    assert "\nFast,default," in text and "\nset9,default," in text
    runs("calibrate", labels, *FAST, "--jobs", 1, "--folds", 2, "--out", "cal")
    config = parameters.load_config(tmp_path / "cal/calibrated.yaml")
    assert isinstance(parameters.parameters_of(config), own.FastParameters)


def test_in_python_the_class_or_its_parameters(clips, own):
    video = clips / "loom.avi"
    by_class, nine = dlgmd_cli.run(video, model=[own.Fast, 9])
    assert nine.record["set"] == 9 and by_class.record["model"] == "mymodel:Fast"
    for model in (own.FastParameters(), "mymodel:Fast", own.Fast):
        np.testing.assert_array_equal(dlgmd_cli.run(video, model=model).mp, by_class.mp)
    found = dlgmd_cli.run(video, model=own.FastParameters(floor=0.2), param={"n_sp": 4})
    assert found.params == own.FastParameters(floor=0.2, n_sp=4)
    alarm = dlgmd_cli.Alarm(own.FastParameters())
    assert alarm.step(np.zeros((9, 9), np.uint8)).alarm is False
    with pytest.raises(ParameterError, match="not a subclass"):
        dlgmd_cli.run(video, model=dict)


def test_single_parameters_are_for_all_models(clips):
    many = dlgmd_cli.run(clips / "loom.avi", [9, "set3"], param={"r": 3}, formulation="equations")
    assert [one.params.r for one in many] == [3, 3]
    assert {one.params.formulation for one in many} == {"equations"}


def test_a_mask_and_the_number_of_cells_need_no_code(dlgmd, own):
    hidden = np.zeros((24, 32), np.bool_)
    hidden[:20] = True
    model = create_model(own.FastParameters())
    model.ignore(hidden)
    for frame in looming_frames():
        response = model.step(frame)
    assert model.n_cells == 4 * 32 and response.mp <= 4 * 32


def test_a_model_learns_the_angles_of_the_camera(clips, own, monkeypatch):
    seen = []
    monkeypatch.setattr(own.Fast, "look", lambda self, camera: seen.append(camera))
    dlgmd_cli.run(clips / "loom.avi", model=own.Fast, fov=60)
    dlgmd_cli.Alarm(own.Fast, fov=70, camera_tilt=5)
    assert [(one.fov_deg, one.tilt_deg) for one in seen] == [(60, 0), (70, 5)]


def test_a_class_may_derive_from_ours(dlgmd, runs, clips, own):
    three, kind = parameters.load_set(3), parameters.find_model("mymodel:Variant")
    assert dlgmd_cli.DLGMD.params_class is parameters.MODELS["dlgmd"] is not kind
    assert own.Variant(three).params.to_dict() == three.to_dict()
    result, ours = dlgmd_cli.run(clips / "loom.avi", model=[own.Variant(three).params, 3])
    np.testing.assert_array_equal(result.mp, ours.mp)
    runs("run", clips / "loom.avi", "--model", "mymodel:Variant", "--set", 3)
    refused = dlgmd("run", clips / "loom.avi", *FAST, "--set", 3)
    assert refused.exit_code == 2 and "--set works only with the D-LGMD" in refused.stderr
    refused = dlgmd(
        "run", clips / "loom.avi", "--model", "mymodel:Variant", "--physical", "--overwrite"
    )
    assert refused.exit_code == 2 and "Variant works in pixels, not degrees" in refused.stderr


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [
        ("run V --model nowhere:Fast", 2, "nowhere:Fast cannot be imported (ModuleNotFoundError"),
        ("run V --model mymodel:Slow", 2, "mymodel:Slow cannot be imported (AttributeError"),
        ("run V --model mymodel:", 2, "cannot be imported"),
        ("run V --model os:path", 2, "os:path is not a subclass of dlgmd_cli.Model"),
        ("run V --model dlgmd_cli:Model", 2, "not a subclass"),
        ("run V --model fast", 2, "there is no model 'fast'. Choose from dlgmd, dlgmd-onoff, lgmd"),
        ("run V --model mymodel:Fast --param florr=1", 2, "Did you mean 'floor'?"),
        ("run V --model mymodel:Fast --param floor=2", 2, "floor = 2 is more than 1"),
        ("run V --model mymodel:Raises", 1, "mymodel:Raises, step(), frame 0: the model fails"),
        ("run V --model mymodel:Returns", 1, "frame 0: it returns float, not a Response"),
        ("run V --model mymodel:Forgetful", 1, "the model fails with AttributeError"),
        ("run V --model mymodel:Unready", 1, "the model fails with AttributeError"),
        ("layers V --model mymodel:Fast", 1, "frame 11: it returns no layers"),
        ("export --model mymodel:Fast", 2, "there is no C version of the model mymodel:Fast"),
        ("export --model mymodel:Variant", 2, "there is no C version"),
    ],
)
def test_what_goes_wrong_is_one_line(dlgmd, clips, own, words, code, line):
    result = dlgmd(*(clips / "loom.avi" if word == "V" else word for word in words.split()))
    assert result.exit_code == code and line in result.stderr.splitlines()[-1]


def test_a_failure_in_a_batch_is_a_row(dlgmd, own, tmp_path, here):
    write_video(tmp_path / "videos/a.avi", looming_frames())
    result = dlgmd("batch", "videos", "--model", "mymodel:Raises", "--jobs", 1)
    assert result.exit_code == 1 and "the model fails with IndexError" in result.stderr


def test_the_cause_is_kept(own):
    with pytest.raises(ModelError, match=r"mymodel\.py, line") as caught:
        create_model(own.Raises().params).step(np.zeros((9, 9), np.uint8))
    assert isinstance(caught.value.__cause__, IndexError)


def test_entry_points_are_names(dlgmd, runs, clips, own, monkeypatch):
    found = "dlgmd_cli.parameters.presets.installed_models"
    monkeypatch.setattr(found, lambda: {"quick": "mymodel:Fast"})
    assert parameters.find_model("quick") is own.FastParameters
    result = runs("compare", clips / "loom.avi", "--set", 9, "--model", "quick")
    assert " Fast " in result.stdout
    shown = dlgmd("sets", "show", "mymodel:Fast")
    assert "floor: 0.05            # change that counts; 0 to 1" in shown.stdout


# The parameter class


class Plain(dlgmd_cli.Parameters):
    gain: float = 2
    steps: int = 3
    t_mp: float = 0.5


class Simple(dlgmd_cli.Model):
    params_class = Plain


def test_keys_without_a_range_and_those_of_every_model():
    params = Plain()
    assert params.to_dict() == {
        "gain": 2.0,
        "steps": 3,
        "t_mp": 0.5,
        "n_sp": 2,
        "kappa": 0.01,
        "alarm": "spikes",
        "ttc_alarm": parameters.load_set(9).ttc_alarm,
        "expansion_alarm": parameters.load_set(9).expansion_alarm,
        "corridor_alarm": 0.5,
    }
    assert type(params.gain) is float and Plain(gain=-7).gain == -7.0
    for wrong in ({"steps": 1.5}, {"gain": "much"}, {"t_mp": 2}, {"n_sp": 0}):
        with pytest.raises(ParameterError):
            Plain(**wrong)
    with pytest.raises(FrozenInstanceError):
        params.gain = 1.0
    assert pickle.loads(pickle.dumps(params)) == copy.deepcopy(params) == params


def test_no_unit_and_no_symbol_may_be_empty_texts():
    spec = dlgmd_cli.key(1.0, "κ", "").metadata["spec"]
    assert axis_name(Axis("gain", spec, (1.0, 2.0))) == "κ"
    spec = dlgmd_cli.key(1.0, "", "").metadata["spec"]
    assert axis_name(Axis("gain", spec, (1.0, 2.0))) == "gain"


@pytest.mark.parametrize(
    ("field", "why"),
    [("options: float = 1.0", "a key 'options'"), ("gain: float", "the default of gain")],
)
def test_a_parameter_class_that_cannot_be_used(field, why):
    names = {"dlgmd_cli": dlgmd_cli, "__name__": "cell"}
    code = f"class P(dlgmd_cli.Parameters):\n    {field}\n"
    with pytest.raises((ParameterError, TypeError), match=f"{why}|non-default"):
        exec(f"{code}class M(dlgmd_cli.Model):\n    params_class = P\n", names)


def test_a_parameter_class_must_be_frozen():
    @dataclass
    class Loose(dlgmd_cli.Parameters):
        gain: float = 1.0

    with pytest.raises(ParameterError, match="is not frozen"):
        type("Mine", (dlgmd_cli.Model,), {"params_class": Loose})


def test_a_cell_of_a_notebook_may_run_again():
    code = "class Again(dlgmd_cli.Model):\n    params_class = Kept\n"
    names = {"dlgmd_cli": dlgmd_cli, "__name__": "cell"}
    exec("class Kept(dlgmd_cli.Parameters):\n    gain: float = 1.0\n", names)
    for _ in range(2):
        exec(code, names)
        assert names["Again"].params_class is names["Kept"]
        assert type(create_model(names["Kept"]()).model) is names["Again"]


# Mistakes in a class: its body, and the error's line.
TAKES = """
    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        return dlgmd_cli.Response(mp=1.0{})
"""
IN_STEP = "step(), frame 0: "
MISTAKES = [
    ("DLGMD", "def inhibit(self, p): q = p(1); q *= 0.5; return q", "fails with ValueError"),
    ("Model", "def step(self, luminance, time_s=None): luminance[:] = 0", "with ValueError"),
    ("DLGMD", "def feed_forward(self): return float('nan')", "feed_forward(), frame"),
    ("DLGMD", "def threshold(self, ffi): return 0.0 * float('inf')", "threshold(), frame"),
    ("DLGMD", "def potential(self, g): return float('nan')", "potential(), frame 3"),
    (
        "Model",
        "def step(self, luminance, time_s=None): return dlgmd_cli.Response(mp=1e999)",
        "step(), mp, frame 0: it returns infinity",
    ),
    ("DLGMD", "def group(self, s, t_de): s[:] = 0", "with ValueError"),
    ("DLGMD", "def potential(self, g): g[:] = 0", "with ValueError"),
    ("DLGMD", "polarities = ('up',)", "polarities: ('up',) is no tuple of 'both'"),
    (
        "Model",
        "def step(self, luminance, time_s=None): self.receptors.unit",
        "self.receptors.unit, frame 0: no frame was taken yet",
    ),
    ("DLGMD", "def potential(self, g): return g.sum(axis=0)", "returns ndarray of shape"),
    ("DLGMD", "def potential(self, g): pass", "it returns NoneType, not a number"),
    ("Model", "columns = ('share')", "columns = 'share' is no tuple of names"),
    (
        "Model",
        "columns = ('share',)" + TAKES.format(", more={'shara': 1}"),
        IN_STEP + "its more has 'shara', which is no column. The class's columns are share.",
    ),
    (
        "Model",
        "columns = ('share',)" + TAKES.format(", more={'share': luminance}"),
        "step(), share, frame 0: it returns ndarray of shape",
    ),
    (
        "Model",
        "columns = ('share',)" + TAKES.format(", more={'share': None}"),
        "step(), share, frame 0: it returns NoneType",
    ),
    ("Model", TAKES.format(", p_sum=[1]"), "step(), p_sum, frame 0: it returns list"),
    ("Model", "def step(self, luminance, time_s=None): pass", IN_STEP + "it returns NoneT"),
    ("DLGMD", "def group(self, s, t_de): return s[1:]", "group(), frame 3: it returns"),
]


@pytest.mark.parametrize(("base", "body", "line"), MISTAKES)
def test_a_mistake_is_one_line_with_class_method_and_frame(dlgmd, clips, own, base, body, line):
    code = f"\nclass Wrong(dlgmd_cli.{base}):\n    {body}\n"
    Path(own.__file__).write_text(MINE + code)
    exec(compile(code, own.__file__, "exec"), vars(own))
    for words in (("run", clips / "loom.avi", "--model"), ("sets", "check")):
        result = dlgmd(*words, "mymodel:Wrong")
        last = result.stderr.splitlines()[-1]
        assert result.exit_code == 1 and line in last, last
        assert last.startswith("Error: mymodel:Wrong") and "internal" not in last


def test_a_class_is_checked_for_what_a_run_does_not_see(dlgmd, runs, own):
    assert "mymodel:Fast: no mistake was found" in runs("sets", "check", "mymodel:Fast").stdout
    code = """
class Odd(dlgmd_cli.Model):
    seen = 0
    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        self.seen += 1
        return dlgmd_cli.Response(mp=self.seen - float(self.receptors.current.sum()))
    def rest(self):
        pass
"""
    exec(code, vars(own))
    found = runs("sets", "check", "mymodel:Odd").stdout
    for line in (
        "rest(): it overrides nothing, and nothing calls it; did you mean reset()?",
        "step(): mp is negative in 19 frames, where mp_abs is 0",
        "reset(): the same frames give another answer after it",
        "step(): uint8 and float32 frames differ",
    ):
        assert f"mymodel:Odd: {line}" in found
    exec("class Dead(Fast):\n    def step(self, *_): return dlgmd_cli.Response(mp=0)", vars(own))
    assert "mp is 0 in all frames" in runs("sets", "check", "mymodel:Dead").stdout
    exec("class Taken(Fast): columns = ('mp',)", vars(own))
    taken = dlgmd("sets", "check", "mymodel:Taken")
    assert taken.exit_code == 2 and "the model's column 'mp'" in taken.stderr
    refused = dlgmd("sets", "check", "mymodel:Slow")
    assert refused.exit_code == 2 and "cannot be imported" in refused.stderr


def test_a_negative_potential_is_no_alarm(clips, own):
    """On the fixed scale, κ̂ / (κ̂ + κ) has a pole at −κ."""
    code = """
class Signed(dlgmd_cli.Model):
    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        if self.receptors.frame < 1:
            return dlgmd_cli.Response()
        change = self.receptors.current.astype(float) - self.receptors.previous
        return dlgmd_cli.Response(mp=-abs(change.sum()) / 30)
"""
    exec(code, vars(own))
    result = dlgmd_cli.run(clips / "loom.avi", own.Signed, param={"kappa": 0.01})
    assert np.nanmin(result.mp) < 0 and not result.spikes.any() and not result.alarms.any()
    assert set(result.mp_abs[~np.isnan(result.mp)]) == {0.0}
    levels = absolute(np.array([-np.finfo(float).max, -1e-5, 0.0, 1e-5, 1e300]), 1, 1e-5)
    assert levels.tolist() == [0.0, 0.0, 0.0, 0.5, 1.0]


@pytest.mark.painted
def test_kernels_are_those_of_the_model(runs, tmp_path, monkeypatch):
    (tmp_path / "later.py").write_text(
        "import dlgmd_cli\n"
        "class Later(dlgmd_cli.DLGMD):\n"
        "    def latency(self):\n"
        "        return 1.25 + super().latency()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    later = parameters.find_model("later:Later").model_class
    ours, theirs = (kind().connections for kind in (dlgmd_cli.DLGMD, later))
    np.testing.assert_allclose(theirs.latency, ours.latency + 1.25)
    assert set(theirs.inhibition) == {1, 2} and not np.array_equal(
        theirs.excitation, ours.excitation
    )
    runs("sets", "later:Later", "--plot", "later.png")
    assert cv2.imread("later.png").min() < cv2.imread("later.png").max()
    sys.modules.pop("later")
