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
    EMPTY,
    NO,
    UNDECIDED,
    WHOSE,
    YES,
    Claim,
    ExhibitSpec,
    Finding,
    load_claims,
    select,
)
from dlgmd_cli.lab.reproduce.clips import (
    EVERY,
    NULLS,
    VERSIONS,
    Clip,
    all_versions,
    model,
    other_models,
)
from dlgmd_cli.lab.reproduce.plan import TIMING, Evidence, Plan, compute, needed, shown_by
from dlgmd_cli.lab.reproduce.report import Report, Section, number
from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters import load_set

NAN = math.nan
SPECS, REMARKS = load_claims()
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


@pytest.mark.parametrize(
    ("values", "null", "verdict"),
    [
        ((2.0,), (0.5,), YES),
        ((2.0,), (3.0,), EMPTY),
        ((2.0,), (3.0, 0.5), YES),  # the null model fails for one seed
        ((2.0,), (), YES),
        ((0.5,), (3.0,), NO),
    ],
)
def test_a_claim_that_holds_without_inhibition_says_nothing(values, null, verdict):
    claim = Claim("x", "It is so.", "what", 1.0, "above", "because")
    assert Finding(claim, "Fig. 0", "default", values, null).verdict == verdict


def test_versions_that_share_a_null_model_have_the_same_one():
    for version, null in NULLS.items():
        own = {**model("set9", version).to_dict(), "a": 0.0}
        assert own["saturate"] == model("set9", null).saturate
        mine, shared = connect(load_set(9, **own)), connect(model("set9", null))
        assert np.array_equal(mine.excitation, shared.excitation)
        assert not any(kernel.any() for kernel in shared.inhibition.values())
    assert set(EVERY) == {*VERSIONS, *NULLS.values()}


def test_every_exhibit_is_computed_and_every_claim_has_its_texts():
    assert set(SPECS) == set(EXHIBITS) and all(len(lines) >= 5 for lines in REMARKS.values())
    ids = [key for spec in SPECS.values() for key in spec.claims]
    assert len(ids) == len(set(ids))
    for spec in SPECS.values():
        for key, claim in spec.claims.items():
            assert key.startswith(spec.id), key
            assert Finding(claim, "", "", (claim.threshold,)).holds in (YES, NO)
            assert claim.whose in WHOSE
            for text in (claim.claim, claim.reason, spec.about, spec.says):
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
        (["fig6"], {"fig6": ["fig6-slow", "fig6-fast"]}),
        (
            ["fig17", "fig2-size"],
            {"fig2": ["fig2-size"], "fig17": ["fig17-silent", "fig17-answers", "fig17-db"]},
        ),
        (["fig10-rising", "fig5-rises"], {"fig5": ["fig5-rises"], "fig10": ["fig10-rising"]}),
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


def test_clips_are_rendered_for_all_exhibits_together(monkeypatch):
    monkeypatch.setattr("dlgmd_cli.lab.reproduce.plan._AT_ONCE", 8)
    clip = Clip.of("looming-cube", size=(30, 40))
    order = []

    def exhibit(needs):
        data = yield needs
        return Evidence({"seen": {"any": [len(data)]}})

    started = [
        exhibit({f"{TIMING}, x": lambda: order.append("timed")}),
        exhibit({clip: other_models("lgmd"), "more": lambda: True}),
        exhibit({clip: all_versions("set3")}),
    ]
    data = compute(needed(started), 1, lambda n, name: order.append(name))
    # 13 models, 8 at once.
    assert order == ["looming-cube", "looming-cube", "more", "timed", f"{TIMING}, x"]
    assert shown_by(started[0], data).values == {"seen": {"any": [3]}}
    results = data[clip].results
    assert set(results) == {"lgmd", *all_versions("set3")}
    assert np.array_equal(
        results["set3/default"].mp,
        clips.run_clip(clip, {"x": model("set3")}).results["x"].mp,
        equal_nan=True,
    )
    assert data[clip].truth["frame"][-1] == 74


def test_peaks_are_small_and_separate():
    level = np.array([0, 0.1, 0, 0.3, 0.2, 0.35, 0, 0.04, 0, 0.9, 0])
    assert flights.small_peaks(level, len(level)) == 3
    assert flights.small_peaks(level, 4) == 1


def test_layers_of_moving_cells():
    p, s, g = (np.zeros((8, 8), np.float32) for _ in range(3))
    p[2:6, 2:6], s[2:6, 2:6], g[3:5, 3:5] = 0.5, 0.5, 0.25
    s[0, 0] = 0.5  # a cell on its own, which G removes
    spread_p, spread_s, sparse, others = clips.layer_shares(p, s, g)
    assert spread_p == spread_s == 0.0 and sparse == 1.0 and 0.0 < others < 1.0
    s[2:6, 2:4] = 0.0
    assert clips.layer_shares(p, s, g)[1] == pytest.approx(1.0)


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
    claim = Claim("c", "<dfn>", "<b>x", 1.0, "above", "<u>", "<q>", why_not="<s>", paper="<p>7")
    spec = ExhibitSpec("fig1", "<script>", "&", "<h1>z", "<img>", ["dlgmd '<x>'"], {"c": claim})
    evidence = Evidence({"c": {v: [0.5, 2.0] for v in EVERY}}, table=[("<y>", 1.0)])
    remarks = {"objections": ["<em>"], "contradictions": ["<tt>"]}
    report = Report([Section(spec, evidence)], remarks, Plan(quick=True), "dlgmd --out '<y>'")
    html = report.html(None)
    raws = "<dfn> <b>x <u> <q> <s> <p>7 <h1>z <img> <script> <x> <y> <em> <tt>"
    for raw in raws.split():
        assert raw not in html
    assert html.count("1 of 2 seeds") == len(VERSIONS) and "&lt;script&gt;" in html


def test_numbers_for_readers():
    shown = [number(value) for value in (-1.2345, 9789.28, math.inf, NAN, 2e-7, 0.0, ">10000")]
    assert shown == ["−1.23", "9789", "∞", "–", "2e−07", "0", ">10000"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--only", "fig99"], 2, ("no 'fig99'", "Choose from fig1, fig2")),
        (["--reference", "."], 2, ("neither looming_ball nor ball_and_capsules",)),
        (["--reference", "nowhere"], 2, ("does not exist",)),
        (["--jobs", 0], 2, ("'--jobs'",)),
        (["--only", "fig5"], 1, ("jinja2", "pip install")),
    ],
)
def test_errors_in_one_line(dlgmd, monkeypatch, options, code, words):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    result = dlgmd("reproduce", *options)
    assert result.exit_code == code and all(word in result.stderr for word in words)
