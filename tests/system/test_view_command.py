"""`dlgmd view`: what a page holds, without a browser; tests/system/test_pages.py has one."""

import base64
import json
import os
import re
from pathlib import Path
from zipfile import ZipFile

import cv2
import numpy as np
import pytest
from conftest import (
    HEIGHT,
    N_FRAMES,
    WIDTH,
    csv_rows,
    make_result,
    read_video,
    result_of_level,
)

from dlgmd_cli.pages.gather import gather

pytest.importorskip("jinja2", reason="pages need Jinja2")
pytest.importorskip("plotly", reason="pages need Plotly")


def data_of(page: Path) -> dict:
    """What the page's script works with."""
    (text,) = re.findall(
        r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8"), re.S
    )
    return json.loads(text)


def film_of(page: Path, folder: Path, number=0):
    """Frame rate and frames of a film in a page."""
    (text,) = re.findall(
        rf'<script type="text/plain" id="film-{number}">(.*?)</script>', page.read_text("utf-8")
    )
    (folder / "film.mp4").write_bytes(base64.b64decode(text))
    return read_video(folder / "film.mp4")


def test_page_of_a_run(dlgmd, runs, clips, tmp_path):
    pytest.importorskip("av", reason="films need PyAV")
    spiking = ["--normalise", "sequence", "--param", "n_sp=1"]
    runs("run", clips / "loom.avi", "--set", 9, *spiking)
    made = dlgmd("view", "dlgmd-out/loom", "--collision-frame", 19, "--out", "page.html")
    assert (made.exit_code, made.output) == (0, "page.html\n")
    data = data_of(tmp_path / "page.html")
    (one,) = data["results"]
    assert data["collisions"] == [19] and data["video"] == "loom.avi" and one["label"] == "set9"
    assert one["frame"] == list(range(N_FRAMES)) and one["fps"] == 25.0
    assert one["alarms"] and len(one["spans"]) == len(one["sides"])
    rate, frames = film_of(tmp_path / "page.html", tmp_path)
    assert rate == 25.0 and len(frames) == N_FRAMES
    # Tinted where the square grows, near the end, and as the input was at the beginning.
    tints = [np.ptp(frame.astype(int), axis=2).max() for frame in frames]
    assert tints[1] < 20 and max(tints[-5:]) > 80


def test_a_folder_or_a_file_for_the_page_and_a_glob_that_meets_a_summary(dlgmd, runs):
    make_result(np.arange(9.0)).save("out/a")
    Path("out/summary.csv").write_text("video,status,error\nb.mp4,failed,no frame\n")
    assert dlgmd("view", "out/a", "--no-film", "--out", "pages").output.split() == [
        os.path.join("pages", "view-flight.html")
    ]
    made = runs("view", "out/a", "out/summary.csv", "--no-film", "--out", "x.html")
    assert "lists 1 failed video" in made.stderr
    index = " ".join(Path("x.html").read_text("utf-8").split())
    assert "<h1>1 video</h1>" in index and "no frame" in index


def test_what_a_mask_hides_is_dark(dlgmd, runs, clips, tmp_path):
    pytest.importorskip("av", reason="films need PyAV")
    mask = np.full((HEIGHT, WIDTH - 8), 255, np.uint8)
    mask[:, :8] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    area = ["--crop", f"{WIDTH - 8}x{HEIGHT}+8+0", "--mask", "mask.png"]
    runs("run", clips / "loom.avi", "--set", 9, *area)
    made = dlgmd("view", "dlgmd-out/loom", "--out", "page.html")
    assert (made.exit_code, made.stderr) == (0, "")
    _, frames = film_of(tmp_path / "page.html", tmp_path)
    assert frames[0].shape == (HEIGHT, WIDTH - 8, 3)
    assert frames[1][:, :7].mean() < 90 and frames[1][:, 9:].mean() > 150


def test_comparison_and_run_share_a_page(runs, clips, tmp_path):
    runs("compare", clips / "loom.mp4", "--set", 3, "--model", "lgmd")
    runs("run", clips / "loom.mp4", "--set", 3)
    runs("run", clips / "loom.mp4", "--set", 3, "--out", "again")
    made = runs("view", "dlgmd-out/loom", "again/loom", "--no-film")
    page = tmp_path / made.stdout.strip()
    labels = [one["label"] for one in data_of(page)["results"]]
    assert len(set(labels)) == 4 and labels[2] == "lgmd"
    assert [label.split(" ")[0] for label in labels] == ["set3", "set3", "lgmd", "set3"]
    assert "--no-film was given" in page.read_text("utf-8")


def test_names_are_escaped_and_missing_inputs_said(runs, tmp_path):
    evil = "</script><script>alert(1)</script>&\"'=x"
    result = make_result(np.linspace(1, 2, 8))
    result.record["input"]["path"] = f"/nowhere/{evil}.mp4"
    result.record["warnings"].append(evil)
    result.record["preset"] = evil
    result.save(tmp_path / "result")
    made = runs("view", "result", "--out", "page.html")
    assert "there is no such file" in made.stderr
    text = (tmp_path / "page.html").read_text("utf-8")
    assert "<script>alert" not in text and "No film:" in text and "/nowhere" not in text
    assert data_of(tmp_path / "page.html")["results"][0]["label"] == evil
    assert data_of(tmp_path / "page.html")["results"][0]["fps"] is None
    assert 'http-equiv="Content-Security-Policy" content="default-src \'none\'' in text


def test_a_moved_input_and_another_one(runs, clips, tmp_path):
    pytest.importorskip("av", reason="films need PyAV")
    runs("run", clips / "loom.avi", "--set", 9)
    record = tmp_path / "dlgmd-out/loom/run.yaml"
    record.write_text(record.read_text().replace(str(clips), "/moved"))
    made = runs("view", "dlgmd-out/loom", "--input", clips / "loom.avi", "--out", "a.html")
    assert not made.stderr and film_of(tmp_path / "a.html", tmp_path)[1]
    made = runs("view", "dlgmd-out/loom", "--input", clips / "short.avi", "--out", "b.html")
    assert "are not those of the result" in made.stderr


def rows_of(index: Path) -> dict:
    """The attributes `data-…` of each row of an index, by the video's name."""
    found = re.findall(r"<tr data-key=.*?>", index.read_text("utf-8"), re.S)
    rows = [dict(re.findall(r'data-([a-z]+)="(.*?)"', one)) for one in found]
    return {row["name"]: row for row in rows}


def test_index_of_a_batch(dlgmd, runs, clips, tmp_path, here):
    (tmp_path / "in").mkdir()
    for name in ("a.avi", "b%20#.avi"):
        (tmp_path / "in" / name).write_bytes((clips / "loom.avi").read_bytes())
    (tmp_path / "in/<b>.avi").write_bytes(b"no video")
    (tmp_path / "in/labels.csv").write_text("video,collision_frame,target\na.avi,19,\n")
    assert (
        dlgmd("batch", "in", "--set", 9, "--format=none", "--jobs", 1, "--out", "res").exit_code
        == 1
    )
    made = runs("view", "res", "--labels", "in/labels.csv", "--no-film", "--out", "all.html")
    assert "lists 1 failed video" in made.stderr
    text = (tmp_path / "all.html").read_text("utf-8")
    assert "&lt;b&gt;.avi" in text and "<b>.avi" not in text
    assert text.count("<svg") == 2 and "no film" in text and "1 collision" in text
    assert 'href="all-pages/b%2520%23.avi.html"' in text
    assert data_of(tmp_path / "all-pages/a.avi.html")["collisions"] == [19]
    assert data_of(tmp_path / "all-pages/b%20#.avi.html")["collisions"] == []


def test_the_pages_of_an_index_share_their_library(dlgmd, runs, clips, tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.avi").write_bytes((clips / "loom.avi").read_bytes())
        runs("run", f"{name}.avi", "--set", 9)
    folder = tmp_path / "all-pages"
    folder.mkdir()
    (folder / "plotly-1.0.0.min.js").write_text("// of pages that were made earlier")
    for more in ((), ("--overwrite",)):
        runs("view", "dlgmd-out", "--no-film", "--out", "all.html", *more)
        names = sorted(path.name for path in folder.iterdir())
        assert names[:3] == ["a.avi.html", "b.avi.html", "plotly-1.0.0.min.js"]
        assert len(names) == 4 and (folder / names[3]).stat().st_size > 1e6
        page = (folder / "a.avi.html").read_text("utf-8")
        assert len(page) < 100_000 and f'<script src="{names[3]}"></script>' in page
        assert len((tmp_path / "all.html").read_text("utf-8")) < 100_000
    made = dlgmd("view", "dlgmd-out/a", "--no-film", "--out", "one.html")
    text = (tmp_path / "one.html").read_text("utf-8")
    assert made.exit_code == 0 and len(text) > 1_000_000 and "<script src=" not in text


def test_the_index_counts_hits_as_evaluate_does(runs, tmp_path):
    def save(name, *alarms):
        level = np.full(200, 0.1)
        for start in alarms:
            level[start : start + 5] = 0.9
        result = result_of_level(level)
        result.record["input"] |= {"path": f"/videos/{name}.mp4", "width": 10, "height": 10}
        result.save(tmp_path / "res" / name)

    save("hit-and-false", 20, 110)  # raised at 21 and 111; 25 frames a second
    save("early", 30)
    save("after", 125)
    save("none")
    save("unknown", 50)
    (tmp_path / "res/summary.csv").write_text("video,status\n")
    labels = ["hit-and-false.mp4,120", "early.mp4,120", "after.mp4,120", "none.mp4,"]
    lines = ["video,collision_frame", *(f"/videos/{one}" for one in labels), ""]
    (tmp_path / "labels.csv").write_text("\n".join(lines))
    runs("view", "res", "--collisions", "labels.csv", "--no-film", "--out", "all.html")
    rows = rows_of(tmp_path / "all.html")
    score = {
        name: [row.get(key) for key in ("hits", "missed", "false")] for name, row in rows.items()
    }
    assert score == {
        "hit-and-false.mp4": ["1", "0", "1"],
        "early.mp4": ["0", "1", "1"],
        "after.mp4": ["0", "1", "0"],
        "none.mp4": ["0", "0", "0"],
        "unknown.mp4": [None] * 3,
    }
    assert [rows["early.mp4"][key] for key in ("alarms", "first")] == ["1", "1.24"]
    assert (
        '<span class="alarm">1.24 s</span>, normalised MP up to 0.90'
        in (tmp_path / "all.html").read_text()
    )
    runs("evaluate", "labels.csv", "--results", "res", "--out", "scores")
    told = csv_rows(tmp_path / "scores/evaluate.csv")[0]
    assert [told[key] for key in ("hits", "contacts", "false_alarms")] == ["1", "3", "2"]


@pytest.mark.parametrize(
    ("folders", "given", "paths"),
    [
        (["a"], ["a"], ["a.mp4"]),
        (["a", "day1/b"], ["."], ["a.mp4", "day1/b.mp4"]),
        # The folder that the batch searched, though all videos are below another one.
        (["day1/b", "day1/c"], ["."], ["day1/b.mp4", "day1/c.mp4"]),
        (["set3/day1/b", "set9/day1/b"], ["."], ["day1/b.mp4"]),
        (["day1/b", "day2/c"], ["day1/b", "day2/c"], ["day1/b.mp4", "day2/c.mp4"]),
    ],
)
def test_paths_for_labels_start_in_the_folder_of_the_videos(tmp_path, folders, given, paths):
    for folder in folders:
        result = make_result(np.linspace(1, 2, 8))
        below = folder.removeprefix("set3/").removeprefix("set9/")
        result.record["input"]["path"] = f"/far/in/{below}.mp4"
        result.save(tmp_path / folder)
    found = gather([tmp_path / one for one in given])
    assert [one.in_labels for one in found.inputs] == paths
    assert found.labels_folder == "/far/in" and "far" not in found.inputs[0].key


def test_an_archive_holds_the_index_and_its_pages(runs, dlgmd, clips, tmp_path):
    for name in ("a.avi", "b.avi"):
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_bytes((clips / "loom.avi").read_bytes())
    runs("batch", "in", "--set", 9, "--jobs", 1, "--out", "res")
    made = runs("view", "res", "--no-film", "--zip", "--out", "web/all.html")
    assert made.stdout == "web/all.html\nweb/all.zip\n"
    with ZipFile("web/all.zip") as archive:
        archive.extractall("elsewhere")
    files = {str(path.relative_to("web")) for path in Path("web").rglob("*") if path.is_file()}
    sent = {str(p.relative_to("elsewhere")) for p in Path("elsewhere").rglob("*") if p.is_file()}
    assert sent == files - {"all.zip"} and "all-pages/a.avi.html" in sent
    again = dlgmd("view", "res", "--no-film", "--zip", "--out", "web/other.html")
    assert again.exit_code == 0
    Path("web/other.html").unlink()
    refused = dlgmd("view", "res/a", "--no-film", "--zip", "--out", "web/other.html")
    assert refused.exit_code == 2 and "other.zip: already exists" in refused.stderr
