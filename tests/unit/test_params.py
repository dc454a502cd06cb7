"""Every parameter's type and range, and what is said about a value that is wrong."""

import dataclasses
import datetime
import decimal
import fractions
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import slow

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import FORMULATIONS, DlgmdParameters, nearest

# key -> lowest, whether that is excluded, highest
BOUNDS = {
    "alpha": (-10, 64),
    "beta": (0, 100),
    "lam": (0, 10),
    "sigma_e": (0.01, 100),
    "sigma_i": (0.01, 100),
    "r": (1, 32),
    "a": (0, 100),
    "k": (1e-12, 100),
    "t0": (0, 100),
    "m": (0.001, 100),
    "t_mp": (0, 1),
    "n_sp": (1, 1000),
    "kappa": (1e-9, 100),
}
# Fractions that must be positive; the limit only keeps float32 from overflowing.
POSITIVE = ("sigma_e", "sigma_i", "k", "m", "kappa")
WHOLE = ("r", "n_sp")
FRACTIONAL = [key for key in BOUNDS if key not in WHOLE]
# What the other keys must be for a limit to be causal and short enough.
COMPANIONS = {("beta", 0): {"lam": 0.0}, ("beta", 100): {"alpha": 0.0}}


def complaint(**values):
    """The line that says why these values are refused."""
    with pytest.raises(ParameterError) as caught:
        DlgmdParameters(**values)
    return str(caught.value)


def test_keys_and_defaults():
    table_1 = {"t_mp": 0.4, "n_sp": 2}
    expected = slow.table_2(9) | table_1
    actual = DlgmdParameters().to_dict()
    assert {key: actual[key] for key in expected} == expected
    assert set(actual) == {*BOUNDS, "ffi_gd", "formulation"}
    assert list(actual) == list(DlgmdParameters.specs()) == list(DlgmdParameters.defaults())
    assert DlgmdParameters.defaults() == actual


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"sigma_e": -1}, "sigma_e = -1 is not above 0."),
        ({"sigma_e": 0.0}, "sigma_e = 0.0 is not above 0."),
        ({"r": 0}, "r = 0 is not at least 1."),
        ({"r": 33}, "r = 33 is more than 32."),
        ({"r": 4.0}, "r = 4.0 is not a whole number."),
        ({"r": 4.5}, "r = 4.5 is not a whole number."),
        ({"alpha": -10.5}, "alpha = -10.5 is not at least -10."),
        ({"t_mp": 1.01}, "t_mp = 1.01 is more than 1."),
        ({"n_sp": 1001}, "n_sp = 1001 is more than 1000."),
        ({"sigma_i": math.nan}, "sigma_i = nan is not a finite number."),
        ({"n_sp": math.inf}, "n_sp = inf is not a finite number."),
        ({"a": "1.5"}, "a = '1.5' is not a number."),
        ({"a": True}, "a = True is not a number."),
        ({"n_sp": False}, "n_sp = False is not a number."),
        ({"a": None}, "a = None is not a number."),
        ({"a": [1.5]}, "a = a list or mapping is not a number."),
        ({"a": {"b": [{}]}}, "a = a list or mapping is not a number."),
        ({"a": 1.5 + 0j}, "a = (1.5+0j) is not a number."),
        ({"a": datetime.date(2023, 1, 2)}, "a = 2023-01-02 is not a number."),
        ({"a": "x\ny" + "z" * 99}, f"a = 'x\\ny{'z' * 37}' is not a number."),
        ({"ffi_gd": 1}, "ffi_gd = 1 is not true or false."),
        ({"ffi_gd": "yes"}, "ffi_gd = 'yes' is not true or false."),
        ({"ffi_gd": None}, "ffi_gd = None is not true or false."),
        (
            {"formulation": "Default"},
            "formulation = 'Default' is not one of default, released, equations.",
        ),
        ({"formulation": None}, "formulation = None is not one of default, released, equations."),
        (
            {"formulation": ["default"]},
            "formulation = a list or mapping is not one of default, released, equations.",
        ),
        ({"formulation": 0}, "formulation = 0 is not one of default, released, equations."),
        (
            {"alpha": -1.0},
            "alpha = -1 with beta = 0.5 makes the latency negative (-0.333 frames at the centre). "
            "Inhibition cannot come before its cause; raise alpha.",
        ),
        (
            {"beta": 0.0},
            "beta = 0 with lam = 0.7 and r = 6 makes the latency longer than 64 frames. "
            "Raise beta or lower lam.",
        ),
        # exp(-λ²·2r²) is 0 in float64 here: the latency is endless.
        (
            {"beta": 0.0, "lam": 10.0, "r": 32},
            "beta = 0 with lam = 10 and r = 32 makes the latency longer than 64 frames. "
            "Raise beta or lower lam.",
        ),
    ],
)
def test_what_is_said_about_a_wrong_value(values, line):
    assert complaint(**values) == line


@pytest.mark.parametrize("key", BOUNDS)
def test_bounds(key):
    low, high = BOUNDS[key]
    step = 1 if key in WHOLE else 1e-3
    assert complaint(**{key: high + step}) == f"{key} = {high + step} is more than {high}."
    if key in POSITIVE:
        assert complaint(**{key: 0}) == f"{key} = 0 is not above 0."
        assert complaint(**{key: -1.5}) == f"{key} = -1.5 is not above 0."
        assert complaint(**{key: low / 2}) == f"{key} = {low / 2} is not at least {low:g}."
    else:
        assert complaint(**{key: low - step}) == f"{key} = {low - step} is not at least {low}."


@pytest.mark.parametrize("key", [key for key in BOUNDS if key != "alpha"])
def test_limits_are_inside(key):
    for limit in BOUNDS[key]:
        values = {key: limit} | COMPANIONS.get((key, limit), {})
        assert getattr(DlgmdParameters(**values), key) == limit


def test_latency_may_be_zero_but_not_less():
    assert DlgmdParameters(alpha=-1.0, beta=0.0, lam=0.0).alpha == -1.0
    assert "negative" in complaint(alpha=-1.0 - 1e-9, beta=0.0, lam=0.0)


def test_latency_may_take_64_frames_but_not_more():
    assert DlgmdParameters(alpha=63.0, beta=0.0, lam=0.0).alpha == 63.0
    assert "longer than 64 frames" in complaint(alpha=63.0 + 1e-9, beta=0.0, lam=0.0)
    # It is the corner of the kernel that counts: 1/exp(-λ²·2r²).
    lam = math.sqrt(math.log(60.0) / (2 * 4**2))
    assert DlgmdParameters(alpha=3.9, beta=0.0, lam=lam, r=4).lam == lam
    assert "longer than 64 frames" in complaint(alpha=4.1, beta=0.0, lam=lam, r=4)


def test_a_long_latency_is_laid_at_the_door_of_alpha():
    # No beta and no lam can mend it.
    line = complaint(alpha=64.0)
    assert line.startswith("alpha = 64 ")
    assert "lower alpha" in line.lower()


@pytest.mark.parametrize("key", FRACTIONAL)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float32(np.nan)])
def test_numbers_are_finite(key, value):
    assert complaint(**{key: value}) == f"{key} = {value} is not a finite number."


@pytest.mark.parametrize("key", [*BOUNDS, "ffi_gd", "formulation"])
@pytest.mark.parametrize(
    "value",
    [None, [], [1], {}, {"r": 1}, (1, 2), {1}, "", "1", b"1", ..., 1j, decimal.Decimal(1)],
    ids=repr,
)
def test_other_types_are_refused(key, value):
    line = complaint(**{key: value})
    assert line.startswith(f"{key} = ")
    assert len(line) < 150


@pytest.mark.parametrize("key", [*BOUNDS, "ffi_gd", "formulation"])
def test_nesting_without_end_is_refused_briefly(key):
    deep = []
    deep.append(deep)
    assert complaint(**{key: deep}).startswith(f"{key} = a list or mapping is not ")


@pytest.mark.parametrize("key", [*BOUNDS, "ffi_gd", "formulation"])
@pytest.mark.parametrize(
    "value",
    [10**40, 10**400, -(10**400), 10**5000],
    ids=["1e40", "1e400", "-1e400", "1e5000"],
)
def test_huge_numbers_are_refused_briefly(key, value):
    line = complaint(**{key: value})
    assert line.startswith(f"{key} = ")
    assert len(line) < 150


@pytest.mark.parametrize(
    "value",
    [np.array([1.0, 2.0]), np.array(["default", "released"])],
    ids=["numbers", "names"],
)
@pytest.mark.parametrize("key", ["a", "r", "ffi_gd", "formulation"])
def test_arrays_are_refused(key, value):
    assert complaint(**{key: value}).startswith(f"{key} = ")


@pytest.mark.parametrize(
    ("key", "value", "kept"),
    [
        ("a", np.float64(1.25), 1.25),
        ("a", np.float32(1.25), 1.25),
        ("a", np.int16(2), 2.0),
        ("a", 2, 2.0),
        ("a", fractions.Fraction(5, 4), 1.25),
        ("r", np.int64(5), 5),
        ("n_sp", np.uint8(3), 3),
        ("formulation", np.str_("released"), "released"),
    ],
)
def test_numpy_scalars_become_plain_values(key, value, kept):
    actual = getattr(DlgmdParameters(**{key: value}), key)
    assert actual == kept
    assert type(actual) is type(kept)


def test_numpy_truth_is_no_number():
    assert complaint(a=np.True_) == "a = True is not a number."


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("sigma_x", "Did you mean 'sigma_e'? "),
        ("sigmae", "Did you mean 'sigma_e'? "),
        ("sigma_I", "Did you mean 'sigma_i'? "),
        ("lambda", "Did you mean 'lam'? "),
        ("betta", "Did you mean 'beta'? "),
        ("ffi", "Did you mean 'ffi_gd'? "),
        ("formulations", "Did you mean 'formulation'? "),
        ("zzz", ""),
        ("", ""),
    ],
)
def test_unknown_keys_come_with_a_suggestion(key, hint):
    with pytest.raises(ParameterError) as caught:
        DlgmdParameters.from_mapping({"r": 4, key: 1})
    assert str(caught.value) == f"unknown parameter '{key}'. {hint}See 'dlgmd sets show 9'."


@pytest.mark.parametrize("key", [3, None, ("r",), 1.5, True])
def test_keys_that_are_no_names_are_unknown(key):
    with pytest.raises(ParameterError, match=r"^unknown parameter "):
        DlgmdParameters.from_mapping({key: 1})


def test_a_long_key_is_shown_briefly():
    with pytest.raises(ParameterError) as caught:
        DlgmdParameters.from_mapping({"x\n" * 10_000: 1})
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def test_nearest_prefers_the_first_of_equals():
    assert nearest("sigma_x", ["sigma_i", "sigma_e"]) == "sigma_i"
    assert nearest("sigma_x", ["sigma_e", "sigma_i"]) == "sigma_e"
    assert nearest("sigma_i", ["sigma_e", "sigma_i"]) == "sigma_i"
    assert nearest("nothing", ["sigma_e"]) is None


def test_parameters_are_frozen():
    params = DlgmdParameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.r = 3
    assert hash(params) == hash(DlgmdParameters())
    assert params != DlgmdParameters(r=3)


def test_a_changed_copy_is_checked_again():
    assert dataclasses.replace(DlgmdParameters(), r=3).r == 3
    with pytest.raises(ParameterError):
        dataclasses.replace(DlgmdParameters(), r=-3)


def test_parameters_and_their_errors_cross_processes():
    params = DlgmdParameters(r=3)
    assert pickle.loads(pickle.dumps(params)) == params
    error = ParameterError("my.yaml", "r = 0 is not at least 1", "Mend it.")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (ParameterError, str(error))
    assert str(error) == "my.yaml: r = 0 is not at least 1. Mend it."


def test_allowed_values_in_words():
    allowed = {key: spec.allowed for key, spec in DlgmdParameters.specs().items()}
    assert allowed["sigma_e"] == "0.01 to 100"
    assert allowed["alpha"] == "-10 to 64"
    assert allowed["n_sp"] == "1 to 1000"
    assert allowed["ffi_gd"] == "true, false"
    assert allowed["formulation"] == ", ".join(FORMULATIONS)


@settings(deadline=None)
@given(
    st.fixed_dictionaries(
        {},
        optional={
            "sigma_e": st.floats(0.01, 100.0),
            "r": st.integers(1, 32),
            "a": st.floats(0.0, 100.0),
            "t_mp": st.floats(0.0, 1.0),
            "kappa": st.floats(1e-9, 100.0),
            "ffi_gd": st.booleans(),
            "formulation": st.sampled_from(FORMULATIONS),
        },
    )
)
def test_round_trip(values):
    params = DlgmdParameters.from_mapping(values)
    assert DlgmdParameters.from_mapping(params.to_dict()) == params
    assert params.to_dict() == DlgmdParameters.defaults() | values


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.fractions()
    | st.decimals()
    | st.complex_numbers()
    | st.text()
    | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@settings(deadline=None)
@given(key=st.sampled_from([*BOUNDS, "ffi_gd", "formulation"]), value=anything)
def test_anything_is_kept_in_its_own_type_or_refused_in_one_line(key, value):
    try:
        actual = getattr(DlgmdParameters(**{key: value}), key)
    except ParameterError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 300
        return
    assert type(actual) is type(DlgmdParameters.defaults()[key])
    assert actual == (float(value) if isinstance(value, fractions.Fraction) else value)
    if key in BOUNDS:
        low, high = BOUNDS[key]
        assert low <= actual <= high
