"""`dlgmd reproduce`: claims and thresholds, what ids stand for, the report, one-line errors."""

import math
import shlex
import sys
from itertools import islice

import numpy as np
import pytest

from dlgmd_cli.commands.app import cli
from dlgmd_cli.lab.reproduce import clips, flights, stimuli
from dlgmd_cli.lab.reproduce.claims import (
    NO,
    UNDECIDED,
    YES,
    Claim,
    ExhibitSpec,
    Finding,
    load_claims,
    select,
)
from dlgmd_cli.lab.reproduce.clips import Clip, all_formulations, model, other_models
from dlgmd_cli.lab.reproduce.plan import TIMING, Evidence, Exhibit, Plan, compute, needed
from dlgmd_cli.lab.reproduce.report import Report, Section, number
from dlgmd_cli.parameters import FORMULATIONS

NAN = math.nan
SPECS, INCONSISTENCIES = load_claims()
EXHIBITS = stimuli.EXHIBITS | flights.EXHIBITS


@pytest.mark.parametrize(
    ("values", "holds", "value", "verdict"),
    [
        ([2, 1], "at least", 1, YES),
        ([2, 1], "above", 1, NO),
        ([0, 1], "at most", 1, YES),
        ([0, 1], "below", 1, NO),
        ([NAN, 2], "above", 2, UNDECIDED),
        ([NAN, 0.5], "above", 0.5, NO),  # one that fails is enough
        ([NAN], "above", NAN, UNDECIDED),
        ([math.inf], "above", math.inf, YES),
    ],
)
def test_a_claim_holds_if_it_does_for_the_worst_seed(values, holds, value, verdict):
    claim = Claim("x", "It is so.", "what", 1.0, holds, "because")
    one = Finding(claim, "Fig. 0", "default", tuple(values))
    assert one.holds == verdict and (one.value == value or math.isnan(value))


def test_every_exhibit_is_computed_and_every_claim_has_its_texts():
    assert set(SPECS) == set(EXHIBITS) and len(INCONSISTENCIES) >= 4
    ids = [key for spec in SPECS.values() for key in spec.claims]
    assert len(ids) == len(set(ids))
    for spec in SPECS.values():
        for key, claim in spec.claims.items():
            assert key.startswith((spec.id, spec.id.rstrip("ab"))), key
            assert Finding(claim, "", "", (claim.threshold,)).holds in (YES, NO)
            for text in (claim.claim, claim.reason, spec.about):
                assert text[-1] == "." and text[0] == text[0].upper(), text


def test_commands_that_repeat_an_exhibit_exist():
    for spec in SPECS.values():
        for line in spec.repeat:
            name, *words = shlex.split(line)[1:]
            command = cli.get_command(None, name)
            with cli.make_context("dlgmd", [name]) as ctx:
                command.make_context(name, words, parent=ctx)  # raises UsageError


@pytest.mark.parametrize(
    ("only", "ids"),
    [
        (["fig1"], {"fig1": ["fig1-pitch", "fig1-accelerate"]}),
        (
            ["fig17", "fig3-size"],
            {"fig3": ["fig3-size"], "fig17": ["fig17-silent", "fig17-answers"]},
        ),
        (["fig9b", "fig5-rises"], {"fig5": ["fig5-rises"], "fig9": ["fig9b-rest"]}),
        ([], {name: list(spec.claims) for name, spec in SPECS.items()}),
    ],
)
def test_ids_and_their_beginnings(only, ids):
    assert {name: list(spec.claims) for name, spec in select(SPECS, only).items()} == ids
    assert {"table4-da", "table4-time"} == set(select(SPECS, ["table4"]))


def test_levels_that_are_held():
    level = np.array([0, 0.9, 0, 0.5, 0.6, 0.2, 1.0])
    assert flights.sustained(level, 0, 5) == 0.5
    assert flights.sustained(level, 0, 6) == 0.5
    assert flights.sustained(level, 0, 2) == 0.0


def test_clips_are_rendered_once_for_all_their_models():
    clip = Clip.of("looming-cube", size=(30, 40))
    order = []
    exhibits = [
        Exhibit(lambda plan: {f"{TIMING}, x": lambda: order.append("timed")}, None),
        Exhibit(lambda plan: {clip: other_models("lgmd"), "more": lambda: plan.quick}, None),
        Exhibit(lambda plan: {clip: all_formulations("set3")}, None),
    ]
    needs = needed(exhibits, Plan(quick=True))
    data = compute(needs, 1, lambda n, name: order.append(name))
    assert order == ["looming-cube", "more", "timed", f"{TIMING}, x"] and data["more"]
    results = data[clip].results
    assert set(results) == {"lgmd", *all_formulations("set3")}
    assert np.array_equal(
        results["set3/default"].mp,
        clips.run_clip(clip, {"x": model("set3")}).results["x"].mp,
        equal_nan=True,
    )
    assert stimuli.onset(results["lgmd"]) > 0 and data[clip].truth["frame"][-1] == 74


def test_boxes_hold_the_objects_of_fig_8():
    clip = Clip.of("ball-and-capsules", size=(150, 200))
    with clips.open_clip(clip) as video:
        frames = [frame.grey.astype(float) for frame in islice(video, 42)]
    for index in (5, 20, 41):
        change = np.abs(frames[index] - frames[index - 1]) > 12
        boxes = clips.object_boxes(change.shape, index)
        assert change.sum() > 50 and all(change[box].any() for box in boxes)
        for box in boxes:
            change[box] = False
        assert not change.any()


def test_texts_are_escaped():
    claim = Claim("c", "<i>a</i>", "<b>", 1.0, "above", "<u>", "<s>")
    spec = ExhibitSpec("fig1", "<script>", "&", "<img>", ["dlgmd run '<x>'"], {"c": claim})
    evidence = Evidence({"c": {f: [0.5, 2.0] for f in FORMULATIONS}})
    report = Report([Section(spec, evidence)], ["<em>"], Plan(quick=True), "dlgmd --out '<y>'")
    html = report.html(None)
    for raw in ("<i>", "<script>", "<img>", "<x>", "<u>", "<s>", "<em>", "<y>"):
        assert raw not in html
    assert html.count("1 of 2 seeds") == 3 and "&lt;script&gt;" in html


def test_numbers_for_readers():
    shown = [number(value) for value in (-1.2345, 9789.28, math.inf, NAN, 2e-7, 0.0)]
    assert shown == ["−1.23", "9789", "∞", "–", "2e−07", "0"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--only", "fig99"], 2, ("no 'fig99'", "Choose from fig1, fig3")),
        (["--reference", "."], 2, ("neither looming_ball nor ball_and_capsules",)),
        (["--reference", "nowhere"], 2, ("does not exist",)),
        (["--jobs", 0], 2, ("'--jobs'",)),
        (["--only", "fig5"], 1, ("Jinja2", "pip install")),
    ],
)
def test_errors_in_one_line(dlgmd, monkeypatch, options, code, words):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    result = dlgmd("reproduce", *options)
    assert result.exit_code == code and all(word in result.stderr for word in words)
