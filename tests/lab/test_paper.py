"""`dlgmd lab paper`: claims and thresholds, what ids stand for, measures, the report."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import csv_rows
from reference_data import reference_dir

import dlgmd_cli
from dlgmd_cli import DLGMD, load_set
from dlgmd_cli.lab.fly.fly import Flight
from dlgmd_cli.lab.paper import claims, clips, flights, free, objects, stimuli, table4
from dlgmd_cli.lab.paper.claims import (
    Claim,
    ExhibitSpec,
    Finding,
    load_claims,
    number,
    select,
    shown,
)
from dlgmd_cli.lab.paper.clips import EVERY, NULLS, VERSIONS, Clip, all_versions, model
from dlgmd_cli.lab.paper.paper import EXHIBITS, Report, Section
from dlgmd_cli.lab.paper.plan import (
    TIMING,
    Evidence,
    Plan,
    Started,
    Trial,
    compute,
    needed,
    plan_of,
    trials_of,
)

NAN = math.nan
SPECS, REMARKS = load_claims()
YES, EMPTY, TIE, NO, UNDECIDED, UNTESTABLE = claims.VERDICTS
SELECTS, RESPONDS, PART = claims.KINDS


@pytest.mark.parametrize(
    ("values", "holds", "verdict"),
    [
        ([2], "at least", YES),
        ([1], "above", NO),
        ([1], "at most", YES),
        ([1], "below", NO),
        ([2] * 6, "above", YES),
        ([2] * 5 + [0], "above", UNDECIDED),  # the interval of six is their range
        ([2] * 15 + [0] * 5, "above", YES),  # of twenty, from the sixth to the fifteenth
        ([2] * 14 + [0] * 6, "above", UNDECIDED),
        ([0] * 15 + [2] * 5, "above", NO),
        ([2] * 15 + [NAN] * 5, "above", YES),  # whatever the undefined ones are
        ([2] * 14 + [NAN] * 6, "above", UNDECIDED),
        ([2] * 9 + [NAN] * 11, "above", UNTESTABLE),
        ([NAN], "above", UNTESTABLE),
        ([math.inf] * 20, "above", YES),
    ],
)
def test_a_claim_holds_if_the_interval_of_the_median_does(values, holds, verdict):
    claim = Claim("x", "It is so.", "what", 1.0, holds, "because")
    assert Finding(claim, "Fig. 0", "default", tuple(values)).holds == verdict


@pytest.mark.parametrize(
    ("values", "verdict"),
    [([0.99879], TIE), ([0.995], YES), ([1.002], TIE), ([1.1], NO), ([0.9, 1.1], UNDECIDED)],
)
def test_as_good_as_equal_is_no_verdict_for_either(values, verdict):
    claim = Claim("x", "It is less.", "what", 1.0, "below", "because", tie=(0.997, 1.003))
    assert Finding(claim, "Fig. 0", "default", tuple(values)).verdict == verdict


@pytest.mark.parametrize(
    ("kind", "values", "null", "verdict"),
    [
        (SELECTS, (2.0,), (0.5,), YES),
        (SELECTS, (2.0,), (3.0,), EMPTY),
        (SELECTS, (2.0,), (), YES),
        (SELECTS, (0.5,), (3.0,), NO),
        (RESPONDS, (2.0,), (3.0,), YES),
        (PART, (2.0,), (3.0,), YES),
    ],
)
def test_what_inhibition_brings_about_must_fail_without_it(kind, values, null, verdict):
    claim = Claim("x", "It is so.", "what", 1.0, "above", "because", kind=kind)
    assert Finding(claim, "Fig. 0", "default", values, null).verdict == verdict


@pytest.mark.parametrize(
    ("value", "tries", "reading", "trial", "verdict", "flipped"),
    [
        (2.0, [1.5], 3.0, 4.0, YES, []),
        (2.0, [2.5], 3.0, 4.0, UNDECIDED, ["threshold 2.5 dB"]),
        (2.0, [], 0.5, 4.0, UNDECIDED, ["otherwise"]),
        (2.0, [], 3.0, 0.5, UNDECIDED, ["smoother"]),
        (2.0, [], NAN, 2.0, YES, []),  # what cannot be measured contradicts nothing
        (NAN, [], 3.0, 4.0, UNTESTABLE, []),
        (0.5, [1.5], 0.0, 0.4, NO, []),
    ],
)
def test_what_another_reading_turns_is_undecided(value, tries, reading, trial, verdict, flipped):
    fields = {"claim": "It is so.", "measure": "what", "threshold": 1.0, "holds": "above"}
    others = {"other": {"label": "otherwise", "measure": "how"}}
    more = {"reason": "so", "unit": "dB", "tries": tries, "readings": others}
    claim = Claim.of("c", fields | more)
    evidence = Evidence({"c": {"default": [value]}, "c~other": {"default": [reading]}})
    trials = [(Trial("smoother", Plan()), Evidence({"c": {"default": [trial]}}))]
    (found,) = claims.findings([claim], "IV", evidence, Plan(), trials)
    assert (found.verdict, found.flipped_by) == (verdict, flipped)
    # Where nothing changes, nothing was tried.
    n_tried = len(tries) + 1 + (trial != value)
    assert len(found.tried) == n_tried


def test_a_free_constant_is_another_one_for_a_while():
    with free.trying("contact", 20):
        assert free.frames("contact") == 20
    assert free.frames("contact") == 15
    exhibits = {name for constant in free.FREE.values() for name in constant.exhibits}
    assert exhibits <= set(EXHIBITS)
    texts = [trial.text for trial in trials_of("fig14", Plan())]
    assert "level held for 1 frame" in texts and "level held for 3 frames" in texts
    assert "7 frames before and after braking begins" in texts and "smoother motion" in texts
    assert "smoother motion" not in [trial.text for trial in trials_of("fig14", Plan(quick=True))]


def test_the_page_has_what_fails_first():
    def section(key, *values):
        fields = {"claim": f"{key} <so>.", "measure": "what", "threshold": 1, "holds": "above"}
        more = {
            "reason": "so",
            "words": "it is",
            "objection": "No.",
            "answer": "Yes.",
            "tries": [2],
        }
        others = {"readings": {"other": {"label": "otherwise", "measure": "how"}}}
        claim = Claim.of(key, fields | more | others)
        spec = ExhibitSpec(key, "t", "IV", "s", "a", {key: claim}, "Their flights.")
        evidence = Evidence(
            {key: {"default": list(values)}, f"{key}~other": {"default": list(values)}}
        )
        return Section(spec, Plan(quick=True), evidence)

    sections = [section("good", 3), section("open", 1.5), section("bad", 0)]
    text = Report(sections, REMARKS, Plan(quick=True), "x").text("claims.md", None, {})
    titles = [line for line in text.splitlines() if line.startswith("### ")]
    assert titles[:3] == ["### Fails (1)", "### Undecided (1)", "### Holds (1)"]
    assert "**good <so>.**" in text and "“it is” (IV)" in text and "↳ how: **> 1**" in text
    assert "✓ at first; another verdict by threshold 2." in text and "Their flights." in text
    assert "*Objection:* No. *Answer:* Yes." in text and REMARKS["objections"][-1] in text


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    clip, models = Clip.of("looming-cube", size="40x30"), {"a": model(3), "b": ("lgmd", 0.5)}
    first = clips.run_clip(clip, models, tmp_path)
    monkeypatch.setattr(clips, "seen", None)
    again = clips.run_clip(clip, {"a": model(3)}, tmp_path)
    assert np.array_equal(first.results["a"].mp, again.results["a"].mp, equal_nan=True)
    assert first.sha256 == again.sha256
    with pytest.raises(TypeError):  # another model has to see it
        clips.run_clip(clip, {"a": model(4)}, tmp_path)


def test_versions_that_share_a_null_model_have_the_same_one():
    for version, null in NULLS.items():
        own = {**model(9, version).to_dict(), "a": 0.0}
        assert own["saturate"] == model(9, null).saturate
        mine, shared = DLGMD(load_set(9, **own)).connections, DLGMD(model(9, null)).connections
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
            assert Finding(claim, "", "", (claim.threshold,)).holds in (YES, NO, TIE)
            assert not claim.tie or claim.tie[0] < claim.threshold < claim.tie[1]
            assert claim.whose in claims.WHOSE and claim.kind in claims.KINDS
            place = claim.source or spec.source
            is_place = re.match(r"(I|III|IV|V|Abstract|Fig|Table)\b", place)
            assert claim.whose == "ours" or is_place, key
            assert "|" not in "".join(map(str, vars(claim).values())), "a cell of a table"
            for text in (claim.claim, claim.reason, spec.about, spec.says):
                assert text[-1] == "." and text[0] == text[0].upper(), text


@pytest.mark.parametrize(
    ("only", "ids"),
    [
        (
            ["fig1"],
            {"fig1": ["fig1-pitch", "fig1-pitch-raw", "fig1-accelerate", "fig1-accelerate-raw"]},
        ),
        (
            ["fig17", "fig5-rises"],
            {"fig5": ["fig5-rises"], "fig17": list(SPECS["fig17"].claims)},
        ),
        ([], {name: list(spec.claims) for name, spec in SPECS.items()}),
    ],
)
def test_ids_and_their_beginnings(only, ids):
    assert {name: list(spec.claims) for name, spec in select(SPECS, only).items()} == ids
    assert {"table4-da", "table4-time"} == set(select(SPECS, ["table4"]))


def test_levels_that_are_held():
    level = np.array([0, 0.9, 0, 0.5, 0.6, 0.2, 1.0])
    assert flights.greatest(level, 0, 5, 2) == 0.5
    assert flights.greatest(level, 0, 2, 2) == 0.0
    assert flights.greatest(level, 0, 5) == 0.9


def test_a_drop_is_that_of_the_level_as_the_drone_brakes():
    flight = SimpleNamespace(phases={"decelerate": (20, 40)})
    mp = np.array([0.0] * 10 + [4.0] * 10 + [2.0] * 5 + [1.0] * 15 + [5.0])
    result = SimpleNamespace(collision_frame=40, mp=mp)
    assert flights._drop(result, flight, lowest=False) == pytest.approx(0.375)
    assert flights._drop(result, flight, lowest=True) == pytest.approx(0.25)
    with free.trying("brake", 5):
        assert flights._drop(result, flight, lowest=False) == pytest.approx(0.5)
    mp[-1] = 500.0  # beside it, 4 is no response to speak of
    assert math.isnan(flights._drop(result, flight, lowest=False))


def started(needs):
    def exhibit(plan):
        data = yield needs
        return Evidence({"seen": {"any": [len(data)]}})

    return Started(exhibit, Plan())


def test_clips_are_rendered_for_all_exhibits_together():
    clip = Clip.of("looming-cube", size="40x30", speed=3.0)
    order = []
    half = model(3), 0.5
    each = [
        started({f"{TIMING}, x": lambda: order.append("timed")}),
        started({clip: {"lgmd": "lgmd", "half": half}, "more": lambda: True}),
        started({clip: all_versions(3)}),
    ]
    data = compute(needed(each), 1, lambda n, name: order.append(name))
    assert order == ["looming-cube 3", "more", "timed", f"{TIMING}, x"]
    found = data[clip]
    assert each[0].evidence(data).values == {"seen": {"any": [3]}}
    assert each[2].evidence(data).inputs == {None: {"looming-cube 3": found.sha256}}
    assert set(found.results) == {"lgmd", "half", *all_versions(3)}
    assert found.results["half"].n_cells == 20 * 15
    again = clips.run_clip(clip, {"x": model(3)})
    assert np.array_equal(found.results["set3/default"].mp, again.results["x"].mp, equal_nan=True)
    assert found.sha256 == again.sha256


def test_models_see_a_clip_together_as_each_by_itself(monkeypatch):
    speckles = np.random.default_rng(0).random((8, 40, 50)) < 0.01
    frames = np.where(speckles, np.uint8(255), np.uint8(0))
    monkeypatch.setattr(clips, "seen", lambda clip: clips.Seen(frames, {}, 6))
    models = {"set9": model(9), "twin": model(9), "half": (model(9), 0.5), "lgmd": "lgmd"}
    together = clips.run_clip(Clip.of("x"), models)
    assert together.collision_frame == 6
    for label, scale in (("set9", 1.0), ("twin", 1.0), ("half", 0.5), ("lgmd", 1.0)):
        alone = dlgmd_cli.run(frames, [label if label == "lgmd" else 9], fps=30.0, scale=scale)[0]
        assert np.array_equal(together.results[label].mp, alone.mp, equal_nan=True), label
        assert np.nanmax(alone.s_sum) > 0.0


def test_a_flight_has_its_phases_and_its_collision(monkeypatch):
    frames = np.zeros((6, 30, 40), np.uint8)
    given = []

    def fly(*scene, **options):
        given.append((scene, options))
        return Flight(frames, 30.0, None, None, 4, {"phases": {"hover": [0, 2], "yaw": [2, 4]}})

    monkeypatch.setattr(clips, "fly", fly)
    (clip,) = {clip for clip in flights.clips_of(Plan(quick=True), 3) if clip.seed == 2}
    seen = clips.seen(clip)
    assert given == [(("group3",), {"fps": 30.0, "size": "480x270", "seed": 2})]
    assert seen.phases == {"hover": (0, 2), "yaw": (2, 4)} and seen.collision_frame == 4


def test_a_rectified_lgmd_attenuates_what_stays():
    clip = Clip.of("translating-cubes", size="120x80", speed=2.0, frames=12)
    db = clips.rectified_lgmd_db(clip)
    assert np.isnan(db[:2]).all() and (db[2:] < 0.0).all() and (db[2:] > -3.0).all()


def test_a_pooled_attenuation_does_not_depend_on_a_floor():
    class Sums:
        frame, p_sum = np.arange(4), np.array([1.0, 1.0, 1.0, 0.0])
        s_sum = np.array([0.0, 0.0, 0.3, 0.0])

    assert stimuli.pooled_db(Sums) == pytest.approx(-10.0)
    assert stimuli.pooled_db(Sums, 0, 1) == -math.inf
    assert math.isnan(stimuli.pooled_db(Sums, 3, 3))


def test_peaks_are_small_and_separate():
    level = np.array([0, 0.1, 0, 0.3, 0.2, 0.35, 0, 0.04, 0, 0.9, 0])
    assert flights.small_peaks(level, 0, len(level)) == 3
    assert flights.small_peaks(level, 0, 3) == 1


def test_layers_of_moving_cells():
    p, s, g = (np.zeros((8, 8), np.float32) for _ in range(3))
    p[2:6, 2:6], s[2:6, 2:6], g[3:5, 3:5] = 0.5, 0.5, 2.0
    s[0, 0] = 0.5  # a cell on its own, which G removes
    spread_p, spread_s, sparse, others, gain = objects.shares_in(p, s, g, 0.01, 4)
    assert spread_p == spread_s == 0.0 and sparse == 1.0 and 0.0 < others < 1.0
    assert gain > 1.0
    s[2:6, 2:4] = 0.0
    assert objects.shares_in(p, s, g, 0.01, 4)[1] == pytest.approx(1.0)


def test_the_papers_own_table_has_the_values_that_the_paper_states():
    paper = np.array([[table4.PAPER_DA[r, x] for x in table4.SCALES] for r in table4.RADII])
    claims_ = SPECS["table4-da"].claims
    assert table4._rising(paper) == table4._turning(paper, last=4) == 1.0
    assert table4._best(paper, place=2) == pytest.approx(1.0, abs=0.01)  # two bounds, with r = 6
    assert table4._best(paper[1:], place=2) == pytest.approx(1.75, abs=0.01)
    assert table4._smaller(paper, last=2) == pytest.approx(1.02, abs=0.01)
    assert f"{table4._reduced(paper):.3g}" == claims_["table4-da-reduced"].paper.split()[0]
    assert table4._others_insufficient(paper) == float(claims_["table4-da-r2-only"].paper)
    assert math.isnan(table4._apart(np.zeros((4, 5)), paper))
    assert table4._apart(3.0 * paper, paper) == pytest.approx(3.0)


def test_the_ablation_replaces_one_part():
    for version in VERSIONS:
        own, constant, cell = (table4.parameters_of(8, version, part) for part in table4.PARTS)
        assert own == model(8, version)
        plain = DLGMD(constant).connections
        assert [*plain.inhibition] == [1] and np.count_nonzero(plain.excitation) == 13 * 13
        whole, alone = DLGMD(own).connections, table4.CellExcited(cell).connections
        assert np.count_nonzero(alone.excitation) == 1
        assert alone.excitation[6, 6] == whole.excitation[6, 6]
        assert [*alone.inhibition] == [*whole.inhibition]


def test_boxes_hold_the_objects_of_fig_8():
    clip = clips.reference_clip(reference_dir(), "ball-and-capsules")
    frames = clips.seen(clip).frames.astype(float)
    for index in (5, 20, 41):
        change = np.abs(frames[index] - frames[index - 1]) > 12
        boxes = objects.object_boxes(change.shape, index)
        assert change.sum() > 50 and all(change[box].any() for box in boxes)
        for box in boxes:
            change[box] = False
        assert change.mean() < 1e-4


def test_fig_8_is_judged_on_the_authors_frames_alone(tmp_path):
    plan = Plan(quick=True)
    values = Started(EXHIBITS["fig8"], plan).evidence({}).values
    assert set(values) == set(SPECS["fig8"].claims)
    assert all(
        Finding(SPECS["fig8"].claims[k], "", "any", (NAN,)).verdict == UNTESTABLE for k in values
    )
    (tmp_path / "ball_and_capsules").mkdir()
    assert plan_of("fig8", plan, tmp_path) == replace(plan, reference=tmp_path)
    assert plan_of("fig10", plan, tmp_path) == plan
    assert plan_of("table4-da", Plan(), None).is_larger


def section_of(plan, values, **more):
    claim = Claim("c", "<dfn>", "<b>x", 1.0, "above", "<u>", "<q>", why_not="<s>", paper="<p>7")
    spec = ExhibitSpec("fig1", "<script>", "&", "<h1>z", "<img>", {"c": claim})
    return Section(spec, plan, Evidence({"c": dict.fromkeys(EVERY, values)}, **more))


TIMES = {"r", "size", "order-r", "order-size"}


@pytest.mark.parametrize("is_idle", [True, False])
def test_times_are_judged_with_loading_and_without_on_an_idle_machine(is_idle):
    times = {(6, 1.0): (2.0, 8.0), (2, 1.0): (1.0, 4.0), (2, 0.02): (3.0, 1.0)}
    exhibit = Started(EXHIBITS["table4-time"], Plan(is_idle=is_idle))
    values = exhibit.evidence({TIMING: dict.fromkeys(("default", "equations"), times)}).values
    found = {
        key.removeprefix("table4-time-"): each["default"]
        for key, each in values.items()
        if "default" in each
    }
    found = {key: value for key, value in found.items() if "~" not in key}
    assert set(found) == TIMES
    expected = {"r": 1.0, "size": 0.0, "order-r": math.log(2.0) / math.log(3.0)}
    for key, value in expected.items():
        assert found[key] == pytest.approx([value]) if is_idle else math.isnan(found[key][0])


def test_a_larger_frame_takes_longer(tmp_path):
    with table4._panning(6) as path:
        (_, small), (whole, large) = (table4._timed(path, model(7), x) for x in (0.02, 1.0))
    assert 0.0 < small < large < whole


def test_a_report_says_why_a_claim_is_undecided_or_does_not_hold(tmp_path):
    spec = SPECS["table4-time"]
    claim = spec.claims["table4-time-size"]
    for value, words, others in (
        (math.nan, claim.why_undecided, claim.why_not),
        (0.1, claim.why_not, claim.why_undecided),
        (1.0, None, claim.why_undecided),
    ):
        evidence = Evidence({claim.id: {"default": [value]}})
        section = Section(replace(spec, claims={claim.id: claim}), Plan(True), evidence)
        page = Report([section], REMARKS, Plan(True), "x").text("report.html", tmp_path, {})
        assert others not in page and (words is None or words in page)
        kind = section.found[0].verdict
        share = "–" if kind == UNTESTABLE else f"{int(kind == YES)}/1"
        assert f">{share}</b></td>" in page


def test_texts_are_escaped():
    plan = Plan(quick=True)
    tables = {"<em>": [("<y>", 1.0)]}
    section = section_of(plan, [0.5, 2.0, 2.0, 2.0, 2.0, 2.0], tables=tables)
    remarks = {"objections": ["<em>"], "contradictions": ["<tt>"]}
    html = Report([section], remarks, plan, "dlgmd --out '<y>'").text(
        "report.html", None, {"cpu": "<kbd>"}
    )
    raws = "<dfn> <b>x <u> <q> <s> <p>7 <h1>z <img> <script> <y> <em> <tt> <kbd>"
    for raw in raws.split():
        assert raw not in html
    assert html.count("2 (0.5 to 2)") == len(VERSIONS) and "&lt;script&gt;" in html


def test_a_row_for_each_claim_version_and_seed(tmp_path):
    plan = Plan(quick=True)
    inputs = {seed: {"group1": f"sha{seed}"} for seed in plan.seeds}
    section = section_of(plan, [0.0, 2.0, NAN], inputs=inputs)
    machine = {"dlgmd": "3", "cpu": "a", "os": "b", "python": "c"}
    claims.write_claims(tmp_path / "claims.csv", section.found, machine)
    rows = csv_rows(tmp_path / "claims.csv")
    assert tuple(rows[0]) == claims.COLUMNS and len(rows) == 3 * len(VERSIONS)
    first, last = rows[0], rows[2]
    assert (first["seed"], first["value"], first["holds"]) == ("0", "0", NO)
    assert first["verdict"] == UNDECIDED
    assert (last["seed"], last["value"], last["holds"]) == ("2", "", UNDECIDED)
    assert first["input_sha256"] == "sha0" and first["input"] == "group1" and first["seeds"] == "3"
    assert (first["dlgmd"], first["commit"], first["cpu"], first["os"]) == ("3", "", "a", "b")


def test_what_does_not_depend_on_the_version_counts_in_each():
    spec = SPECS["fig5"]
    values = {"fig5-excitation": {"default": [0.9], "equations": [0.1]}, "fig5-rises": {"any": [1]}}
    values |= {"fig5-kernel-r4": {"any": [0.4]}, "fig5-kernel-r6": {"any": [0.65]}}
    section = Section(spec, Plan(), Evidence(values))
    assert section.held["default"] == {YES: 2, NO: 1}
    assert (
        section.held["equations"] == {YES: 1, NO: 2} and section.held["released-2020"].total() == 2
    )


def test_a_value_does_not_look_like_the_threshold_beside_it():
    claim = replace(SPECS["fig12"].claims["fig12b-sharper"], threshold=0.999)
    texts = [shown(Finding(claim, "", "", (value,))) for value in (0.998586, 0.999, 0.99)]
    assert texts == ["0.998586", "0.999", "0.99"]


def test_intervals_of_the_ablation_are_short():
    same, apart = np.full(6, math.inf), np.array([120.0, 190, 194, 200, 380, 2100])
    assert table4._shown(same) == "∞" and table4._shown(np.zeros(6)) == "0"
    assert table4._shown(apart) == "197 (120–2100)"


def test_numbers_for_readers():
    shown = [number(value) for value in (-1.2345, 9789.28, math.inf, NAN, 2e-7, -8e-16, ">10000")]
    assert shown == ["−1.23", "9789", "∞", "–", "2e−07", "0", ">10000"]
