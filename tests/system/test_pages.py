"""Pages in a real browser: Chromium, driven by Playwright. Skipped where one of them is absent."""

import csv
import os
import shutil
import time

import numpy as np
import pytest
from browsing import Reader
from click.testing import CliRunner
from conftest import result_of_level

from dlgmd_cli.commands.app import cli

pytestmark = pytest.mark.slow
pytest.importorskip("plotly", reason="pages need Plotly")
pytest.importorskip("av", reason="films need PyAV")

SAMPLE = os.path.join(os.path.dirname(__file__), "../../sample_videos/looming-cube.mp4")


def made_in(folder, *lines):
    """Run commands in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in lines:
            result = CliRunner().invoke(cli, line.split(), prog_name="dlgmd")
            assert result.exit_code == 0, result.output


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """A page of two models of a looming cube; not to be written to."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copy(SAMPLE, folder / "looming-cube.mp4")
    compare = "compare looming-cube.mp4 --set 3 --set 9 --collision-frame 74 --format=none"
    made_in(folder, compare, "view dlgmd-out/looming-cube --out page.html")
    return folder / "page.html"


class Viewer(Reader):
    """Who looks at a film and its curves."""

    def __init__(self, browser, path, **look):
        super().__init__(browser, f"file://{path}", **look)
        self.until("film.readyState >= 2 && plot._fullLayout !== undefined")

    def at(self, row):
        """Wait until film, slider and the line in the curves are all at a row."""
        self.until(f"row === {row} && Number(slider.value) === {row} && !film.seeking")
        self.until(f"Math.floor(film.currentTime * result().fps) === {row}")
        self.until(
            "(({_offset, _length, range: [from, to]}) => Math.abs(parseFloat(head.style.left)"
            " - plot.offsetLeft - _offset - _length"
            f" * (result().time[{row}] - from) / (to - from)))(plot._fullLayout.xaxis) < 0.1"
        )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_move_together(browser, page_file, scheme):
    reader = Viewer(
        browser, page_file, viewport={"width": 1280, "height": 860}, color_scheme=scheme
    )
    page = reader.page
    reader.at(page.evaluate("result().onsets[0]"))
    assert page.is_visible("#banner")
    for event, theme in (("beforeprint", "light"), ("afterprint", scheme)):
        page.evaluate(f"dispatchEvent(new Event('{event}'))")
        assert page.evaluate("root.dataset.theme") == theme
    page.keyboard.press("Home")
    page.keyboard.press("a")
    reader.at(page.evaluate("result().onsets[0]"))
    page.keyboard.press("c")
    reader.at(74)
    page.keyboard.press("ArrowLeft")
    reader.at(73)
    box = page.locator("#plot").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 150)
    reader.until("row > 20 && row < 50")
    reader.at(page.evaluate("row"))
    page.locator("#slider").fill("10")
    reader.at(10)
    page.keyboard.press("Space")
    reader.until("row > 20")
    page.keyboard.press("Space")
    reader.until("film.paused")
    page.keyboard.press("2")
    reader.until("chosen === 1 && film.readyState >= 2")
    reader.at(page.evaluate("row"))
    page.keyboard.press("d")
    assert page.is_visible("#drawer section:visible >> text=Parameters of dlgmd")
    assert not reader.faults


def test_labels_are_saved(browser, page_file, tmp_path):
    reader = Viewer(browser, page_file)
    page = reader.page
    page.keyboard.press("End")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("l")
    page.fill("#label-list input", '=1+1, a "board"')
    with page.expect_download() as saved:
        page.click("#save")
    assert saved.value.suggested_filename == "labels.csv"
    saved.value.save_as(tmp_path / "labels.csv")
    with open(tmp_path / "labels.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [
        ["video", "collision_frame", "target"],
        ["looming-cube.mp4", "73", './=1+1, a "board"'],
        ["looming-cube.mp4", "74", ""],
    ]
    assert not reader.faults


def test_labels_are_kept_and_leaving_with_new_ones_asks(browser, page_file):
    reader = Viewer(browser, page_file)
    page, asked = reader.page, []
    page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
    page.keyboard.press("End")
    page.keyboard.press("l")
    page.fill("#label-list input", "wall")
    page.reload()
    assert asked == ["beforeunload"]
    reader.until("labels.length === 1")
    assert page.input_value("#label-list input") == "wall"
    page.click("#save")
    page.reload()
    assert asked == ["beforeunload"] and page.evaluate("labels.length") == 1
    page.click("#label-list button:last-child")
    page.reload()
    assert asked == ["beforeunload"] and page.evaluate("labels.length") == 0


@pytest.fixture(scope="module")
def indexed(tmp_path_factory):
    """A folder with an index of a cube that looms, below =x, and of one that moves across."""
    folder = tmp_path_factory.mktemp("index")
    for name, place in (("looming-cube", "in/=x/a, b.mp4"), ("translating-cubes", "in/c.mp4")):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(os.path.join(os.path.dirname(SAMPLE), f"{name}.mp4"), folder / place)
    batch = "batch in --set 9 --jobs 1 --out res --format=none"
    made_in(folder, batch, "view res --no-film --out web/all.html")
    return folder


@pytest.fixture
def index_file(indexed, tmp_path):
    """The index in a copy of that folder."""
    shutil.copytree(indexed, tmp_path, dirs_exist_ok=True)
    return tmp_path / "web/all.html"


def open_video(reader, link):
    """Follow a link of an index, which leaves its mark, to a video, which sees it.

    A browser that is short of time may keep nothing from one page to the next: the test skips.
    """
    marks = "Object.keys(localStorage).filter(key => key.startsWith(INDEX))"
    assert reader.page.evaluate(marks)
    reader.page.wait_for_timeout(500)
    reader.follow(link)
    reader.until("plot._fullLayout !== undefined")
    until_s = time.monotonic() + 10.0
    while not reader.page.evaluate(marks):
        if time.monotonic() > until_s:
            pytest.skip("this browser keeps nothing from one page to the next")
        reader.page.reload()
        reader.until("plot._fullLayout !== undefined")
    assert reader.page.evaluate("isGathered()")


def open_index(browser, path, **look):
    reader = Reader(browser, f"file://{path}", allowed=("file:",), **look)
    reader.asked = []
    reader.page.on("dialog", lambda dialog: (reader.asked.append(dialog.type), dialog.accept()))
    return reader


def test_the_index_makes_one_table_of_labels_that_evaluate_reads(
    browser, index_file, runs, tmp_path
):
    reader = open_index(browser, index_file)
    page = reader.page
    assert page.is_disabled("#save") and "No labels" in page.text_content("#summary")
    open_video(reader, "text=a, b.mp4")
    page.keyboard.press("End")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("l")
    frame = page.evaluate("labels[0].frame")
    reader.until("by('keeping').textContent.includes('the index downloads those of all')")
    reader.follow("text=All videos")  # which asks nothing, as the index has them
    reader.until("document.querySelector('#summary')?.textContent.startsWith('1 label in 1 of 2')")
    assert not reader.asked
    page.reload()
    assert reader.asked == ["beforeunload"]
    assert page.text_content("#summary") == "1 label in 1 of 2 videos, not downloaded yet."
    assert page.text_content(".yours:visible") == f"your label: frame {frame}"
    assert "in the folder “in”" in page.text_content("#labels")
    page.check("#rest")
    with page.expect_download() as saved:
        page.click("#save")
    assert page.text_content("#summary") == "1 label in 1 of 2 videos."
    page.reload()
    assert len(reader.asked) == 1
    assert saved.value.suggested_filename == "labels.csv"
    saved.value.save_as(tmp_path / "in/labels.csv")
    with open(tmp_path / "in/labels.csv", newline="") as file:
        rows = list(csv.reader(file))[1:]
    assert rows == [["./=x/a, b.mp4", str(frame), ""], ["c.mp4", "", ""]]
    for more in (("--results", "res"), ("--set", 9, "--jobs", 1)):
        scored = runs("evaluate", "in/labels.csv", *more, "--out", f"{more[0]}.out")
        assert scored.stderr == ""
        with open(f"{more[0]}.out/evaluate.csv", newline="") as file:
            told = next(csv.DictReader(file))
        assert [told[key] for key in ("videos", "contacts")] == ["2", "1"]
    assert not reader.faults


def test_labels_that_are_known_keep_their_words(browser, index_file, runs, tmp_path):
    header = "video,collision_frame,target,kind,sure"
    table = [header, "=x/a\\, b.mp4,70.0,wall,real,yes", "c.mp4,,,rendered,"]
    text = "\n".join(table).replace("=x/a\\, b.mp4", '"./=x/a, b.mp4"')
    (tmp_path / "in/labels.csv").write_text(text + "\n")
    made = ("view", "res", "--no-film", "--labels", "in/labels.csv", "--out", "web/all.html")
    runs(*made, "--overwrite")
    reader = open_index(browser, index_file)
    page = reader.page
    open_video(reader, "text=c.mp4")
    page.keyboard.press("End")
    page.keyboard.press("l")
    page.fill("#label-list input", "gate")
    frame = page.evaluate("labels[0].frame")
    reader.follow("text=All videos")
    reader.until("by('summary').textContent.startsWith('1 label in 1 of 2')")
    with page.expect_download() as saved:
        page.click("#save")
    saved.value.save_as(tmp_path / "new.csv")
    assert (tmp_path / "new.csv").read_text().splitlines() == [
        header,
        '"./=x/a, b.mp4",70,wall,real,yes',
        f"c.mp4,{frame},gate,rendered,",
    ]


def test_where_a_browser_keeps_nothing_the_page_says_so(browser, page_file):
    context = browser.new_context()
    context.add_init_script(
        "delete window.localStorage; Object.defineProperty(window,"
        "'localStorage', {get() { throw new Error(); }})"
    )
    page, asked = context.new_page(), []
    page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
    page.goto(f"file://{page_file}")
    page.keyboard.press("l")
    assert "does not keep them" in page.text_content("#keeping")
    page.reload()
    assert asked == ["beforeunload"] and page.is_hidden("#labels")


def test_the_index_filters_and_sorts_by_keyboard(browser, index_file):
    reader = open_index(browser, index_file, viewport={"width": 390, "height": 844})
    page = reader.page
    assert page.evaluate("document.documentElement.scrollWidth") == 390

    def names():
        return page.locator("tr:visible .name a").all_text_contents()

    assert names() == ["a, b.mp4", "c.mp4"]
    page.keyboard.press("Tab")  # the button of the theme, then the fields
    page.keyboard.press("Tab")
    page.keyboard.type("C.M")
    assert names() == ["c.mp4"] and page.text_content("#count") == "1 of 2 shown"
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowDown")  # with alarms
    assert names() == ["a, b.mp4"]
    page.keyboard.press("ArrowDown")  # without alarms
    assert names() == ["c.mp4"]
    page.select_option("#which", "")
    page.evaluate("rows[1].dataset.first = '0.5'")
    page.select_option("#order", "first")
    assert names() == ["c.mp4", "a, b.mp4"]
    page.select_option("#order", "")
    assert names() == ["a, b.mp4", "c.mp4"]
    assert not reader.faults


def test_the_folder_of_an_index_may_move_but_a_page_needs_its_library(
    browser, index_file, tmp_path
):
    moved = tmp_path / "elsewhere"
    index_file.parent.rename(moved)
    reader = open_index(browser, moved / "all.html")
    reader.follow("text=c.mp4")
    reader.until("plot._fullLayout !== undefined")
    assert not reader.faults
    (library,) = (moved / "all-pages").glob("plotly-*.js")
    library.unlink()
    reader.page.reload()
    assert f"The curves need the file {library.name}" in reader.page.text_content("#plot")
    reader.page.keyboard.press("ArrowRight")  # everything else works
    reader.until("Number(slider.value) === 1")


def test_on_a_phone(browser, page_file):
    reader = Viewer(
        *(browser, page_file),
        viewport={"width": 390, "height": 844},
        is_mobile=True,
        has_touch=True,
    )
    page = reader.page
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.evaluate("scrollTo(0, 400)")
    plot = page.locator("#plot").bounding_box()
    # Below the film, which covers the upper part of the curves, and within a panel.
    page.touchscreen.tap(250, plot["y"] + 0.65 * plot["height"])
    reader.until("row > 20")
    reader.at(page.evaluate("row"))
    # The film stays in sight above the curves.
    box = page.locator("#film").bounding_box()
    assert box["y"] >= 0 and box["y"] + box["height"] < 420
    page.tap("#open")
    assert page.locator("#drawer").bounding_box()["width"] <= 390
    assert not reader.faults


def test_hostile_names(browser, runs, tmp_path):
    name = "<img src=x onerror=alert(1)>.mp4"
    shutil.copy(SAMPLE, tmp_path / name)
    runs("run", tmp_path / name)
    runs("view", tmp_path / "dlgmd-out", "--out", "all.html")
    reader = Reader(browser, f"file://{tmp_path}/all.html", allowed=("file:",))
    page = reader.page
    page.on("dialog", lambda dialog: (reader.faults.append("dialog"), dialog.dismiss()))
    open_video(reader, ".name a")
    assert page.text_content("h1") == name
    page.keyboard.press("l")
    page.fill("#label-list input", name)
    reader.follow("text=All videos")
    assert page.text_content(".name a") == name
    assert not reader.faults


def test_labels_are_moved_removed_and_restored(browser, index_file, runs, tmp_path):
    """Those of a table, too: what it says besides the frame moves along."""
    table = 'video,collision_frame,target,sure\n"./=x/a, b.mp4",70,wall,yes\nc.mp4,,,\n'
    (tmp_path / "in/labels.csv").write_text(table)
    made = ("view", "res", "--no-film", "--labels", "in/labels.csv", "--out", "web/all.html")
    runs(*made, "--overwrite")
    reader = open_index(browser, index_file)
    page = reader.page
    open_video(reader, "text=a, b.mp4")

    def shown():
        """The user's, then those of the table."""
        lists = page.evaluate("[labels, knownLabels()]")
        return [[[one["frame"], one["target"]] for one in found] for found in lists]

    known = [[70, "wall"]]
    assert shown() == [[], known] and page.is_disabled("#undo")
    assert page.text_content("#open-known") == "Known collisions (1)" and page.is_hidden("#known")
    page.click("#open-known")
    assert page.text_content("#known-list span") == "wall"
    page.keyboard.press("Home")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("l")
    assert shown() == [[[3, ""]], known]
    page.keyboard.press("ArrowRight")
    page.keyboard.press("m")  # the nearest
    assert shown() == [[[4, ""]], known]
    page.click("#known-list >> text=Move here")  # over the other one
    assert shown() == [[[4, "wall"]], []]
    page.keyboard.press("Control+z")
    assert shown() == [[[4, ""]], known]
    page.click("#label-list >> text=Remove")
    if page.is_hidden("#known"):  # it closed when nothing was left in it
        page.click("#open-known")
    page.click("#known-list >> text=Remove")
    assert shown() == [[], []]
    page.click("#undo")
    page.keyboard.press("End")
    page.keyboard.press("m")
    last = page.evaluate("result().frame[row]")
    assert shown() == [[[last, "wall"]], []]
    page.fill("#label-list input", "gate")
    page.click("#undo")
    assert shown() == [[[last, "wall"]], []]
    page.reload()
    assert shown() == [[[last, "wall"]], []]
    reader.follow("text=All videos")
    reader.until("by('summary').textContent.startsWith('1 label and 1 change')")
    assert page.text_content(".yours:visible") == f"your label: frame {last}; no longer: frame 70"
    with page.expect_download() as saved:
        page.click("#save")
    saved.value.save_as(tmp_path / "new.csv")
    assert (tmp_path / "new.csv").read_text().splitlines() == [
        "video,collision_frame,target,sure",
        f'"./=x/a, b.mp4",{last},wall,yes',
        "c.mp4,,,",
    ]
    assert not reader.faults


def test_a_page_shows_every_extreme_of_its_table(browser, tmp_path):
    """Of 15,000 rows, all of a curve, and of what lies beyond its axis that it does."""
    n = 15_000
    rng = np.random.default_rng(1)
    result = result_of_level(rng.uniform(0.2, 0.45, n), time_s=np.arange(n) / 30)
    columns = {"expansion": rng.normal(0.3, 0.4, n), "ttc_s": rng.uniform(0.5, 0.6, n)}
    columns["attenuation_db"] = rng.normal(-7, 2, n)
    columns["expansion"][[7_000, 10_001]] = -9.0, 9.0
    columns["ttc_s"][4_000:5_000] = np.nan
    columns["ttc_s"][4_500] = 0.02
    for name, values in columns.items():
        result.rows[name] = values
    result.save(tmp_path / "long")
    made_in(tmp_path, "view long --no-film --out long.html")
    reader = Reader(browser, f"file://{tmp_path}/long.html")
    reader.until("window.plot !== undefined && plot.data !== undefined")
    drawn = reader.page.evaluate(
        "['y', 'y4', 'y5', 'y2'].map(axis => plot.data.find(one => one.yaxis === axis))"
    )
    tables = [result.mp_abs, *columns.values()]
    for line, table, digits in zip(drawn, tables, (4, 4, 4, 3), strict=True):
        shown = np.full(n, np.nan)
        row = np.rint(np.array(line["x"]) * 30).astype(int)
        shown[row] = np.array(line["customdata"], float)
        for part, of_table in zip(np.split(shown, 15), np.split(table, 15), strict=True):
            for extreme in (np.nanmin, np.nanmax):
                assert extreme(part) == pytest.approx(extreme(of_table), abs=10.0**-digits)
    expansion, ttc = drawn[1:3]
    assert (min(expansion["y"]), max(expansion["y"])) == (-1, 2.6)
    bars, words = reader.page.evaluate("""['shapes', 'annotations'].map(
        part => plot.layout[part].filter(one => one.yref === 'y4 domain'))""")
    assert [(one["text"], one["y"]) for one in words] == [("> 2.6", 1), ("< −1", 0)]
    low = [float(part.split(",")[0]) for part in bars[1]["path"].split("M")[1:]]
    assert low == pytest.approx((np.flatnonzero(columns["expansion"] < -1) - 0.5) / 30)
    lone = [y for y, size in zip(ttc["y"], ttc["marker"]["size"], strict=True) if size]
    assert lone == [0.02] and reader.faults == []
