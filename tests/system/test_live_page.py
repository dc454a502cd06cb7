"""The page of `dlgmd live --serve` in a real browser: Chromium, driven by Playwright."""

import os
import signal
import socket
import subprocess
import sys

import cv2
import numpy as np
import pytest
from browsing import Reader
from conftest import read_video, write_video

pytestmark = pytest.mark.slow
pytest.importorskip("uvicorn", reason="the page needs Uvicorn")
pytest.importorskip("starlette", reason="the page needs Starlette")

SAMPLE = os.path.join(os.path.dirname(__file__), "../../sample_videos/group2.mp4")
WIDE = {"viewport": {"width": 1280, "height": 860}, "color_scheme": "light"}
PHONE = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
    "color_scheme": "dark",
}
# How many pixels of the image are tinted, and its checksum; neither while there is none.
PICTURE = """(() => {
    if (!picture.naturalWidth) return {};
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [picture.naturalWidth, picture.naturalHeight];
    const pen = canvas.getContext("2d");
    pen.drawImage(picture, 0, 0);
    const {data} = pen.getImageData(0, 0, canvas.width, canvas.height);
    let [tinted, sum] = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
        tinted += data[i] - data[i + 1] > 80;
        sum = (31 * sum + data[i]) % 1000003;
    }
    return {tinted, sum};
})()"""
# Pixels of a canvas in a colour of the page, with some tolerance.
PAINTED = """(name, colour) => {
    const canvas = document.getElementById(name);
    const pen = document.createElement("canvas").getContext("2d");
    pen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(colour);
    pen.fillRect(0, 0, 1, 1);
    const wanted = pen.getImageData(0, 0, 1, 1).data;
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4)
        count += [0, 1, 2].every(c => Math.abs(data[i + c] - wanted[c]) < 20) && data[i + 3] > 200;
    return count;
}"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A flight of 5 s that ends in an alarm."""
    _, frames = read_video(SAMPLE)
    frames = [cv2.resize(one, (320, 180), interpolation=cv2.INTER_AREA) for one in frames]
    return write_video(tmp_path_factory.mktemp("clip") / "<b>flights.avi", frames, fps=30.0)


@pytest.fixture
def watch(clip):
    """Start `dlgmd live --serve`: `watch(place, ...)` -> process, URL."""
    processes = []

    def start(place, *source):
        source = source or (clip, "--realtime", "--loop")
        process = subprocess.Popen(
            [sys.executable, "-m", "dlgmd_cli", "live", *source, "--serve", place],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        before, url = process.stderr.readline().split(" at ")
        assert before == "The page is"
        return process, url.strip()

    yield start
    for process in processes:
        process.kill()
        process.communicate()


class Watcher(Reader):
    """Who looks at the page of a live source."""

    def sees_motion(self):
        """Wait until the image has changed three times."""
        for _ in range(3):
            before = self.page.evaluate(PICTURE).get("sum", -1)
            self.until(f"(({{sum}}) => sum >= 0 && sum !== {before})({PICTURE})")

    def painted(self, name, colour):
        """Wait until a canvas has some pixels of a colour."""
        self.until(f"({PAINTED})('{name}', '--{colour}') > 30")


@pytest.mark.parametrize(
    ("place", "look"), [("0", WIDE), ("0.0.0.0:0", PHONE)], ids=["wide", "phone"]
)
def test_page(browser, watch, place, look):
    process, url = watch(place)
    assert ("?token=" in url) == (place != "0")
    reader = Watcher(browser, url, **look)
    page = reader.page
    reader.until("find('state').textContent === 'No alarm'")
    reader.until("find('name').textContent.endsWith('<b>flights.avi')")
    assert page.evaluate("document.documentElement.scrollWidth") == look["viewport"]["width"]
    reader.sees_motion()
    reader.until(f"{PICTURE}.tinted > 50")
    reader.painted("chart-expansion", "alarm")
    reader.painted("chart-level", "accent")
    reader.painted("chart-latency_ms", "ink")

    reader.until("find('state').textContent.startsWith('ALARM (expansion), ahead')")
    reader.painted("chart-ttc_s", "accent")
    reader.until("find('state').textContent === 'No alarm'")
    assert int(page.text_content("#alarms")) >= 1

    # Values beyond the chart lie on its edge, and one between two gaps is a dot.
    rows = "const kept = rows; "
    rows += "rows = [9, null, 1, null, -3, 2].map((v, i) => ({time_s: i / 30, expansion: v}))"
    chart = "const drawn = [], pen = {beginPath() {}, stroke() {}, moveTo() {}};"
    chart += "pen.lineTo = (x, y) => drawn.push(y);"
    chart += "curve({pen, x: t => t, y: v => v, low: -1, high: 5}, 'expansion');"
    chart += "rows = kept; return drawn"
    assert page.evaluate(f"(() => {{ {rows}; {chart} }})()") == [5, 1, -1, 2]

    page.click("#overlay")
    reader.until(f"picture.src.includes('overlay=0') && {PICTURE}.tinted === 0")
    # Many cells are active again at the next alarm.
    reader.until("find('state').className === 'alarm'")
    assert page.evaluate(PICTURE).get("tinted", 0) == 0
    assert reader.faults == []

    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) == 130
    *before, last = process.stderr.read().splitlines()
    # On a machine under load, warnings come first.
    assert last == "Interrupted." and not any("Traceback" in line for line in before)
    reader.until("find('state').textContent === 'Ended'")


def test_page_ends_with_its_file(browser, watch):
    process, url = watch("0", SAMPLE, "--realtime")
    reader = Watcher(browser, url, **WIDE)
    reader.until("find('state').textContent === 'Ended'")
    assert process.wait(timeout=20) == 0
    # It stays so, and the numbers are those of the whole file.
    reader.until("Date.now() - heard > SILENT_MS + 1500")
    assert reader.page.text_content("#state") == "Ended"
    assert reader.page.text_content("#alarms") == "1"
    assert reader.page.evaluate("rows.at(-1).time_s") == pytest.approx(155 / 30, abs=0.1)


def test_page_goes_on_by_itself(browser, watch):
    process, url = watch("0")
    reader = Watcher(browser, url)
    reader.sees_motion()
    reader.until("rows.length > 30")
    process.kill()
    process.wait(timeout=20)
    reader.until("find('state').textContent === 'Not connected'")
    watch(url.rstrip("/").rpartition(":")[2])
    reader.until("find('state').textContent === 'No alarm'")
    # The rows are those of the new session alone.
    reader.until("rows[0].frame === 0 && rows.length > 30")
    assert reader.page.evaluate("rows.every((row, i) => i === 0 || row.frame > rows[i - 1].frame)")
    reader.sees_motion()


def test_page_that_nobody_sees_asks_for_nothing(browser, watch):
    _, url = watch("0")
    reader = Watcher(browser, url)
    reader.sees_motion()
    change = """hidden => {
        Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
        document.dispatchEvent(new Event("visibilitychange"));
    }"""
    reader.page.evaluate(change, True)
    assert reader.page.evaluate("stream.readyState === 2 && !picture.src")
    # Not by the clock that looks for a lost connection, either.
    reader.until("Date.now() - heard > SILENT_MS + 1500")
    assert reader.page.evaluate("stream.readyState === 2 && !picture.src")
    reader.page.evaluate(change, False)
    reader.sees_motion()
    reader.until("find('state').textContent !== 'Not connected'")


def test_a_lost_source_is_told(browser, watch):
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    _, url = watch("0", f"http://someone:secret@127.0.0.1:{port}/video")
    reader = Watcher(browser, url)
    reader.until("find('state').textContent === 'Waiting for the first frame'")
    reader.until("find('message').textContent.includes('the source is lost')")
    text = reader.page.text_content("body main")
    assert "Blind" in text and "secret" not in text


def test_blindness_is_explained(browser, watch, tmp_path):
    """The image stays as it is: black is not grey."""
    covered = [np.full((90, 160, 3), 1, np.uint8)] * 300
    path = write_video(tmp_path / "covered.avi", covered, fps=30.0)
    _, url = watch("0", path, "--realtime")
    reader = Watcher(browser, url, **PHONE)
    reader.until("find('message').textContent.includes('black')")
    page = reader.page
    assert page.text_content("#state") == "Blind"
    message = page.text_content("#message")
    assert message == "Blind: its frames are black. A collision may raise no alarm."
    assert page.evaluate("getComputedStyle(picture).opacity") == "1"
