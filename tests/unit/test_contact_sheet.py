"""Contact sheets of clips: which frames, what is said of them, and the files of `synth --sheet`."""

import math
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import yaml_of
from flightscenes import Quick
from matplotlib.backends.backend_agg import FigureCanvasAgg

from dlgmd_cli.models.windows import Camera
from dlgmd_cli.plots.sheets import plot_contact_sheet, save_contact_sheet
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions
from dlgmd_cli.scenes.stimuli.clip import ClipOptions, ContactSheet, chosen_frames

Row = namedtuple("Row", "frame time_s phase time_to_contact_s angular_size_deg")


def make_sheet(n=12, shape=(27, 48), *, collision=None, phase="cruise", name="flight"):
    """Frames of noise, ten apart; contact is in 1.234 s at first."""
    rng = np.random.default_rng(n)
    images = [rng.integers(0, 256, shape, np.uint8) for _ in range(n)]
    rows = [
        Row(10 * k, k / 3, phase, math.nan if k == collision else 1.234 - 0.1 * k, 10.04 + k)
        for k in range(n)
    ]
    record = {"target": "wall", "collision_frame": None, "collision_time_s": None}
    if collision is not None:
        record |= {"collision_frame": 10 * collision, "collision_time_s": collision / 3}
    return ContactSheet(name, ClipOptions(seed=7), 10 * n, record if phase else {}, images, rows)


def captions(sheet):
    """Lines under each frame."""
    return [axes.get_xlabel().split("\n") for axes in plot_contact_sheet(sheet).axes]


@pytest.fixture
def synth(dlgmd, monkeypatch):
    """Call `dlgmd synth quick --sheet`, with some seeds at fault; sheets are quickly drawn."""

    def draw(sheet, path, dpi):
        path.write_bytes(cv2.imencode(".png", np.hstack(sheet.images))[1].tobytes())

    monkeypatch.setattr("dlgmd_cli.plots.sheets.save_contact_sheet", draw)

    def call(*arguments, **faults):
        monkeypatch.setitem(SCENES, "quick", Quick(**faults))
        return dlgmd("synth", "quick", "--sheet", *arguments)

    return call


def test_the_windows_of_the_expansion_are_drawn_in_a_flight():
    plain = make_sheet(2, (68, 120))
    flight = replace(plain, options=FlightOptions(camera_tilt_deg=10.0))
    boxes = [
        (round(box.get_y()), round(box.get_y() + box.get_height()))
        for box in plot_contact_sheet(flight).axes[1].patches
    ]
    assert boxes == [(top, bottom) for top, bottom, *_ in Camera(80.0, 10.0).windows((68, 120))]
    assert not plot_contact_sheet(plain).axes[1].patches


# Which frames


@pytest.mark.parametrize(
    ("n_frames", "collision", "expected"),
    [
        (1, None, (0,)),
        (12, 11, tuple(range(12))),
        (13, None, (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12)),
        (156, 140, (0, 14, 28, 42, 56, 70, 84, 98, 112, 126, 140, 155)),
        (111, 1, (0, 1, 11, 22, 33, 44, 55, 66, 77, 88, 99, 110)),
        (111, 109, (0, 10, 21, 32, 43, 54, 65, 76, 87, 98, 109, 110)),
    ],
)
def test_frames_of_a_sheet(n_frames, collision, expected):
    assert chosen_frames(n_frames, collision) == expected


# What is said of them


def test_captions_of_a_flight():
    first, _, third, _ = captions(make_sheet(4, collision=2))
    assert first == ["frame 0 · 0.000 s", "cruise", "contact in 1.23 s · 10.0° across"]
    assert third == ["frame 20 · 0.667 s", "cruise", "collision frame · 12.0° across"]


@pytest.mark.parametrize(
    ("left_s", "angle_deg", "expected"),
    [
        (math.nan, 10.04, ["10.0° across"]),
        (1.234, math.nan, ["contact in 1.23 s"]),
        (0.1, 10.04, ["contact in 0.10 s · 10.0° across"]),
        (1 / 30, math.nan, ["contact in 0.033 s"]),
        (math.nan, math.nan, []),
    ],
)
def test_what_is_not_defined_is_left_out(left_s, angle_deg, expected):
    row = Row(0, 0.0, "cruise", left_s, angle_deg)
    assert captions(replace(make_sheet(1), rows=[row]))[0][2:] == expected


@pytest.mark.parametrize(
    ("record", "parts"),
    [
        ({}, ["target: wall", "collision at 0.667 s", "frame 20"]),
        ({"collision_frame": None}, ["collision at 0.667 s", "after the last frame"]),
        ({"collision_time_s": None}, ["target: wall", "no collision"]),
        ({"target": None}, []),
    ],
)
def test_title_and_outcome(record, parts):
    sheet = make_sheet(4, collision=2)
    sheet = replace(
        sheet, record={**sheet.record, **record}, options=ClipOptions(fps=29.97, seed=7), n_frames=1
    )
    first, *outcome = plot_contact_sheet(sheet).get_suptitle().split("\n")
    assert first == "flight · 48×27 px · 29.97 frames/s · 1 frame · seed 7"
    assert len(outcome) == bool(parts) and all(part in outcome[0] for part in parts)


def test_the_collision_stands_out_without_colour():
    figure = plot_contact_sheet(make_sheet(12, collision=7))
    widths = [axes.spines["left"].get_linewidth() for axes in figure.axes]
    assert widths[7] >= 5 * max(widths[:7] + widths[8:])
    weights = [axes.xaxis.label.get_weight() for axes in figure.axes]
    assert [weight == "bold" for weight in weights].index(True) == 7 and weights.count("bold") == 1


# The image


def test_frames_are_shown_as_they_are_or_averaged_over_area():
    small = make_sheet(5)
    shown = plot_contact_sheet(small).axes[4].get_images()[0].get_array()
    assert np.array_equal(shown, small.images[4])
    large = make_sheet(5, (768, 1432))
    shown = plot_contact_sheet(large).axes[4].get_images()[0].get_array()
    assert shown.shape == (192, 358)
    mean = large.images[4].reshape(192, 4, 358, 4).mean(axis=(1, 3))
    assert np.abs(shown - mean).max() <= 0.5


@pytest.mark.parametrize(
    ("n", "shape", "name", "phase"),
    [
        (12, (270, 480), "x" * 300, "a phase of many words, and some more words"),
        (5, (640, 480), "flight", "hover"),
        (1, (400, 16), "x" * 300, "hover"),
    ],
)
def test_words_neither_overlap_nor_leave_the_figure(n, shape, name, phase):
    figure = plot_contact_sheet(make_sheet(n, shape, collision=n - 1, phase=phase, name=name))
    assert figure.get_size_inches()[0] <= 7.17 and figure.get_size_inches()[1] < 9.5  # of a page
    FigureCanvasAgg(figure).draw()
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == n
    tiles = [axes.get_window_extent() for axes in shown]
    words = [axes.xaxis.label.get_window_extent() for axes in shown]
    words.append(figure._suptitle.get_window_extent())
    for number, box in enumerate(words):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y0 >= 0 and box.y1 <= figure.bbox.y1
        for other in (*words[:number], *tiles):
            apart = box.x1 <= other.x0 or other.x1 <= box.x0
            assert apart or box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1
    for box in tiles:
        if min(box.width, box.height) > 10:
            assert box.width / box.height == pytest.approx(shape[1] / shape[0], rel=0.05)
    columns = {round(box.x0) for box in tiles}
    assert len(columns) == min(n, 4)


@pytest.mark.filterwarnings("ignore")
def test_any_name_can_be_drawn_and_the_same_every_time(tmp_path):
    sheet = make_sheet(2, name="$x^{$ · \x07飞行\n", phase="$\\frac{$")
    for name in "ab":
        save_contact_sheet(sheet, tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert captions(sheet)[0][1] == "$\\frac{$"


# The file


@pytest.mark.painted
def test_a_sheet_beside_the_clip_is_of_what_was_rendered(synth, monkeypatch):
    drawn = []

    def draw(sheet, path, dpi):
        drawn.append(sheet)
        save_contact_sheet(sheet, path, dpi)

    monkeypatch.setattr("dlgmd_cli.plots.sheets.save_contact_sheet", draw)
    result = synth("--seed", 3, "--png", "--dpi", 100, "--out", Path("new", "folder"))
    assert result.exit_code == 0 and result.stderr == ""
    paths = [Path(line) for line in result.stdout.splitlines()]
    names = ["quick", "quick.csv", "quick.yaml", "quick-sheet.png"]
    assert paths == [Path("new", "folder", name) for name in names]
    assert sorted(paths) == sorted(Path("new", "folder").iterdir())
    assert cv2.imread(str(paths[-1])).shape[1] <= 716
    record = yaml_of(paths[2])
    assert record["sheet"] == "quick-sheet.png"
    (sheet,) = drawn
    assert sheet.name == "quick" and len(sheet.images) == 12
    for image, row in zip(sheet.images, sheet.rows, strict=True):
        kept = cv2.imread(str(paths[0] / f"{row.frame:04d}.png"), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(image, kept)
    assert 13 in [row.frame for row in sheet.rows] and record["collision_frame"] == 13


def test_each_of_many_flights_has_its_own_and_keeps_it(synth):
    fleet = ["--count", 2, "--out", "f", "--jobs", 1]
    sheets = [Path("f", f"quick-000{number}-sheet.png") for number in range(2)]
    assert synth(*fleet).exit_code == 0
    before = [path.read_bytes() for path in sheets]
    assert before[0] != before[1]
    assert synth(*fleet, at_0="error", at_1="error").exit_code == 0
    sheets[0].unlink()
    result = synth(*fleet)
    assert result.exit_code == 2 and "(without a sheet)" in result.stderr
    assert synth(*fleet, "--overwrite").exit_code == 0
    assert [path.read_bytes() for path in sheets] == before
