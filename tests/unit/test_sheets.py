"""Contact sheets of clips: which frames, what is said of them, and the files of `synth --sheet`."""

import math
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from flightscenes import Quick
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from dlgmd_cli.commands._sheets import draw_sheet
from dlgmd_cli.flights.scenes import SCENES
from dlgmd_cli.plots.clip_sheet import plot_clip_sheet
from dlgmd_cli.plots.style import VERMILION, save_figure
from dlgmd_cli.results.clip_sheet import ClipSheet, Still
from dlgmd_cli.stimuli.stills import Stills, chosen_frames

ROOT = Path(__file__).parents[2]
SMALL = ["--size", "64x48"]


def make_sheet(n=12, shape=(27, 48), *, collision=None, phase="cruise", name="flight"):
    """Frames of noise, ten apart; contact is in 1.234 s at first."""
    rng = np.random.default_rng(n)
    stills = tuple(
        Still(
            10 * k,
            10 * k / 30,
            rng.integers(0, 256, shape, np.uint8),
            phase,
            math.nan if k == collision else 1.234 - 0.1 * k,
            10.04 + k,
            k == collision,
        )
        for k in range(n)
    )
    time_s = None if collision is None else collision / 3
    frame = None if collision is None else 10 * collision
    return ClipSheet(name, 30.0, 10 * n, 7, stills, "wall" if phase else "", frame, time_s)


def words(figure):
    return [text.get_text() for text in figure.texts]


def captions(sheet):
    """Lines under each frame, without those above all of them."""
    texts = words(plot_clip_sheet(sheet))
    starts = [number for number, text in enumerate(texts) if text.startswith("frame ")]
    return [texts[a:b] for a, b in pairwise([*starts, len(texts)])]


def saved(sheet, path):
    """The picture, (H, W), and where its tiles are in it: slices of rows and of columns."""
    figure = plot_clip_sheet(sheet)
    save_figure(figure, path)
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    places = []
    for axes in figure.axes:
        box = axes.get_window_extent()
        sides = [picture.shape[0] - box.y1, picture.shape[0] - box.y0, box.x0, box.x1]
        top, bottom, left, right = map(round, sides)
        assert np.allclose(sides, (top, bottom, left, right), atol=0.02)
        places.append((slice(top, bottom), slice(left, right)))
    return picture, places


@pytest.fixture
def synth(dlgmd, monkeypatch):
    """Call `dlgmd synth quick --sheet`, with some seeds at fault."""

    def call(*arguments, **faults):
        monkeypatch.setitem(SCENES, "quick", Quick(**faults))
        return dlgmd("synth", "quick", "--sheet", *arguments)

    return call


# Which frames


@pytest.mark.parametrize(
    ("n_frames", "collision", "expected"),
    [
        (1, None, (0,)),
        (5, 3, (0, 1, 2, 3, 4)),
        (12, 11, tuple(range(12))),
        (13, None, (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12)),
        (156, 140, (0, 14, 28, 42, 56, 70, 84, 98, 112, 126, 140, 155)),
        (75, None, (0, 6, 13, 20, 26, 33, 40, 47, 53, 60, 67, 74)),
        (111, 1, (0, 1, 11, 22, 33, 44, 55, 66, 77, 88, 99, 110)),
        (111, 109, (0, 10, 21, 32, 43, 54, 65, 76, 87, 98, 109, 110)),
    ],
)
def test_frames_of_a_sheet(n_frames, collision, expected):
    assert chosen_frames(n_frames, collision) == expected


@given(st.data(), st.integers(1, 5000))
def test_frames_are_spread_evenly_with_first_last_and_collision(data, n_frames):
    collision = data.draw(st.none() | st.integers(0, n_frames - 1))
    frames = chosen_frames(n_frames, collision)
    assert len(frames) == min(n_frames, 12)
    assert frames[0] == 0 and frames[-1] == n_frames - 1
    middle = frames.index(collision) if collision is not None else 0
    for side in (frames[: middle + 1], frames[middle:]):
        steps = [b - a for a, b in pairwise(side)]
        assert all(step >= 1 for step in steps)
        assert max(steps, default=0) - min(steps, default=0) <= 1
    # As even as a frame that is given allows, but for one at the very ends.
    if collision is not None and 0.1 * n_frames < collision < 0.9 * n_frames:
        steps = [b - a for a, b in pairwise(frames)]
        assert max(steps) <= 2.1 * n_frames / 11 + 1


def test_only_frames_of_the_sheet_are_kept():
    scene, drawn = Quick(), np.zeros((16, 32), np.uint8)

    def frames():
        for index in range(19):
            drawn[:] = index  # the same array again
            yield drawn

    stills = Stills(scene, scene.configure({"--seed": 1}), "name")
    assert sum(1 for _ in stills.seen(frames())) == 19
    rows = list(scene.truth(scene.configure({"--seed": 1})))
    assert list(stills.known(rows)) == rows
    sheet = stills.sheet()
    chosen = chosen_frames(19, 12)
    assert tuple(still.frame for still in sheet.stills) == chosen
    assert tuple(int(still.image.max()) for still in sheet.stills) == chosen
    assert len(pickle.dumps(stills)) < 19 * 16 * 32
    assert [still.frame for still in sheet.stills if still.is_collision] == [12]
    assert [still.phase for still in sheet.stills][:3] == ["hover"] * 3
    assert sheet.stills[0].time_to_contact_s == 0.4 and sheet.stills[1].time_s == 1 / 30
    assert (sheet.target, sheet.collision_frame, sheet.collision_time_s) == ("wall", 12, 0.4)
    assert (sheet.name, sheet.fps, sheet.n_frames, sheet.seed) == ("name", 30.0, 19, 1)


# What is said of them


def test_captions_of_a_flight():
    first, second, third, fourth = captions(make_sheet(4, collision=2))
    assert first == ["frame 0 · 0.000 s", "cruise", "contact in 1.23 s · 10.0° across"]
    assert second == ["frame 10 · 0.333 s", "cruise", "contact in 1.13 s · 11.0° across"]
    assert third == ["frame 20 · 0.667 s", "cruise", "collision frame · 12.0° across"]
    assert fourth[2] == "contact in 0.93 s · 13.0° across"


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"time_to_contact_s": math.nan}, "10.0° across"),
        ({"angular_size_deg": math.nan}, "contact in 1.23 s"),
        ({"time_to_contact_s": 0.1}, "contact in 0.10 s · 10.0° across"),
        ({"time_to_contact_s": 1 / 30}, "contact in 0.033 s · 10.0° across"),
        ({"angular_size_deg": math.nan, "is_collision": True}, "collision frame"),
    ],
)
def test_what_is_not_defined_is_left_out(changed, expected):
    sheet = make_sheet(1)
    sheet = replace(sheet, stills=(replace(sheet.stills[0], **changed),))
    assert captions(sheet) == [["frame 0 · 0.000 s", "cruise", expected]]


def test_nothing_is_said_where_nothing_is_known():
    sheet = make_sheet(1, phase="")
    bare = Still(3, 0.1, sheet.stills[0].image)
    assert captions(replace(sheet, stills=(bare,))) == [["frame 3 · 0.100 s"]]


def test_title_and_outcome():
    title = "flight · 48×27 px · 30 frames/s · 40 frames · seed 7"
    sheet = make_sheet(4, collision=2)
    assert words(plot_clip_sheet(sheet))[:2] == [
        title,
        "target: wall · collision at 0.667 s, frame 20",
    ]
    late = replace(sheet, collision_frame=None)
    assert words(plot_clip_sheet(late))[1] == (
        "target: wall · collision at 0.667 s, after the last frame"
    )
    assert words(plot_clip_sheet(make_sheet(4)))[1] == "target: wall · no collision"
    assert words(plot_clip_sheet(make_sheet(4, phase="")))[:2] == [title, "frame 0 · 0.000 s"]
    odd = replace(sheet, fps=29.97, n_frames=1)
    assert " · 29.97 frames/s · 1 frame · " in words(plot_clip_sheet(odd))[0]


def test_the_collision_stands_out_without_colour():
    figure = plot_clip_sheet(make_sheet(12, collision=7))
    rims = [axes.spines["left"] for axes in figure.axes]
    widths = [rim.get_linewidth() for rim in rims]
    assert widths[7] >= 5 * max(widths[:7] + widths[8:])
    assert [rim.get_edgecolor()[:3] == to_rgb(VERMILION) for rim in rims].index(True) == 7
    boxed = [text.get_text() for text in figure.texts if text.get_bbox_patch() is not None]
    assert boxed == ["collision frame · 17.0° across"]
    plain = plot_clip_sheet(make_sheet(12))
    assert len({axes.spines["left"].get_linewidth() for axes in plain.axes}) == 1
    assert not any(text.get_bbox_patch() for text in plain.texts)


# The picture


def test_small_frames_are_enlarged_by_whole_factors(tmp_path):
    sheet = make_sheet(12, (27, 48), collision=3)
    picture, places = saved(sheet, tmp_path / "x.png")
    assert len(places) == 12
    for still, (rows, columns) in zip(sheet.stills, places, strict=True):
        expected = still.image.repeat(7, axis=0).repeat(7, axis=1)
        rim = 4 if still.is_collision else 2
        inner = picture[rows, columns][rim:-rim, rim:-rim]
        assert np.array_equal(inner, expected[rim:-rim, rim:-rim])


def test_large_frames_are_averaged(tmp_path):
    sheet = make_sheet(5, (768, 1364))
    picture, places = saved(sheet, tmp_path / "x.png")
    assert picture.shape[1] == 1432  # two columns
    for still, (rows, columns) in zip(sheet.stills, places, strict=True):
        expected = still.image.reshape(192, 4, 341, 4).mean(axis=(1, 3))
        shown = picture[rows, columns].astype(float)
        assert shown.shape == expected.shape
        assert np.abs(shown - expected)[2:-2, 2:-2].max() <= 0.5


def test_four_in_a_row(tmp_path):
    _, places = saved(make_sheet(6), tmp_path / "x.png")
    rows, columns = ([place[side].start for place in places] for side in (0, 1))
    assert rows[0] == rows[3] < rows[4] == rows[5]
    assert columns[0] < columns[1] < columns[2] < columns[3]
    assert columns[4:] == columns[:2]


@pytest.mark.parametrize(
    ("shape", "n"),
    [
        ((270, 480), 1),
        ((1080, 1920), 12),
        ((640, 480), 5),
        ((400, 64), 12),
        ((400, 16), 1),
        ((16, 400), 12),
        ((8190, 4), 5),
        ((4, 8190), 12),
    ],
)
def test_sizes_and_proportions(n, shape):
    figure = plot_clip_sheet(make_sheet(n, shape, collision=n - 1, name="x" * 200))
    width, height = figure.get_size_inches()
    assert width <= 7.16 + 0.001 and height < 9.5  # of a page
    for axes in figure.axes:
        box = axes.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0
        assert box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        drawn_height, drawn_width, _ = axes.get_images()[0].get_array().shape
        assert (box.width, box.height) == pytest.approx((drawn_width, drawn_height))
        if min(box.width, box.height) > 10:
            assert box.width / box.height == pytest.approx(shape[1] / shape[0], rel=0.05)


@pytest.mark.parametrize(
    ("n", "name", "shape"),
    [
        (1, "flight", (270, 480)),
        (1, "x" * 300, (400, 16)),
        (12, "x" * 300, (270, 480)),
        (12, "flight", (400, 16)),
        (12, "x" * 300, (16, 400)),
    ],
)
@pytest.mark.parametrize("phase", ["", "a phase of many words, and some more words"])
def test_words_neither_overlap_nor_leave_the_figure(n, name, phase, shape):
    figure = plot_clip_sheet(make_sheet(n, shape, collision=n - 1, phase=phase, name=name))
    renderer = FigureCanvasAgg(figure).get_renderer()
    tiles = [axes.get_window_extent() for axes in figure.axes]
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    for number, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1, words(figure)[number]
        assert box.y0 >= 0 and box.y1 <= figure.bbox.y1, words(figure)[number]
        for other in (*boxes[:number], *tiles):
            apart = box.x1 <= other.x0 or other.x1 <= box.x0
            assert apart or box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1


@pytest.mark.filterwarnings("ignore:Glyph")
def test_any_name_can_be_drawn(tmp_path):
    sheet = make_sheet(2, name="$x^{$ · \x07飞行\n", phase="$\\frac{$")
    save_figure(plot_clip_sheet(sheet), tmp_path / "x.png")
    assert words(plot_clip_sheet(sheet))[3] == "$\\frac{$"


def test_the_same_every_time(tmp_path):
    for name in "ab":
        draw_sheet(make_sheet(5, collision=4), tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


# The file


def test_a_sheet_beside_the_clip(synth):
    result = synth("--seed", 1, "--out", Path("new", "folder"))
    assert result.exit_code == 0 and result.stderr == ""
    paths = [Path(line) for line in result.stdout.splitlines()]
    names = ["quick.mp4", "quick.csv", "quick.yaml", "quick-sheet.png"]
    assert paths == [Path("new", "folder", name) for name in names]
    assert sorted(paths) == sorted(Path("new", "folder").iterdir())
    assert cv2.imread(str(paths[-1])).shape[1] <= 1432
    assert yaml.safe_load(paths[2].read_text())["sheet"] == "quick-sheet.png"


def test_there_is_none_unless_asked_for(synth, dlgmd):
    synth("--out", "with", "--lossless")
    result = dlgmd("synth", "quick", "--out", "without", "--lossless")
    assert len(result.stdout.splitlines()) == 3
    for suffix in ("avi", "csv"):
        a, b = (Path(folder, f"quick.{suffix}") for folder in ("with", "without"))
        assert a.read_bytes() == b.read_bytes()
    assert "sheet" not in yaml.safe_load(Path("without", "quick.yaml").read_text())
    assert not list(Path("without").glob("*.png"))


@pytest.mark.parametrize("scene", ["quick", "translating-cubes"])
def test_a_sheet_is_of_frames_as_they_were_rendered(dlgmd, monkeypatch, scene):
    monkeypatch.setitem(SCENES, "quick", Quick())
    sheets = set()
    for form in ([], ["--lossless"], ["--png"]):
        folder = Path("out", *form)
        result = dlgmd("synth", scene, "--sheet", "--out", folder, *SMALL, "--noise", 0.1, *form)
        assert result.exit_code == 0, result.output
        sheets.add((folder / f"{scene}-sheet.png").read_bytes())
    assert len(sheets) == 1


def test_what_is_drawn_is_what_was_rendered(synth, monkeypatch):
    drawn = []

    def draw(sheet, path):
        drawn.append(sheet)
        draw_sheet(sheet, path)

    monkeypatch.setattr("dlgmd_cli.commands.synth.draw_sheet", draw)
    assert synth("--png", "--seed", 3).exit_code == 0
    (sheet,) = drawn
    assert sheet.name == "quick" and len(sheet.stills) == 12
    for still in sheet.stills:
        kept = cv2.imread(f"quick/{still.frame:04d}.png", cv2.IMREAD_UNCHANGED)
        assert np.array_equal(still.image, kept)
    (collision,) = (still for still in sheet.stills if still.is_collision)
    assert (
        collision.frame == 13 == yaml.safe_load(Path("quick.yaml").read_text())["collision_frame"]
    )


@pytest.mark.parametrize("n_frames", [1, 5])
def test_short_clips(dlgmd, n_frames):
    result = dlgmd("synth", "looming-cube", "--sheet", *SMALL, "--frames", n_frames)
    assert result.exit_code == 0 and result.stderr == ""
    names = ["looming-cube.mp4", "looming-cube.csv", "looming-cube-sheet.png"]
    assert result.stdout.split() == names
    assert cv2.imread(names[-1]) is not None


def test_quiet_prints_paths_all_the_same(dlgmd):
    result = dlgmd("--quiet", "synth", "looming-cube", "--sheet", *SMALL, "--noise", 0.1)
    assert result.exit_code == 0 and result.stderr == ""
    assert result.stdout.split()[-1] == "looming-cube-sheet.png"


def test_refuses_to_replace_a_sheet(synth):
    Path("quick-sheet.png").write_bytes(b"mine")
    result = synth()
    assert result.exit_code == 2 and result.stdout == ""
    assert result.stderr.endswith(
        "Error: quick-sheet.png: it stands here already. Add --overwrite to replace it.\n"
    )
    assert [path.name for path in Path().iterdir()] == ["quick-sheet.png"]
    assert Path("quick-sheet.png").read_bytes() == b"mine"
    assert synth("--overwrite").exit_code == 0
    assert cv2.imread("quick-sheet.png") is not None


def test_a_folder_is_never_replaced(synth):
    Path("quick-sheet.png").mkdir()
    result = synth("--overwrite")
    assert result.exit_code == 2 and "quick-sheet.png: it stands here alrea" in result.stderr


def test_too_many_frames_are_refused_as_ever(synth):
    result = synth("--frames", 20)
    assert result.exit_code == 2 and "the flight ends after 19 frames" in result.stderr
    assert not list(Path().iterdir())


def test_a_sheet_that_cannot_be_written_keeps_all_files_away(synth, monkeypatch):
    def full(figure, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("dlgmd_cli.plots.style.save_figure", full)
    result = synth()
    assert result.exit_code == 1 and result.stderr.count("\n") == 1
    assert "it cannot be written (No space left on device)" in result.stderr
    assert not list(Path().iterdir())


def test_a_clip_that_fails_leaves_no_sheet(synth):
    result = synth(at_0="error")
    assert result.exit_code == 1 and not list(Path().iterdir())


# Of many flights


def many(folder="f"):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def test_every_flight_has_its_own(synth):
    result = synth("--count", 3, "--out", "f", "--jobs", 1)
    assert result.exit_code == 0 and result.stderr == ""
    assert result.stdout.split() == [str(Path("f", "labels.csv"))]
    sheets = [name for name in many() if name.endswith("-sheet.png")]
    assert sorted(sheets) == [f"quick-000{i}-sheet.png" for i in range(3)]
    assert len({many()[name] for name in sheets}) == 3
    assert "sheet" not in Path("f", "labels.csv").read_text()


def test_whoever_renders_draws_the_same(synth):
    synth("--count", 3, "--out", "f", "--jobs", 1)
    result = synth("--count", 3, "--out", "g", "--jobs", 2)
    assert result.exit_code == 0, result.stderr
    sheets = [
        {name: data for name, data in many(folder).items() if name.endswith("png")}
        for folder in "fg"
    ]
    assert sheets[0] == sheets[1] and len(sheets[0]) == 3


def test_flights_with_their_sheets_are_kept(synth, dlgmd):
    synth("--count", 2, "--out", "f", "--jobs", 1)
    before = many()
    result = synth("--count", 2, "--out", "f", at_0="error", at_1="error")
    assert result.exit_code == 0 and result.stderr == "2 of 2 flights were there already.\n"
    assert dlgmd("synth", "quick", "--count", 2, "--out", "f").exit_code == 0
    assert many() == before


def test_flights_without_sheets_are_rendered_again_only_if_told_to(synth, dlgmd, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    fleet = ["--count", 2, "--out", "f", "--jobs", 1, "--lossless"]
    dlgmd("synth", "quick", *fleet)
    before = many()
    result = synth(*fleet)
    assert result.exit_code == 2 and many() == before
    assert result.stderr.endswith(
        f"Error: {Path('f', 'quick-0000.yaml')}: another flight stands here (without a sheet). "
        "Add --overwrite to replace such flights, or choose another --out.\n"
    )
    assert synth(*fleet, "--overwrite").exit_code == 0
    assert len(many()) == 9
    assert before.items() - many().items() == {
        (name, before[name]) for name in ("quick-0000.yaml", "quick-0001.yaml")
    }


def test_a_sheet_of_an_earlier_flight_does_not_count(synth, dlgmd):
    fleet = ["--count", 1, "--out", "f"]
    synth(*fleet)
    earlier = many()["quick-0000-sheet.png"]
    dlgmd("synth", "quick", *fleet, "--size", "48x16", "--overwrite")
    result = synth(*fleet, "--size", "48x16")
    assert result.exit_code == 2 and "(without a sheet)" in result.stderr
    assert synth(*fleet, "--size", "48x16", "--overwrite").exit_code == 0
    assert many()["quick-0000-sheet.png"] != earlier


def test_a_strangers_picture_is_not_replaced(synth):
    Path("f").mkdir()
    Path("f", "quick-0001-sheet.png").write_bytes(b"mine")
    result = synth("--count", 2, "--out", "f")
    assert result.exit_code == 2 and "quick-0001-sheet.png: it stands here al" in result.stderr
    assert many() == {"quick-0001-sheet.png": b"mine"}


def test_a_lost_sheet_is_missed(synth):
    fleet = ["--count", 2, "--out", "f", "--jobs", 1]
    synth(*fleet)
    Path("f", "quick-0001-sheet.png").unlink()
    result = synth(*fleet)
    assert result.exit_code == 2 and "quick-0001.yaml: another flight" in result.stderr
    result = synth(*fleet, "--overwrite", at_0="error")
    assert result.exit_code == 0 and result.stderr == "1 of 2 flights were there already.\n"
    assert len(many()) == 9


# What it costs those who do not want it


def test_without_a_sheet_nothing_is_imported_to_draw(tmp_path):
    program = (
        "import sys\n"
        "from dlgmd_cli.app import main\n"
        "sys.argv = ['dlgmd', *'synth looming-cube --size 32x32 --frames 2 --out'.split(), '.']\n"
        "try:\n    main()\n"
        "except SystemExit: pass\n"
        "print('matplotlib' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["looming-cube.mp4", "looming-cube.csv", "False"]
