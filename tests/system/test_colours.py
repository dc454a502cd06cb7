"""Tags of colours, such as those of HDR: OpenCV converts the levels, so PyAV reads such files."""

import sys

import numpy as np
import pytest

pytest.importorskip("av", reason="PyAV writes these videos")

from conftest import looming_frames, yaml_of
from damaged import encode

from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.video.containers import stated_by
from dlgmd_cli.video.opening import open_video

HLG, PQ, SDR = (9, 18, 9), (9, 16, 9), (1, 1, 1)
RAMP = [np.tile(np.arange(16, 236, dtype=np.uint8), (16, 1))] * 2


def tagged(path, colours, frames=RAMP, colour_range=1):
    """A video of grey frames without loss, with these tags."""
    codec = "ffv1" if path.suffix == ".mkv" else "libx264"
    options = {"qp": "0"} if codec == "libx264" else {}
    return encode(path, frames, codec, options=options, colours=colours, colour_range=colour_range)


@pytest.mark.parametrize(
    ("name", "colours"), [("x.mp4", HLG), ("x.mkv", PQ), ("x.ts", PQ), ("x.h264", HLG)]
)
def test_hdr_answers_as_the_same_pixels_without_a_tag(dlgmd, tmp_path, name, colours):
    frames = [frame // 4 + 160 for frame in looming_frames()]
    answers = []
    for folder, tags in {"sdr": SDR, "hdr": colours}.items():
        (tmp_path / folder).mkdir()
        path = tagged(tmp_path / folder / name, tags, frames)
        decoder = () if tags == colours else ("--decoder", "pyav")
        done = dlgmd("run", path, *decoder, "--format", "none", "-o", folder)
        assert done.exit_code == 0, done.output
        folder = next(tmp_path.glob(f"{folder}/*/run.yaml")).parent
        assert yaml_of(folder / "run.yaml")["input"]["decoder"] == "pyav"
        answers.append((folder / "mp.csv").read_bytes())
    assert answers[0] == answers[1]


def test_info_names_the_transfer(dlgmd, tmp_path):
    done = dlgmd("info", tagged(tmp_path / "x.mp4", PQ))
    assert "smpte2084" in done.stdout
    assert "It is HDR: all commands read it by PyAV" in done.stdout


@pytest.mark.parametrize("name", ["x.mp4", "x.mkv"])
def test_without_pyav_one_line_says_what_to_install(tmp_path, monkeypatch, name):
    path = tagged(tmp_path / name, HLG)
    assert stated_by(path).colours == HLG
    plain = tagged(tmp_path / f"plain{path.suffix}", SDR)
    monkeypatch.setitem(sys.modules, "av", None)
    why = r"OpenCV would change its grey levels \(transfer arib-std-b67\), and .* not installed"
    with pytest.raises(MissingExtraError, match=why):
        open_video(path)
    with open_video(plain) as video:
        assert video.info.decoder == "opencv"


def test_prores_with_a_reserved_number_does_not_end_the_process(tmp_path):
    path = encode(tmp_path / "x.mov", RAMP, "prores_ks", pixels="yuv422p10le")
    content = bytearray(path.read_bytes())
    at = content.find(b"icpf")
    content[at + 18] = 20  # of the first image's primaries
    path.write_bytes(content)
    with open_video(path) as video:
        assert video.info.decoder == "pyav"
        assert np.ptp(next(iter(video)).grey) > 0.8
