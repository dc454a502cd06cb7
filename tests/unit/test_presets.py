"""The paper's sets, users' YAML, and which of them wins."""

from pathlib import Path

import pytest
import yaml

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import (
    MODELS,
    DlgmdParameters,
    load_config,
    load_model_preset,
    load_preset,
    load_set,
    merge,
    parse_overrides,
    preset_names,
    presets_dir,
)

# Table II of the paper: alpha, beta, lambda, sigma_E, sigma_I, r.
TABLE_II = {
    1: (0, 0, 0, 0.35, 1, 4),
    2: (0, 0, 0, 0.35, 1.8, 4),
    3: (0, 0, 0, 0.35, 2.5, 4),
    4: (-0.1, 0.5, 0.7, 0.35, 1, 4),
    5: (-0.1, 0.5, 0.7, 0.35, 1.8, 4),
    6: (-0.1, 0.5, 0.7, 0.35, 2.5, 4),
    7: (-0.1, 0.5, 0.7, 1, 5, 4),
    8: (-0.1, 0.5, 0.7, 1, 5, 6),
    9: (-0.1, 0.5, 0.7, 1.5, 5, 6),
}


@pytest.mark.parametrize("number", TABLE_II)
def test_sets_are_table_two(number):
    p = load_set(number)
    assert (p.alpha, p.beta, p.lam, p.sigma_e, p.sigma_i, p.r) == TABLE_II[number]
    assert (p.a, p.t0, p.k, p.m, p.t_mp, p.n_sp) == (1.5, 0.5, 1.0, 0.4, 0.4, 2)


def test_every_config_loads_and_is_listed():
    sets = [f"set{name}.yaml" for name in preset_names()]
    others = [f"{name}.yaml" for name in MODELS if name != "dlgmd"]
    assert sorted(path.name for path in presets_dir().glob("*.yaml")) == sorted(sets + others)
    assert preset_names() == [str(n) for n in TABLE_II]
    for name in sets:
        assert "Table II" in (presets_dir() / name).read_text(encoding="utf-8")
        merge(DlgmdParameters, load_config(presets_dir() / name), {})


@pytest.mark.parametrize("model", ["lgmd", "emd-lgmd"])
def test_presets_of_the_other_models_are_their_defaults(model):
    config = load_model_preset(model)
    assert config.model == model
    assert merge(MODELS[model].parameters, config, {}) == MODELS[model].parameters()
    assert set(config.values) < set(MODELS[model].parameters.specs())


def test_defaults_are_set_nine():
    assert load_set(9) == DlgmdParameters()


def test_precedence(tmp_path):
    file = tmp_path / "my.yaml"
    file.write_text("sigma_e: 2.5\nr: 3\n")
    params = merge(DlgmdParameters, load_config(file), parse_overrides(["r=5", "ffi_gd=false"]))
    assert (params.sigma_e, params.r, params.ffi_gd) == (2.5, 5, False)
    assert params.sigma_i == DlgmdParameters().sigma_i


def test_scientific_notation_is_a_number(tmp_path):
    file = tmp_path / "my.yaml"
    file.write_text("kappa: 1e-3\n")
    assert load_config(file).values == {"kappa": 0.001}
    assert parse_overrides(["kappa=2e-3"]) == {"kappa": 0.002}


def test_a_run_record_is_a_config(tmp_path):
    file = tmp_path / "run.yaml"
    document = {
        "input": {"path": "x"},
        "model": "dlgmd",
        **load_set(4).to_dict(),
        "options": {"size": "30x20"},
        "summary": {"mp_max": None},
        "versions": {},
        "warnings": [],
        "complete": False,
        "processed": {},
    }
    file.write_text(yaml.safe_dump(document))
    config = load_config(file)
    assert merge(DlgmdParameters, config, {}) == load_set(4)
    assert (config.model, config.options) == ("dlgmd", {"size": "30x20"})


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "it is empty"),
        ("# only a comment", "it is empty"),
        ("[1, 2]", "it holds a list"),
        ("just words", "it holds mere text"),
        ("3", "it holds one value"),
        ("sigma_x: 1", "unknown parameter 'sigma_x'. Did you mean 'sigma_e'?"),
        ("zzz: 1", "unknown parameter 'zzz'. See 'dlgmd sets show 9'."),
        ("3: 1", "unknown parameter '3'"),
        ("sigma_e: wide", "sigma_e = 'wide' is not a number"),
        ("sigma_e: .nan", "sigma_e = nan is not a finite number"),
        ("sigma_e: .inf", "sigma_e = inf is not a finite number"),
        ("sigma_e: -1", "sigma_e = -1 is not above 0."),
        ("r: 2.5", "r = 2.5 is not a whole number"),
        ("ffi_gd: 1", "ffi_gd = 1 is not true or false"),
        ("sigma_e: [1, 2]", "sigma_e = a list or mapping is not a number"),
        ("sigma_e: 1\nsigma_e: 2", "key 'sigma_e' stands twice in line 2"),
        ("sigma_e: [1", "it is not valid YAML in line"),
        ("[" * 90_000, "its values are nested too deeply"),
        ("- " * 40_000, "its values are nested too deeply"),
        ("sigma_e: !!python/object/apply:os.system [exit]", "apply:os.system' is not allowed"),
        ("sigma_e: !!python/name:os.system", "the tag 'tag:yaml.org,2002:python/name:os.system'"),
        ("ffi_gd: !!bool maybe", "the tag 'tag:yaml.org,2002:bool' is not allowed"),
        ('r: !!int ""', "the tag 'tag:yaml.org,2002:int' is not allowed"),
        ("a: !!timestamp foo", "the tag 'tag:yaml.org,2002:timestamp' is not allowed"),
        ("a: &x 1\nk: *x", "the reference 'x' is not allowed"),
        ("sigma_e: 2020-99-99", "sigma_e = '2020-99-99' is not a number"),
        ("a: 1:30", "a = '1:30' is not a number"),
        ("model: 3", "model is not a name"),
        ("options: 3", "options is not a mapping"),
        ("\0", "it is not valid YAML"),
    ],
)
def test_bad_yaml_is_one_line(tmp_path, text, why):
    file = tmp_path / "my.yaml"
    file.write_text(text)
    with pytest.raises(ParameterError) as caught:
        merge(DlgmdParameters, load_config(file), {})
    message = str(caught.value)
    assert why in message and str(file) in message
    assert "\n" not in message and len(message) < len(str(file)) + 300


def test_a_bomb_of_references_is_refused(tmp_path):
    levels = [f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]" for n in range(1, 20)]
    file = tmp_path / "bomb.yaml"
    file.write_text("\n".join(["l0: &l0 [x]", *levels, "sigma_e: *l19"]))
    with pytest.raises(ParameterError, match="the reference 'l0' is not allowed"):
        load_config(file)


def test_nested_merge_keys_do_not_hang(tmp_path):
    levels = [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 10)}]}}" for n in range(1, 12)]
    file = tmp_path / "merge.yaml"
    file.write_text("\n".join(["a0: &a0 {a: 1}", *levels]))
    with pytest.raises(ParameterError, match="the reference 'a0' is not allowed"):
        load_config(file)


def test_unreadable_files(tmp_path):
    with pytest.raises(ParameterError, match="there is no such file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ParameterError, match="it is not a file"):
        load_config(tmp_path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterError, match="not UTF-8"):
        load_config(binary)
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(100_000_000)  # a hole: nothing is read
    with pytest.raises(ParameterError, match=r"100\.0 MB is too large"):
        load_config(huge)


def test_unknown_set():
    with pytest.raises(ParameterError) as caught:
        load_preset(12)
    assert str(caught.value) == "there is no set 12. Choose 1 to 9."


@pytest.mark.parametrize("pair", ["r", "=3", "r=[1", "r=", "r=abc", "r=.nan", "q=1"])
def test_bad_overrides_blame_the_option(pair):
    with pytest.raises(ParameterError, match=r"^Invalid value for '--param'"):
        merge(DlgmdParameters, load_preset(9), parse_overrides([pair]))


def test_blame_falls_on_the_file_or_the_override(tmp_path):
    file = tmp_path / "my.yaml"
    file.write_text("alpha: -3\n")
    with pytest.raises(ParameterError, match=r"my\.yaml: alpha = -3"):
        merge(DlgmdParameters, load_config(file), {})
    # Mended together, they are valid.
    assert merge(DlgmdParameters, load_config(file), {"alpha": 0.0}).alpha == 0.0
    with pytest.raises(ParameterError, match="'--param'"):
        merge(DlgmdParameters, load_preset(9), {"alpha": -3.0})


def test_presets_are_found_beside_the_package():
    assert Path(presets_dir()).is_dir()
