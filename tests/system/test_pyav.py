"""What PyAV gives: luma planes of every kind, times, turned and damaged images."""

import io
import struct
from itertools import pairwise

import cv2
import damaged
import numpy as np
import pytest
from conftest import looming_frames, write_video
from PIL import Image

from dlgmd_cli.errors import SourceError
from dlgmd_cli.frame import Frame
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.luma import luma_plane, to_grey
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.pyav_decoder import picture_of

av = pytest.importorskip("av", reason="PyAV is not installed")

UNSPECIFIED, LIMITED, FULL = 0, 1, 2
# All levels of 8 bits; as wide as no line of a decoder is without padding.
RAMP = np.tile(np.arange(256, dtype=np.uint8)[:250], (36, 1))


def filled(pixel_format, luma):
    """A frame with this luma plane and without colour."""
    height, width = luma.shape
    frame = av.VideoFrame(width, height, pixel_format)
    for index, plane in enumerate(frame.planes):
        rows = np.frombuffer(plane, luma.dtype).reshape(plane.height, -1)
        is_colour = index in (1, 2)
        depth = frame.format.components[0].bits
        rows[:, : plane.width] = 1 << (depth - 1) if is_colour else luma if index == 0 else 255
    return frame


def encode(path, frames, codec="ffv1", **how):
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV cannot write {codec}")
    return damaged.encode(path, frames, codec, **how)


def read(path, decoder="pyav", **options):
    """All frames and warnings."""
    with open_video(path, decoder=decoder, **options) as source:
        return list(source), source.progress.warnings


def first_grey(path, decoder="pyav"):
    return read(path, decoder)[0][0].grey


def stretched(levels, black, white):
    return np.clip((levels.astype(np.float64) - black) / (white - black), 0.0, 1.0)


LOSSLESS = {"qp": "0", "preset": "ultrafast"}


@pytest.mark.parametrize(
    ("codec", "pixel_format", "colour_range", "levels"),
    [
        *(
            (codec, "yuv420p", colour_range, levels)
            for codec in ("ffv1", "libx264")
            for colour_range, levels in enumerate([(16, 235), (16, 235), (0, 255)])
        ),
        ("ffv1", "yuva420p", UNSPECIFIED, (16, 235)),
        ("ffv1", "gray", UNSPECIFIED, (0, 255)),
    ],
)
def test_levels_follow_the_colour_range(tmp_path, codec, pixel_format, colour_range, levels):
    options = LOSSLESS if codec == "libx264" else None
    frames = [filled(pixel_format, RAMP)] * 3
    how = {"colour_range": colour_range, "options": options}
    path = encode(tmp_path / "x.mkv", frames, codec, **how)
    grey = first_grey(path)
    assert grey.dtype == np.uint8
    assert np.array_equal(grey, np.rint(255 * stretched(RAMP, *levels)).astype(np.uint8))


@pytest.mark.parametrize("matrix", [1, 5, 9], ids=["BT.709", "BT.601", "BT.2020"])
def test_levels_do_not_depend_on_the_colour_matrix(tmp_path, matrix):
    frame = filled("yuv420p", RAMP)
    for plane in frame.planes[1:]:  # a strong colour
        np.frombuffer(plane, np.uint8)[:] = 60
    frame.colorspace = matrix
    with av.open(str(tmp_path / "x.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 250, 36, "yuv420p"
        stream.codec_context.colorspace = matrix
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with av.open(str(tmp_path / "x.mkv")) as container:
        assert next(container.decode(video=0)).colorspace == matrix
    grey = first_grey(tmp_path / "x.mkv")
    assert np.array_equal(grey, np.rint(255 * stretched(RAMP, 16, 235)))


@pytest.mark.parametrize("n_bits", [10, 12, 16])
@pytest.mark.parametrize("colour_range", [LIMITED, FULL])
def test_deep_levels(tmp_path, n_bits, colour_range):
    scale = 1 << (n_bits - 8)
    deep = np.linspace(0, 256 * scale - 1, RAMP.size).astype(np.uint16).reshape(RAMP.shape)
    frames = [filled(f"yuv420p{n_bits}le", deep)] * 2
    path = encode(tmp_path / "x.mkv", frames, colour_range=colour_range)
    grey = first_grey(path)
    assert grey.dtype == np.float32
    black, white = (16 * scale, 235 * scale) if colour_range == LIMITED else (0, 256 * scale - 1)
    assert grey == pytest.approx(stretched(deep, black, white), abs=1e-6)


def through(pixel_format, ramp):
    """Luminance of a grey image in another format; None where FFmpeg cannot convert it."""
    try:
        frame = av.VideoFrame.from_ndarray(ramp, "gray").reformat(format=pixel_format)
        image, levels = picture_of(frame)
    except (ValueError, OSError, Unreadable):
        return None
    return Frame(0, 0.0, to_grey(image, ramp.shape[::-1], levels)).luminance


def test_every_pixel_format():
    # In pairs, because some formats halve the resolution.
    ramp = np.tile(np.repeat(np.arange(0, 256, 2, dtype=np.uint8), 2), (36, 1))
    seen = []
    for name in sorted(av.video.format.names):
        bits = [component.bits for component in av.VideoFormat(name).components]
        # FFmpeg itself errs in the range of floating-point grey.
        if bits and min(bits) >= 8 and not name.startswith("grayf"):
            luminance = through(name, ramp)
            if luminance is not None:
                seen.append(name)
                assert np.abs(luminance - ramp / 255.0).max() < 4 / 255, name
    assert len(seen) > 100 and {"yuv420p", "nv12", "p010le", "yuv420p10be", "gbrp"} <= set(seen)


def test_which_formats_have_a_luma_plane():
    for name in ("yuv420p", "nv12"):
        assert luma_plane(name, UNSPECIFIED) == luma_plane(name, LIMITED) == (np.uint8, (16, 235))
    assert luma_plane("gray", UNSPECIFIED) == luma_plane("yuv420p", FULL) == (np.uint8, (0, 255))
    assert luma_plane("yuv422p10le", FULL) == (np.uint16, (0, 1023))
    assert luma_plane("p010le", LIMITED) == (np.uint16, (64 << 6, 940 << 6))
    assert luma_plane("yuvj420p", LIMITED) == (np.uint8, (0, 255))  # its name says full
    for name in ("rgb24", "pal8", "yuyv422", "yuv420p10be", "grayf32le", "ya8", "bayer_rggb8"):
        assert luma_plane(name, LIMITED) is None
    frame = filled("yuv420p", RAMP)
    image, _ = picture_of(frame)
    assert np.shares_memory(image, np.frombuffer(frame.planes[0], np.uint8))


def test_times_are_the_same_with_every_decoder(tmp_path, decoder):
    stamps = [0, 40, 80, 250, 300, 301, 900]
    frames = [filled("yuv420p", np.roll(RAMP, i, axis=1)) for i in range(len(stamps))]
    path = encode(tmp_path / "x.mkv", frames, stamps=stamps)
    times = [frame.time_s for frame in read(path, decoder)[0]]
    assert times == pytest.approx([stamp / 1000 for stamp in stamps], abs=1e-9)


# Damage


def noise(n_frames):
    rng = np.random.default_rng(1)
    return [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(n_frames)]


@pytest.mark.parametrize("fill", [b"\0", b"\xff", b"\x5a"])
def test_pictures_before_damage_are_whole(tmp_path, fill, capfd):
    path = write_video(tmp_path / "x.mp4", noise(40), fourcc="mp4v")
    whole, _ = read(path)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 400] = fill * 400
    path.write_bytes(data)
    with open_video(path, decoder="pyav") as source:
        frames, again = list(source), list(source)
        warnings = source.progress.warnings
    assert 30 < len(frames) < 40 and len(again) == len(frames)
    (gap,) = (frame.index for frame in frames if frame.after_gap)
    for frame, other in zip(frames[:gap], whole, strict=False):
        assert np.array_equal(frame.grey, other.grey)
    assert all("the file is damaged" in line for line in warnings) and warnings
    assert f"decoded and used {len(frames)} of about 40 frames" in warnings[0]
    assert capfd.readouterr() == ("", "")  # FFmpeg's own messages are kept away


def test_an_error_at_the_very_end_is_told(tmp_path):
    path = tmp_path / "x.mjpeg"
    pictures = [cv2.imencode(".jpg", frame)[1].tobytes() for frame in noise(5)]
    path.write_bytes(b"".join(pictures) + b"\xff\xd8\xff\xd9")
    frames, warnings = read(path, input_fps=25)
    assert len(frames) == 5
    assert warnings == ["the file is damaged; decoded and used 5 frames, up to 0.160 s"]


def test_a_cover_is_no_video(tmp_path):
    picture = cv2.imencode(".jpg", RAMP)[1].tobytes()
    cover = b"\0image/jpeg\0\x03\0" + picture
    frame = b"APIC" + struct.pack(">I", len(cover)) + b"\0\0" + cover
    size = bytes(len(frame) >> shift & 0x7F for shift in (21, 14, 7, 0))
    silence = (b"\xff\xfb\x90\x00" + bytes(413)) * 40
    (tmp_path / "x.mp3").write_bytes(b"ID3\x03\0\0" + size + frame + silence)
    with av.open(str(tmp_path / "x.mp3")) as container:
        assert len(container.streams.video) == 1
    with pytest.raises(SourceError, match="no frame could be decoded"):
        open_video(tmp_path / "x.mp3", decoder="pyav")


def test_a_change_of_pixel_format_goes_on(tmp_path):
    parts = []
    for sampling in (0x221111, 0x111111):  # 4:2:0 and 4:4:4
        flags = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
        bgr = [cv2.cvtColor(f, cv2.COLOR_GRAY2BGR) for f in looming_frames(4)]
        parts += [cv2.imencode(".jpg", frame, flags)[1].tobytes() for frame in bgr]
    (tmp_path / "x.mjpeg").write_bytes(b"".join(parts))
    frames, warnings = read(tmp_path / "x.mjpeg", input_fps=25)
    assert len(frames) == 8 and warnings == []
    assert np.abs(frames[3].grey.astype(int) - frames[7].grey).max() < 40


def pillow_image(format_name, grey, **options):
    """A grey image in a file's format, encoded by Pillow."""
    content = io.BytesIO()
    Image.fromarray(grey).save(content, format_name, **options)
    return content.getvalue()


def test_a_grey_tiff_as_a_video(tmp_path):
    """FFmpeg 8 adds its Exif data to the frame, of which PyAV 18 knows nothing."""
    (tmp_path / "x.tif").write_bytes(pillow_image("TIFF", RAMP))
    assert np.array_equal(first_grey(tmp_path / "x.tif"), RAMP)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_grey_motion_jpeg_with_exif_is_turned_and_mirrored(tmp_path, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    picture = np.zeros((40, 64), np.uint8)
    picture[:8, :24], picture[-8:, :8] = 255, 128
    (tmp_path / "x.mjpeg").write_bytes(3 * pillow_image("JPEG", picture, quality=95, exif=exif))
    frames, _ = read(tmp_path / "x.mjpeg")
    upright = {
        1: picture,
        2: picture[:, ::-1],
        3: picture[::-1, ::-1],
        4: picture[::-1],
        5: picture.T,
        6: np.rot90(picture, -1),
        7: picture[::-1, ::-1].T,
        8: np.rot90(picture),
    }[orientation]
    assert len(frames) == 3
    assert frames[0].grey == pytest.approx(upright, abs=30)
    assert len(read(tmp_path / "x.mjpeg", "opencv")[0]) == 3  # which does not turn it


@pytest.mark.parametrize(
    ("places", "told"),
    [
        ((1, 20), "2 frames cannot be decoded after frame 0 (0.000 s) and in 1 more place"),
        ((7,), "1 frame cannot be decoded after frame 6 (0.240 s)"),
        ((30, 31, 50), "3 frames cannot be decoded after frame 29 (1.160 s) and in 1 more place"),
    ],
)
def test_reading_goes_on_after_damaged_packets(tmp_path, places, told):
    path = encode(tmp_path / "x.mp4", looming_frames(60, 96, 64), "libx264", options={"bf": "0"})
    with av.open(str(path)) as container:
        starts = [packet.pos for packet in container.demux(video=0) if packet.size]
    changed = bytearray(path.read_bytes())
    for place in places:
        # One bit, of a length: some builds of the decoder skip other damage without a word.
        changed[starts[place]] ^= 0x80
    path.write_bytes(changed)
    with open_video(path, decoder="pyav") as video:
        frames = list(video)
    lost = [round((b.time_s - a.time_s) * 25) - 1 for a, b in pairwise(frames)]
    assert len(frames) == 60 - len(places) and sum(lost) == len(places)
    assert [frame.after_gap for frame in frames[1:]] == [n_lost > 0 for n_lost in lost]
    (line,) = video.progress.damage
    assert told in line
    assert f"decoded and used {len(frames)} of about 60 frames" in line
