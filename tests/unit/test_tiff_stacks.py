"""TIFF files of several pages, as microscopes and ImageJ write them, are videos."""

import cv2
import numpy as np
import pytest
import tifffile
from conftest import looming_frames, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import SourceError
from dlgmd_cli.video import images
from dlgmd_cli.video.opening import open_video

FRAMES = looming_frames()
KINDS = {
    "8 bits": np.stack(FRAMES),
    "16 bits": np.stack(FRAMES).astype(np.uint16) * 257,
    "float": (np.stack(FRAMES) / 255).astype(np.float32),
    "colour": np.repeat(np.stack(FRAMES)[..., None], 3, 3),
}


def stack(path, pages, compression=1):
    assert cv2.imwritemulti(str(path), list(pages), [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    return path


@pytest.mark.parametrize("at_once", [1, 1 << 12, 1 << 27])
@pytest.mark.parametrize("compression", [1, 5, 32946], ids=["none", "LZW", "zlib"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_stack_is_its_pages(tmp_path, monkeypatch, kind, compression, at_once):
    monkeypatch.setattr(images, "_BYTES_AT_ONCE", at_once)
    path = stack(tmp_path / "x.tif", KINDS[kind], compression)
    with open_video(path, input_fps=500) as video:
        greys = np.array([frame.grey for frame in video], float)
        assert video.info.n_frames == len(FRAMES)
        assert video.progress.last_time_s == pytest.approx(19 / 500)
    with open_video(KINDS[kind]) as video:
        np.testing.assert_array_equal(greys, [frame.grey for frame in video])


def test_a_stack_answers_as_its_array(dlgmd, tmp_path):
    path = stack(tmp_path / "x%d.tiff", KINDS["8 bits"])
    done = dlgmd("run", path, "--set", "9", "--input-fps", "500", "--format", "none")
    assert done.exit_code == 0, done.output
    record = yaml_of(tmp_path / "dlgmd-out" / "x%d" / "run.yaml")
    assert record["input"]["frames"] == len(FRAMES)
    result = dlgmd_cli.read_result(tmp_path / "dlgmd-out" / "x%d")
    expected = dlgmd_cli.run(KINDS["8 bits"], 9, fps=500).mp
    np.testing.assert_allclose(result.mp, expected, rtol=1e-8)
    assert "images have no times" in dlgmd("info", path).stderr


def test_an_imagej_stack_of_the_other_byte_order(tmp_path):
    tifffile.imwrite(tmp_path / "x.tif", KINDS["16 bits"], imagej=True, compression="zlib")
    with open_video(tmp_path / "x.tif") as video:
        greys = [frame.grey for frame in video]
    np.testing.assert_allclose(greys, KINDS["float"], atol=1e-6)


def test_a_broken_stack_is_refused(tmp_path):
    path = stack(tmp_path / "x.tif", KINDS["8 bits"])
    whole = path.read_bytes()
    path.write_bytes(b"II*\0" + bytes(99))
    with pytest.raises(SourceError, match="cannot be read as a TIFF file"):
        open_video(path)
    path.write_bytes(whole[:8] + bytes(500) + whole[508:])
    with open_video(path) as video:  # levels of the first pages are lost, and nothing else
        assert len(list(video)) == len(FRAMES)


@pytest.mark.usefixtures("here")
def test_each_stack_of_a_folder_is_a_video(dlgmd, tmp_path):
    (tmp_path / "stacks").mkdir()
    for name in "abcdefghijkl":  # as many as the images of a sequence
        stack(tmp_path / f"stacks/{name}.tif", KINDS["8 bits"])
    done = dlgmd("batch", "stacks", "--set", "9", "--format", "none", "--out", "o")
    assert done.exit_code == 0 and "12 videos: 12 done" in done.output
    refused = dlgmd("run", "stacks", "--set", "9")
    assert refused.exit_code == 1 and "a.tif: is a stack of images" in refused.stderr
