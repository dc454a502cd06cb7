"""Pages in a real browser: Chromium, driven by Playwright. Skipped where one of them is absent."""

import csv
import os
import shutil

import pytest
from browsing import Reader

pytestmark = pytest.mark.slow
pytest.importorskip("plotly", reason="pages need Plotly")
pytest.importorskip("av", reason="films need PyAV")

SAMPLE = os.path.join(os.path.dirname(__file__), "../../sample_videos/looming-cube.mp4")


@pytest.fixture
def page_file(dlgmd, tmp_path):
    """A page of two models of a looming cube."""
    dlgmd("compare", SAMPLE, "--set", 3, "--set", 9, "--no-plots", "--collision-frame", 74)
    made = dlgmd("view", "dlgmd-out/looming-cube", "--out", "page.html")
    assert made.exit_code == 0, made.output
    return tmp_path / "page.html"


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
    assert page.evaluate("root.dataset.theme") == scheme
    page.keyboard.press("a")
    reader.at(page.evaluate("result().onsets[0]"))
    assert page.is_visible("#banner")
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
    page.touchscreen.tap(250, plot["y"] + 0.25 * plot["height"])
    reader.until("row > 20")
    reader.at(page.evaluate("row"))
    # The film stays in sight above the curves.
    box = page.locator("#film").bounding_box()
    assert box["y"] >= 0 and box["y"] + box["height"] < 420
    page.tap("#open")
    assert page.locator("#drawer").bounding_box()["width"] <= 390
    assert not reader.faults


def test_hostile_names(browser, dlgmd, tmp_path):
    name = "<img src=x onerror=alert(1)>.mp4"
    shutil.copy(SAMPLE, tmp_path / name)
    dlgmd("run", tmp_path / name, "--no-plots")
    made = dlgmd("view", tmp_path / "dlgmd-out", "--out", "all.html")
    assert made.exit_code == 0, made.output
    reader = Reader(browser, f"file://{tmp_path}/all.html", allowed=("file:",))
    page = reader.page
    page.on("dialog", lambda dialog: (reader.faults.append("dialog"), dialog.dismiss()))
    page.click("h2 a")
    assert page.text_content("h1") == name
    page.click("text=All videos")
    assert page.text_content("h2") == name
    assert not reader.faults
