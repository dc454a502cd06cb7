"""Interlaced video: every command de-interlaces or refuses it."""

import sys

import cv2
import numpy as np
import pytest
from conftest import write_video, yaml_of
from interlaced import at, woven

import dlgmd_cli
from dlgmd_cli.errors import MissingExtraError
from dlgmd_cli.video.luma import to_grey
from dlgmd_cli.video.opening import open_video

N = 24
WHOLE = [at(6 * t) for t in range(N)]
WOVEN = [woven(at(6 * t), at(6 * t + 3)) for t in range(N)]


@pytest.fixture(scope="module")
def unflagged(tmp_path_factory):
    """As recorders of analog video write it: a comb, and no flag."""
    return write_video(tmp_path_factory.mktemp("fields") / "fields.avi", WOVEN)


@pytest.fixture(scope="module")
def flagged(tmp_path_factory):
    """Flagged, and of a height that is not looked at; OpenCV cannot convert it."""
    pytest.importorskip("av", reason="PyAV is not installed")
    from damaged import encode

    path = tmp_path_factory.mktemp("fields") / "flagged.mkv"
    options = {"flags": "+ildct+ilme", "x264-params": "tff=1", "qp": "4"}
    return encode(path, [one[:360] for one in WOVEN], "libx264", options=options)


# This encoder flags that the odd lines come first; without a flag, the even ones are taken.
@pytest.mark.parametrize(
    ("name", "decoder", "first_px"), [("unflagged", "pyav", 0), ("flagged", "opencv", 3)]
)
def test_interlaced_video_is_deinterlaced(request, name, decoder, first_px):
    """One image a frame, that of its first field, at its time; as often as it is read."""
    pytest.importorskip("av", reason="PyAV is not installed")
    with open_video(request.getfixturevalue(name), decoder=decoder) as video:
        assert video.info.decoder == "pyav" and video.info.is_interlaced
        for _ in range(2):
            frames = list(video)
            assert [frame.time_s for frame in frames] == pytest.approx(np.arange(N) / 25, abs=1e-3)
        n_lines = video.info.height
    for t in range(2, N - 2):
        right, comb = (
            to_grey(one[:n_lines], video.size_wh).astype(int)
            for one in (at(6 * t + first_px), WOVEN[t])
        )
        error = np.abs(frames[t].grey - right).mean()
        assert error < 3.0 and error < 0.5 * np.abs(comb - right).mean()


def test_the_record_and_info_say_so(dlgmd, runs, unflagged, tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed")
    runs("run", unflagged)
    source = yaml_of(tmp_path / "dlgmd-out/fields/run.yaml")["input"]
    assert (source["decoder"], source["deinterlaced"]) == ("pyav", "bwdif")
    shown = dlgmd("info", unflagged).stdout
    assert "It is interlaced: all commands" in shown
    write_video(tmp_path / "whole.avi", WHOLE)
    runs("run", "whole.avi", "--decoder", "opencv")
    source = yaml_of(tmp_path / "dlgmd-out/whole/run.yaml")["input"]
    assert source["decoder"] == "opencv" and "deinterlaced" not in source


INSTALL = "and the package 'av' is not installed. Install it from the clone: pip install '.[fast]'."


def test_without_pyav_it_is_refused(dlgmd, unflagged, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    for command in ("run", "info", "compare"):
        result = dlgmd(command, unflagged)
        assert result.exit_code == 1 and result.stdout == ""
        assert f"{unflagged}: it is interlaced, {INSTALL}" in result.stderr
    with pytest.raises(MissingExtraError, match="it is interlaced"):
        dlgmd_cli.run(unflagged)


def test_flagged_video_is_refused_without_pyav(dlgmd, flagged, monkeypatch):
    """OpenCV shows the same memory throughout, which is not taken for the video."""
    monkeypatch.setitem(sys.modules, "av", None)
    result = dlgmd("run", flagged, "--format=none")
    assert result.exit_code == 1 and result.stdout == ""
    why = f"Error: {flagged}: nothing can be seen, as if OpenCV read interlaced video, {INSTALL}\n"
    assert result.stderr == why


@pytest.fixture(scope="module")
def av1(tmp_path_factory):
    """A codec that OpenCV has no decoder for."""
    av = pytest.importorskip("av", reason="PyAV is not installed")
    from damaged import encode

    codec = next((one for one in ("libsvtav1", "libaom-av1") if one in av.codecs_available), "")
    if not codec:
        pytest.skip("PyAV has no encoder for AV1")
    frames = [cv2.resize(one, (128, 96)) for one in WHOLE[:12]]
    return encode(tmp_path_factory.mktemp("codecs") / "flight.mp4", frames, codec)


def test_a_codec_that_opencv_lacks(dlgmd, runs, av1, monkeypatch, tmp_path):
    runs("run", av1)
    record = yaml_of(tmp_path / "dlgmd-out/flight/run.yaml")
    assert (record["input"]["decoder"], record["input"]["frames"]) == ("pyav", 12)
    assert "av" in record["versions"] and "decoder" not in record["options"]
    monkeypatch.setitem(sys.modules, "av", None)
    result = dlgmd("run", av1, "--format=none", "--overwrite")
    assert result.exit_code == 1 and result.stdout == ""
    why = f"{av1}: OpenCV decodes none of its frames (codec av01)"
    assert result.stderr.lower() == f"Error: {why}, {INSTALL}\n".lower()


@pytest.mark.parametrize(("pixels", "bits"), [("gray", 8), ("gray10le", 10), ("gray16le", 16)])
def test_the_range_of_grey_pictures(dlgmd, tmp_path, monkeypatch, pixels, bits):
    """OpenCV takes grey for full range: right if that is stated or nothing is."""
    av = pytest.importorskip("av", reason="PyAV is not installed")
    from damaged import encode

    levels = np.tile(np.linspace(16, 235, 64), (48, 1)) * 2 ** (bits - 8)
    stored = levels.astype(np.uint8 if bits == 8 else np.uint16)
    for limit, decoder, darkest in ((1, "pyav", 0), (2, "opencv", 16), (0, "opencv", 16)):
        path = tmp_path / f"{limit}.mkv"
        rolled = (np.roll(stored, turn, 1) for turn in range(4))
        frames = [av.VideoFrame.from_ndarray(one, format=pixels) for one in rolled]
        encode(path, frames, "ffv1", colour_range=limit)
        with open_video(path) as video:
            grey = next(iter(video)).grey
            expected = "pyav" if bits == 16 else decoder  # OpenCV keeps 8 bits
            assert video.info.decoder == expected and video.progress.warnings == []
        scale = 255 if grey.dtype == np.float32 else 1
        assert np.min(grey) * scale == pytest.approx(darkest, abs=1.0)
    monkeypatch.setitem(sys.modules, "av", None)
    result = dlgmd("run", "1.mkv", "--format=none")
    assert "Warning: 1.mkv: the frames are grey, and their black is taken for 0" in result.stderr
