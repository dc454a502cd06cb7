"""Every parameter's type and range, presets, users' YAML, and which of them wins."""

import dataclasses
import datetime
import decimal
import fractions
import math
import os
import pickle

import numpy as np
import pytest
import yaml
from reference import slow

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.facts import SCHEMA
from dlgmd_cli.parameters.presets import (
    FORMULATIONS,
    MODELS,
    PRESETS,
    PUBLISHED,
    Config,
    DlgmdParameters,
    config_of,
    load_config,
    load_model_preset,
    load_preset,
    load_set,
    parameters_of,
    parse_overrides,
    preset_names,
    presets_dir,
)

KEYS = list(DlgmdParameters.specs())


def complaint(**values):
    """The line that says why these values are refused."""
    with pytest.raises(ParameterError) as caught:
        DlgmdParameters(**values)
    return str(caught.value)


@pytest.mark.parametrize("name", slow.FORMULATIONS)
def test_a_formulation_stands_for_latency_saturation_and_grouping(name):
    params = DlgmdParameters(formulation=name)
    assert (params.latency, params.saturate, params.grouping) == slow.NAMED[name]
    # A record of before had the name alone.
    implied = ("latency", "saturate", "grouping")
    old = {key: v for key, v in params.to_dict().items() if key not in implied}
    assert DlgmdParameters.from_mapping(old) == params
    # A name given later replaces them; a key that is given with it takes precedence.
    full = Config("", values=load_set(9, latency="nearest", saturate=False).to_dict())
    assert parameters_of(full, {"formulation": name}) == params.__class__(
        formulation=name, kappa=load_set(9).kappa
    )
    both = parameters_of(full, {"formulation": name, "latency": "nearest"})
    assert (both.latency, both.saturate, both.grouping) == ("nearest", *slow.NAMED[name][1:])


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"r": 4.0}, "r = 4.0 is not a whole number"),
        ({"sigma_i": math.nan}, "not a finite number"),
        ({"a": np.float32(np.nan)}, "not a finite number"),
        ({"a": "1.5"}, "a = '1.5' is not a number"),
        ({"a": np.True_}, "a = True is not a number"),
        ({"a": [1.5]}, "a = a list or mapping is not a number"),
        ({"a": datetime.date(2023, 1, 2)}, "a = 2023-01-02 is not a number"),
        ({"a": "x\ny" + "z" * 99}, f"a = 'x\\ny{'z' * 37}' is not a number"),
        ({"ffi_gd": "yes"}, "ffi_gd = 'yes' is not true or false"),
        ({"formulation": "Default"}, "is not one of default, released-2021, released-2020, equat"),
        # exp(-λ²·2r²) is 0 in float64 here: the latency is endless.
        ({"beta": 0.0, "lam": 10.0, "r": 32}, "make the latency longer than 64 frames"),
    ],
)
def test_wrong_values(values, why):
    assert why in complaint(**values)


@pytest.mark.parametrize("kind", MODELS.values(), ids=lambda one: one.model)
def test_bounds(kind):
    for key, spec in kind.specs().items():
        if spec.kind in (bool, str):
            continue
        step = 1 if spec.kind is int else 1e-3 * max(abs(spec.low), abs(spec.high))
        for value, why in (
            (spec.low - step, "not (above|at least)"),
            (spec.high + step, "more than"),
        ):
            with pytest.raises(ParameterError, match=f"^{key} = .* is {why}"):
                kind(**{key: value})
        assert spec.check(spec.low) == spec.low and spec.check(spec.high) == spec.high, key
        assert type(spec.check(spec.high)) is spec.kind, key


def test_latency_is_between_0_and_64_frames():
    assert DlgmdParameters(alpha=-1.0, beta=0.0, lam=0.0).alpha == -1.0
    assert "makes the latency negative" in complaint(alpha=-1.0 - 1e-9, beta=0.0, lam=0.0)
    assert DlgmdParameters(alpha=63.0, beta=0.0, lam=0.0).alpha == 63.0
    assert "longer than 64 frames" in complaint(alpha=63.0 + 1e-9, beta=0.0, lam=0.0)
    # It is the corner of the kernel that counts: 1/exp(-λ²·2r²).
    lam = math.sqrt(math.log(60.0) / (2 * 4**2))
    assert DlgmdParameters(alpha=3.9, beta=0.0, lam=lam, r=4).lam == lam
    assert "longer than 64 frames" in complaint(alpha=4.1, beta=0.0, lam=lam, r=4)


@pytest.mark.parametrize(
    "value",
    [
        *(None, [], {"r": 1}, (1, 2), {1}, "", "1", b"1", ..., 1j, decimal.Decimal(1)),
        *(10**400, -(10**400), 10**5000, np.array([1.0, 2.0])),
    ],
    ids=lambda value: type(value).__name__,
)
def test_other_types_and_huge_numbers_are_refused_briefly(value):
    as_the_formulation = {"latency", "saturate", "grouping"} if value is None else set()
    for key in set(KEYS) - as_the_formulation:
        line = complaint(**{key: value})
        assert line.startswith(f"{key} = ") and len(line) < 150 and "\n" not in line


@pytest.mark.parametrize(
    ("key", "value", "kept"),
    [
        ("a", np.float32(1.25), 1.25),
        ("a", np.int16(2), 2.0),
        ("a", 2, 2.0),
        ("a", fractions.Fraction(5, 4), 1.25),
        ("n_sp", np.uint8(3), 3),
        ("formulation", np.str_("released-2020"), "released-2020"),
    ],
)
def test_numpy_scalars_become_plain_values(key, value, kept):
    actual = getattr(DlgmdParameters(**{key: value}), key)
    assert actual == kept and type(actual) is type(kept)


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("sigma_I", "Did you mean 'sigma_i'? "),
        ("lambda", "Did you mean 'lam'? "),
        ("ffi", "Did you mean 'ffi_gd'? "),
        ("x\n" * 10_000, ""),
        (None, ""),
    ],
)
def test_unknown_keys_come_with_a_suggestion(key, hint):
    with pytest.raises(ParameterError) as caught:
        DlgmdParameters.from_mapping({"r": 4, key: 1})
    line = str(caught.value)
    assert line.startswith(f"unknown parameter {str(key)[:100]!r}. {hint}See 'dlgmd sets show 9'.")
    assert len(line) < 300 and "\n" not in line


def test_parameters_are_frozen_and_checked_again_when_changed():
    params = DlgmdParameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.r = 3
    assert hash(params) == hash(DlgmdParameters())
    assert dataclasses.replace(params, r=3) == DlgmdParameters(r=3) != params
    with pytest.raises(ParameterError):
        dataclasses.replace(params, r=-3)
    assert pickle.loads(pickle.dumps(params)) == params
    error = ParameterError("my.yaml", "r = 0 is not at least 1", "Raise it.")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (ParameterError, str(error))


def test_allowed_values_in_words():
    allowed = {key: spec.allowed for key, spec in DlgmdParameters.specs().items()}
    assert (allowed["sigma_e"], allowed["n_sp"]) == ("0.01 to 100", "1 to 1000")
    assert (allowed["ffi_gd"], allowed["formulation"]) == (
        "true, false",
        ", ".join(FORMULATIONS),
    )


# Presets and files


@pytest.mark.parametrize("number", sorted(slow.TABLE_2))
def test_sets_are_table_two(number):
    p = load_set(number)
    expected = slow.table_2(number) | {"k": 1.0, "m": 0.4, "t_mp": 0.4, "n_sp": 2}
    assert {key: getattr(p, key) for key in expected} == expected
    assert p == load_set(f"set{number}") and load_set(number, r=3).r == 3


def test_every_config_loads_and_islisted():
    assert preset_names() == [str(n) for n in range(1, 10)]
    others = [name for name in MODELS if name != "dlgmd" and name not in PUBLISHED]
    stems = [*(f"set{name}" for name in preset_names()), *others, *PRESETS]
    assert sorted(path.stem for path in presets_dir().glob("*.yaml")) == sorted(stems)
    assert load_set(9) == DlgmdParameters()
    for model in others:
        config, kind = load_model_preset(model), MODELS[model]
        assert config.model == model == kind.model
        assert parameters_of(config) == kind()


@pytest.mark.parametrize("name", ["flight", "flight-small"])
def test_the_presets_alarm_by_the_expansion(name):
    """Beside one of the paper's sets, at the width that their files name."""
    params = parameters_of(load_config(name))
    assert (params.model, params.alarm) == ("dlgmd", "expansion")
    # In 1/s and in s.
    assert 0.3 < params.expansion_alarm < 1.0 and 0.3 < params.ttc_alarm < 2.0
    keys = "alarm", "expansion_alarm", "ttc_alarm", "kappa", "n_sp"
    changed = {key: getattr(params, key) for key in keys}
    assert params in [load_set(number, **changed) for number in range(4, 10)]


@pytest.mark.parametrize(
    ("name", "label"),
    [
        *((9, "set9"), ("9", "set9"), ("set3", "set3"), ("dlgmd", "set9"), ("lgmd", "lgmd")),
        *(("flight-small", "flight-small"), (None, "flight")),
    ],
)
def test_every_name_is_a_configuration(name, label):
    config = config_of(name)
    assert config.label == label and parameters_of(config).n_sp


@pytest.fixture
def file(tmp_path):
    return tmp_path / "my.yaml"


def test_precedence(file):
    file.write_bytes(b"\xef\xbb\xbfsigma_e: 2.5\r\nr: 3\r\nkappa: 1e-3\r\n")  # as Windows writes it
    params = parameters_of(load_config(file), parse_overrides(["r=5", "ffi_gd=false"]))
    assert params == DlgmdParameters(sigma_e=2.5, r=5, kappa=0.001, ffi_gd=False)


def test_a_run_record_is_a_config(file):
    document = {
        "input": {"path": "x"},
        "set": 4,
        "model": "dlgmd",
        **load_set(4, r=3).to_dict(),
        "options": {"size": "30x20"},
        "summary": {"mp_max": None},
        "versions": {},
        "warnings": [],
        "complete": False,
        "processed": {},
    }
    file.write_text(yaml.safe_dump(document))
    config = load_config(file)
    assert parameters_of(config) == load_set(4, r=3)
    assert (config.model, config.options) == ("dlgmd", {"size": "30x20"})


def test_a_file_may_build_on_a_set(file):
    file.write_text("r: 3\nset: 4\n")
    assert parameters_of(load_config(file)) == load_set(4, r=3)
    file.write_text("set: [4]\n")
    with pytest.raises(ParameterError, match=r"my\.yaml: there is no set a list"):
        load_config(file)


def test_a_file_may_build_on_the_preset_and_say_what_it_is_made_for(file):
    file.write_text("preset: flight\nt_mp: 0.5\n")
    flight, own = load_config("flight"), load_config(file)
    assert parameters_of(own) == parameters_of(flight, {"t_mp": 0.5})
    assert (own.model, own.width_px, own.model_fps) == (flight.model, 240, 30.0)
    file.write_text("width_px: 320\nmodel_fps: 25\nr: 3\n")
    own = load_config(file)
    assert (own.values, own.width_px, own.model_fps) == ({"r": 3}, 320, 25.0)
    # A record holds all values itself, whatever has become of its preset.
    file.write_text(f"schema: {SCHEMA}\npreset: gone\nmodel: lgmd\nw_i: 0.5\n")
    assert parameters_of(load_config(file)) == MODELS["lgmd"](w_i=0.5)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("# only a comment", "is empty"),
        ("[1, 2]", "contains a list"),
        ("just words", "contains plain text"),
        ("sigma_x: 1", "unknown parameter 'sigma_x'. Did you mean 'sigma_e'?"),
        ("sigma_e: .nan", "sigma_e = nan is not a finite number"),
        ("sigma_e: 1\nsigma_e: 2", "key 'sigma_e' appears twice in line 2"),
        ("sigma_e: [1", "is not valid YAML in line"),
        ("sigma_e: !!python/object/apply:os.system [exit]", "could not determine a constructor"),
        ("model: 3", "model = 3 is not a name"),
        ('model: ""', "model has no value. Give it one, or delete the line"),
        *((f"{key}: NULL", f"{key} has no value") for key in ("width_px", "latency", "set", "r")),
        ("options: 3", "options is not a mapping"),
        ("preset: fly", "there is no preset 'fly'. Choose from flight, flight-small"),
        ("preset: flight\nset: 3", "set and preset exclude each other"),
        ("width_px: 0", "width_px = 0 is not at least 1"),
        ("model_fps: fast", "model_fps = 'fast' is not a number"),
        ("set: 12", "there is no set 12. Choose 1 to 9"),
        (f"r: {'9' * 5000}", "is not valid YAML."),
        (f"r: 0x{'f' * 5000}", "r = a huge number is not a finite number."),
        (f"? 0x{'f' * 5000}\n: 1", "unknown parameter 'a huge number'."),
        ('"\\e]0;x\\a\\u202e": 1', r"unknown parameter '\x1b]0;x\x07\u202e'."),
        ("r: 3\n---\nr: 4", "is not valid YAML in line 2."),
        ("{[1]: 2}", "found unhashable key in line 1."),
    ],
)
def test_bad_yaml_is_one_line(file, text, why):
    file.write_text(text)
    with pytest.raises(ParameterError) as caught:
        parameters_of(load_config(file))
    message = str(caught.value)
    assert why in message and str(file) in message
    assert message.isprintable() and len(message) < len(str(file)) + 300


def test_unreadable_files(tmp_path, file):
    with pytest.raises(ParameterError, match="there is no such file"):
        load_config(tmp_path / "none.yaml")
    os.mkfifo(tmp_path / "pipe")  # which is not waited for
    for path in (tmp_path, tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(ParameterError, match="is not a file"):
            load_config(path)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterError, match="not UTF-8"):
        load_config(file)


@pytest.mark.parametrize("pair", ["r", "=3", "r=[1", "r=", "r=abc", "r=.nan", "q=1"])
def test_bad_overrides_blame_the_option(pair):
    with pytest.raises(ParameterError, match=r"^param: "):
        parameters_of(load_preset(9), parse_overrides([pair]))


def test_blame_falls_on_the_file_or_the_override(file):
    file.write_text("alpha: -3\n")
    with pytest.raises(ParameterError, match=r"my\.yaml: alpha = -3"):
        parameters_of(load_config(file))
    # Mended together, they are valid.
    assert parameters_of(load_config(file), {"alpha": 0.0}).alpha == 0.0
    with pytest.raises(ParameterError, match=r"^param: "):
        parameters_of(load_preset(9), {"alpha": -3.0})
