"""The commands and the Python of the documents run as they are written, page by page, in order."""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import cv2
import pytest
from click.testing import CliRunner
from conftest import read_video, write_video
from documents import PAGES, ROOT, blocks, commands, commands_in, text_of

from dlgmd_cli.commands.app import cli

# CI runs the README's commands; pages of the laboratory are run by its own tests.
RUN = [page for page in PAGES if not page.startswith(("sample_videos/", "docs/lab/"))]
# What takes longest, with fewer of the same.
FEWER = {
    "sigma_e=0.2:2.0:0.2": "sigma_e=0.2:2.0:0.9",
    "sigma_i=0.5:6:0.5": "sigma_i=0.5:6:2.75",
    " --model lgmd-2006 --model emd-lplc2 --out benchmark": " --out benchmark",
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The samples at a third of their size, which the commands take as well."""
    folder = tmp_path_factory.mktemp("small")
    for path in (ROOT / "sample_videos").glob("*.mp4"):
        rate, frames = read_video(path)
        smaller = [cv2.resize(frame, (160, 90), interpolation=cv2.INTER_AREA) for frame in frames]
        write_video(folder / path.name, smaller, rate, fourcc="mp4v")
    return folder


@pytest.fixture
def reader(tmp_path, clips, monkeypatch):
    """A folder in which a reader types: the samples, and a flight of their own."""
    shutil.copytree(ROOT / "sample_videos", tmp_path / "sample_videos")
    shutil.copy(clips / "loom.mp4", tmp_path / "flight.mp4")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def write_files(page):
    """Write the files that a page shows."""
    for _, name, content in blocks(page):
        if name:
            Path(name).write_text(content, encoding="utf-8")


@pytest.mark.parametrize("page", [page for page in RUN if [*commands(page, "sh")]])
def test_commands_run_in_order(reader, small, page):
    shutil.copytree(small, "sample_videos", dirs_exist_ok=True)
    for kind, name, content in blocks(page):
        if name:
            Path(name).write_text(content, encoding="utf-8")
        for line, target in commands_in(content if kind == "sh" else ""):
            if line.startswith("dlgmd lab "):
                continue
            for many, few in FEWER.items():
                line = line.replace(many, few)
            result = CliRunner().invoke(cli, shlex.split(line)[1:], prog_name="dlgmd")
            assert result.exit_code == 0, f"{line}\n{result.output}"
            if target:
                Path(target).write_text(result.stdout, encoding="utf-8")


def scripts(page):
    """The Python of a page that is no file."""
    return [code for kind, name, code in blocks(page) if kind == "python" and not name]


@pytest.mark.parametrize("page", [page for page in RUN if scripts(page)])
def test_python_runs_as_written(reader, page):
    write_files(page)
    for number, code in enumerate(scripts(page)):
        script = reader / f"script{number}.py"
        flown = code.replace("VideoCapture(0)", 'VideoCapture("sample_videos/group2.mp4")')
        flown = flown.replace("time.monotonic()", "camera.get(cv2.CAP_PROP_POS_MSEC) / 1000")
        script.write_text(flown, encoding="utf-8")
        runpy.run_path(str(script))


def test_files_of_parameters_are_read(reader):
    write_files("docs/parameters.md")
    line = "run flight.mp4 --config short.yaml --format=none"
    result = CliRunner().invoke(cli, line.split(), prog_name="dlgmd")
    assert result.exit_code == 0, result.output


@pytest.mark.painted
def test_the_readme_tells_when_the_alarm_begins(reader, capsys):
    test_python_runs_as_written(reader, "README.md")
    frame, rule, ttc_s = capsys.readouterr().out.split()
    assert (
        rule == "expansion"
        and 1.0 < float(ttc_s) < 2.5
        and Path("overview.pdf").read_bytes().startswith(b"%PDF")
    )
    (told_s,) = re.findall(r"([\d.]+) s after\s+the\s+alarm begins", text_of("README.md"))
    assert float(told_s) == pytest.approx((140 - int(frame)) / 30, abs=0.01)


def test_a_loop_of_ones_own_brakes(reader, capsys):
    test_python_runs_as_written(reader, "docs/live.md")
    of_camera = capsys.readouterr().out.splitlines()
    assert len(of_camera) > 5 and of_camera[0].startswith("brake ahead")
    assert {line.partition(" ")[0] for line in of_camera} == {"brake", "blind:"}


def test_the_schematic_is_drawn_for_light_and_dark(tmp_path):
    subprocess.run([sys.executable, ROOT / "docs" / "schematic.py", tmp_path], check=True)
    drawn = {path.name: ElementTree.parse(path).getroot() for path in tmp_path.iterdir()}
    assert {*drawn} == {"model-light.svg", "model-dark.svg"}
    for name, root in drawn.items():
        kept = ElementTree.parse(ROOT / "docs" / "_static" / name).getroot()
        assert root.get("viewBox") == kept.get("viewBox")
        assert f"docs/_static/{name}" in text_of("README.md")
        assert f"_static/{name}" in text_of("docs/model.md")
