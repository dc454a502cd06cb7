"""TIFF files of several pages, as microscopes and ImageJ write them, are videos."""

import cv2
import numpy as np
import pytest
import tifffile
from conftest import looming_frames, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import SourceError
from dlgmd_cli.video import tiff
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
    monkeypatch.setattr(tiff, "_BYTES_AT_ONCE", at_once)
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
    path.write_bytes(whole[:8] + bytes(len(whole) - 8))
    with pytest.raises(SourceError, match="cannot be read as a TIFF file"):
        open_video(path)


def described(path, pages, description):
    """A stack with a description, as ImageJ, Bio-Formats or tifffile leave it in a file."""
    stack(path, pages)
    with path.open("ab") as file:
        file.write(description.encode() + b"\0")
    return path


def ome(facts, content=""):
    pixels = f"<Pixels ID='P' {facts} SizeX=\"32\">{content}</Pixels>"
    return f'<?xml version="1.0"?><OME xmlns="urn:x"><Image ID="I">{pixels}</Image></OME>'


def ome_axes(order, channels=1, slices=1, frames=1, more="", content=""):
    sizes = f'SizeC="{channels}" SizeZ="{slices}" SizeT="{frames}"'
    return ome(f'DimensionOrder="{order}" {sizes} {more}', content)


def imagej(**facts):
    return "".join(f"{key}={value}\n" for key, value in {"ImageJ": "1.54f", **facts}.items())


@pytest.mark.parametrize(
    ("description", "sizes"),
    [
        (imagej(images=20, channels=2, frames=10), "10 frames x 2 channels"),
        (imagej(images=20, slices=4, frames=5), "5 frames x 4 slices"),
        (imagej(channels=2, slices=10), "10 slices x 2 channels"),
        (imagej(channels=2, slices=2, frames=5), "5 frames x 2 slices x 2 channels"),
        (ome_axes("XYCZT", channels=2, frames=10), "10 frames x 2 channels"),
        (ome_axes("XYZTC", channels=2, frames=10), "2 channels x 10 frames"),
        (ome_axes("XYCTZ", 2, 2, 5), "2 slices x 5 frames x 2 channels"),
        ('{"shape": [10, 2, 24, 32]}', "10 on axis 0 x 2 on axis 1"),
    ],
)
def test_a_stack_of_more_than_frames_is_refused(tmp_path, description, sizes):
    path = described(tmp_path / "x.tif", KINDS["8 bits"], description)
    with pytest.raises(SourceError, match="Image > Duplicate") as error:
        open_video(path)
    assert error.value.why == f"holds {sizes}"


def test_a_stack_of_two_series_is_read_and_says_so(tmp_path):
    description = ome_axes("XYCZT", frames=10) + ome_axes("XYCZT", frames=10)
    with open_video(described(tmp_path / "x.tif", KINDS["8 bits"], description)) as video:
        assert "it has 20 images, but states 10 frames" in video.progress.warnings


@pytest.mark.parametrize(
    "description",
    [
        imagej(images=20, slices=20, loop="false"),
        imagej(images=20, channels=20, hyperstack="true"),  # tifffile, without axes
        imagej(images=20, frames=20, channels="one"),
        ome_axes("XYCZT", channels=1, slices=20),
        ome_axes("XYCZT", channels=3, frames=20, content="<Channel SamplesPerPixel='3'/>"),
        ome("SizeT='20'"),
        '{"shape": [20, 24, 32, 3]}',
        '{"shape": "unknown"}',
    ],
)
def test_an_ordinary_stack_is_read(tmp_path, description):
    path = described(tmp_path / "x.tif", KINDS["colour"], description)
    with open_video(path) as video:
        assert video.info.n_frames == len(list(video)) == len(FRAMES)
        assert [line[:20] for line in video.progress.warnings] == ["images have no times"]


UNEVEN = [2.0 + 0.1 * number + 0.03 * (number % 2) for number in range(len(FRAMES))]
PLANES = "".join(
    f'<Plane TheT="{number}" DeltaT="{time_s * 1e3}" DeltaTUnit="ms"/>'
    for number, time_s in enumerate(UNEVEN)
)


@pytest.mark.parametrize(
    ("description", "times"),
    [
        (imagej(frames=20, finterval=0.1), [0.1 * number for number in range(20)]),
        (imagej(frames=20, finterval=4, tunit="ms"), [0.004 * number for number in range(20)]),
        (imagej(slices=20, finterval=0, fps=25), [0.04 * number for number in range(20)]),
        (imagej(slices=20, finterval=2, tunit="min"), [120.0 * number for number in range(20)]),
        (
            ome_axes("XYCZT", frames=20, more='TimeIncrement="500" TimeIncrementUnit="&#181;s"'),
            [5e-4 * number for number in range(20)],
        ),
        (
            ome_axes("XYCZT", frames=20, more='TimeIncrement="9"', content=PLANES),
            [time_s - 2.0 for time_s in UNEVEN],
        ),
    ],
)
def test_the_times_of_a_stack_are_those_that_it_states(tmp_path, description, times):
    path = described(tmp_path / "x.tif", KINDS["8 bits"], description)
    with open_video(path) as video:
        assert [frame.time_s for frame in video] == pytest.approx(times)
        assert video.progress.warnings == []
    with open_video(path, max_fps=video.info.fps / 2) as video:  # it states a rate to limit
        assert len(list(video)) <= 11
    with open_video(path, input_fps=2 * video.info.fps) as video:
        assert [frame.time_s for frame in video] == pytest.approx([0.5 * time for time in times])


@pytest.mark.parametrize("description", ["", imagej(frames=20, finterval=0.1)])
@pytest.mark.parametrize("compression", [1, 5])
@pytest.mark.parametrize("share", [0.3, 0.55, 0.9])
def test_a_stack_that_is_cut_off_says_so(tmp_path, share, compression, description):
    path = stack(tmp_path / "x.tif", KINDS["8 bits"], compression)
    # The description of ImageJ is at the beginning: here in the place of the first levels.
    whole = path.read_bytes()
    whole = whole[:8] + description.encode() + b"\0" + whole[9 + len(description) :]
    path.write_bytes(whole[: int(share * len(whole))])
    with open_video(path) as video:
        n_frames = len(list(video))
    assert 20 * share - 2 <= n_frames <= 20 * share + 1
    (damage,) = video.progress.damage
    of = f"{n_frames} of about 20" if description else n_frames
    assert damage.startswith(f"the file is cut off or damaged; decoded and used {of} frames")


def test_one_page_for_many_images_is_refused(tmp_path):
    path = described(tmp_path / "x.tif", KINDS["8 bits"][:1], imagej(images=60, frames=60))
    with pytest.raises(SourceError, match=r"single page for 60 frames.*Image Sequence"):
        open_video(path)


def test_an_array_of_the_other_byte_order():
    big_endian = KINDS["16 bits"].astype(">u2")  # as tifffile maps it
    with open_video(big_endian) as video, open_video(KINDS["16 bits"]) as other:
        for frame, expected in zip(video, other, strict=True):
            np.testing.assert_array_equal(frame.grey, expected.grey)


@pytest.mark.usefixtures("here")
def test_each_stack_of_a_folder_is_a_video(dlgmd, tmp_path):
    (tmp_path / "stacks").mkdir()
    for name in "abcdefghijkl":  # as many as the images of a sequence
        stack(tmp_path / f"stacks/{name}.tif", KINDS["8 bits"])
    done = dlgmd("batch", "stacks", "--set", "9", "--format", "none", "--out", "o")
    assert done.exit_code == 0 and "12 videos: 12 done" in done.output
    refused = dlgmd("run", "stacks", "--set", "9")
    assert refused.exit_code == 1 and "a.tif: is a stack of images" in refused.stderr
