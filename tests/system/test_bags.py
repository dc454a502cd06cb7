"""ROS bags and MCAP files as an input: topics, encodings, times, damage, and the commands."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from conftest import looming_frames, yaml_of

from dlgmd_cli import info, read_result, run
from dlgmd_cli.errors import MissingExtraError, SourceError
from dlgmd_cli.tasks.batch.find import find_videos
from dlgmd_cli.video import bags
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.opening import content_sha256, fingerprint, open_video

pytest.importorskip("rosbags", reason="rosbags is not installed")
from bagged import START_NS, compressed, film, imu, raw, write_bag

IMAGE = "/camera/image_raw"
KINDS = {".bag": 1, ".db3": 2, ".mcap": 2}
FRAMES = looming_frames(24, 64, 48)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A bag of each kind: a film, the same compressed, and something else."""
    found = {}
    for suffix, ros in KINDS.items():
        folder = tmp_path_factory.mktemp("bags")
        images = film(ros, FRAMES)
        topics = {
            IMAGE: images,
            f"{IMAGE}/compressed": film(ros, FRAMES, make=compressed),
            "/imu": [(at, imu(ros, at)) for at, _ in images],
        }
        found[suffix] = write_bag(folder / f"flight{suffix}", topics)
    return found


@pytest.mark.parametrize(
    ("suffix", "topic"), [*((kind, IMAGE) for kind in KINDS), (".mcap", f"{IMAGE}/compressed")]
)
def test_a_bag_gives_what_its_images_give(written, suffix, topic):
    with open_video(written[suffix], topic=topic) as video:
        for _ in range(2):  # it can be read again
            frames = list(video)
            assert [frame.index for frame in frames] == list(range(24))
            np.testing.assert_array_equal([frame.grey for frame in frames], FRAMES)
            times = [frame.time_s for frame in frames]
            np.testing.assert_allclose(times, np.arange(24) / 30, atol=1e-6)
    assert (video.info.fps, video.info.n_frames, video.info.name) == (30.0, 24, "flight")
    assert video.info.decoder == "rosbags" and not video.progress.warnings


@pytest.mark.parametrize("suffix", KINDS)
def test_messages_out_of_order_are_sorted_by_their_stamps(tmp_path, suffix):
    images = film(KINDS[suffix], FRAMES)
    order = np.random.default_rng(1).permutation(len(images))
    mixed = [(START_NS + at, images[number][1]) for at, number in enumerate(order)]
    path = write_bag(tmp_path / f"x{suffix}", {IMAGE: mixed})
    with open_video(path) as video:
        for _ in range(2):
            frames = list(video)
            np.testing.assert_array_equal([frame.grey for frame in frames], FRAMES)
            np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(24) / 30)
    assert not video.progress.warnings and not video.progress.damage
    assert video.info.start == {"start_time_utc": "2023-11-14T22:13:20.000000Z"}


@pytest.mark.parametrize("suffix", KINDS)
def test_what_topics_there_are_is_told(written, suffix):
    with pytest.raises(SourceError, match=f"2 topics of images: {IMAGE}, {IMAGE}/compressed"):
        run(written[suffix])
    with pytest.raises(SourceError, match=f"no topic '/x'. Choose from {IMAGE}, "):
        run(written[suffix], topic="/x")
    with pytest.raises(SourceError, match="the topic /imu is std_msgs/msg/Header, not images"):
        run(written[suffix], topic="/imu")
    (facts,) = info(written[suffix]).surveys
    assert facts.topics[IMAGE] == "sensor_msgs/msg/Image, 24 messages"
    assert {*facts.topics} == {IMAGE, f"{IMAGE}/compressed", "/imu"}
    assert (facts.frames, facts.codec, facts.fps_true) == (24, "mono8", pytest.approx(30.0))


def test_a_bag_without_images(tmp_path):
    path = write_bag(tmp_path / "x.mcap", {"/imu": [(START_NS, imu(2, START_NS))]})
    with pytest.raises(SourceError, match="no topic of images, but /imu"):
        run(path)


COLOUR = np.random.default_rng(1).integers(0, 256, (6, 8, 3), np.uint8)
DEEP = np.random.default_rng(1).integers(0, 65536, (6, 8), np.uint16)
GREY = COLOUR[..., 0].copy()


def of_bayer(pattern):
    """A mosaic of a single colour, and the colour."""
    values = {"r": 200, "g": 120, "b": 40}
    tile = np.array([values[letter] for letter in pattern], np.uint8).reshape(2, 2)
    return np.tile(tile, (3, 4)), np.broadcast_to(np.uint8([40, 120, 200]), (6, 8, 3))


@pytest.mark.parametrize(
    ("encoding", "sent", "expected"),
    [
        ("mono8", GREY, GREY),
        ("8UC1", GREY, GREY),
        ("mono16", DEEP, DEEP),
        ("bgr8", COLOUR, COLOUR),
        ("rgb8", COLOUR[..., ::-1].copy(), COLOUR),
        ("bgra8", np.dstack([COLOUR, GREY]), COLOUR),
        ("rgba8", np.dstack([COLOUR[..., ::-1], GREY]), COLOUR),
        *((f"bayer_{name}8", *of_bayer(name)) for name in ("rggb", "bggr", "gbrg", "grbg")),
    ],
)
def test_encodings(encoding, sent, expected):
    np.testing.assert_array_equal(bags.decoded(raw(2, sent, 0, encoding)), expected)


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("yuyv", 0)])
def test_packed_colours(encoding, luma):
    """Grey, from black to white in the limited range of video."""
    sent = np.full((6, 8, 2), 128, np.uint8)
    sent[..., luma] = np.linspace(16, 235, 8)
    found = bags.decoded(raw(2, sent, 0, encoding))
    expected = np.broadcast_to(np.linspace(0, 255, 8)[:, None], (6, 8, 3))
    assert np.abs(found - expected).max() <= 2


def test_rows_may_be_padded_and_samples_swapped():
    padded = np.pad(GREY, ((0, 0), (0, 5)))
    message = raw(2, padded, 0, width=8)
    np.testing.assert_array_equal(bags.decoded(message), GREY)
    message = raw(2, DEEP.byteswap(), 0, "mono16", is_bigendian=1)
    np.testing.assert_array_equal(bags.decoded(message), DEEP)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (raw(2, GREY, 0, "32FC1"), "the encoding '32FC1' are not read"),
        (raw(2, GREY, 0, height=7), "8x7 has 48 bytes, too few"),
        (raw(2, GREY, 0, step=5), "too few"),
        (raw(2, GREY, 0, width=0), "too few"),
        (raw(2, GREY, 0, height=9999), "larger than"),
        (compressed(2, DEEP, 0, kind="png compressedDepth"), "cannot be decoded"),
        (SimpleNamespace(encoding="mono8", data=GREY), "the definition of its messages is damaged"),
        (SimpleNamespace(data=GREY), "the definition of its messages is damaged"),
    ],
)
def test_what_is_no_image(message, why):
    with pytest.raises(Unreadable, match=why):
        bags.decoded(message)


def test_a_topic_whose_images_cannot_be_read_is_one_line(tmp_path):
    path = write_bag(tmp_path / "x.mcap", {"/depth": film(2, [GREY] * 3, make=depth)})
    with pytest.raises(SourceError, match="topic /depth: images in the encoding '32FC1' are not"):
        run(path)


def test_a_camera_of_twelve_bits_is_told(tmp_path):
    """As of arrays: without its depth a warning, and with it the right grey levels."""
    images = [np.uint16(frame) * 16 for frame in FRAMES]
    path = write_bag(tmp_path / "x.bag", {IMAGE: film(1, images, make=deep)})
    with open_video(path) as video:
        assert max(frame.grey.max() for frame in video) < 0.1
        (line,) = video.progress.warnings
    assert "all samples of 16 bits are" in line and "give bit_depth=12" in line
    with open_video(path, bit_depth=12) as video, open_video(images, bit_depth=12) as array:
        for found, expected in zip(video, array, strict=True):
            np.testing.assert_array_equal(found.grey, expected.grey)
        assert video.progress.warnings == []


def deep(ros, image, stamp_ns):
    return raw(ros, image, stamp_ns, "mono16")


def depth(ros, image, stamp_ns):
    return raw(ros, image, stamp_ns, "32FC1")


@pytest.mark.parametrize("fps", [30, 5])
def test_times_are_those_of_the_headers_if_they_have_any(tmp_path, fps):
    """And otherwise of the recording; also where the second changes."""
    late = write_bag(tmp_path / "a.mcap", {IMAGE: jittered(film(2, FRAMES, fps))})
    bare = write_bag(
        tmp_path / "b.mcap", {IMAGE: [(t, raw(2, GREY, 0)) for t, _ in film(2, FRAMES, fps)]}
    )
    for path in (late, bare):
        with open_video(path) as video:
            times = [frame.time_s for frame in video]
        np.testing.assert_allclose(times, np.arange(24) / fps, atol=1e-6)


def jittered(messages):
    """The messages, received up to 10 ms later."""
    rng = np.random.default_rng(5)
    return [(at + int(rng.integers(10**7)), one) for at, one in messages]


def test_a_size_that_changes_ends_the_reading(tmp_path):
    frames = [*FRAMES[:20], *(frame[:24] for frame in FRAMES[20:])]
    path = write_bag(tmp_path / "x.mcap", {IMAGE: film(2, [f.copy() for f in frames])})
    with open_video(path) as video:
        assert len(list(video)) == 20
    (warning,) = video.progress.warnings
    assert warning.startswith("an image is 64x24, not 64x48; decoded and used 20 of about")


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.6])
def test_a_bag_that_is_cut_off_is_one_line(written, tmp_path, suffix, share):
    source = written[suffix]
    parts = bags.bag_files(source)
    (data,) = [one for one in parts if one.suffix in KINDS]
    cut = tmp_path / data.name
    cut.write_bytes(data.read_bytes()[: int(share * data.stat().st_size)])
    try:
        found = run(cut, 3, topic=IMAGE)
    except SourceError as error:
        assert "\n" not in str(error) and len(str(error)) < 400
        assert "cannot be read" in error.why or "is empty" in error.why or "damaged" in error.why
    else:
        assert 0 < len(found) < 24 and any("damaged" in line for line in found.warnings)


def test_damage_within_a_bag_ends_the_reading_with_a_warning(written, monkeypatch):
    reader, n_read = bags._opened(written[".mcap"]), []
    deserialize = reader.deserialize

    def broken(data, kind):
        n_read.append(1)
        if len(n_read) > 1 + 24 + 15:  # to open it takes one, and all of a short one for the rate
            raise ValueError("a chunk is damaged")
        return deserialize(data, kind)

    monkeypatch.setattr(reader, "deserialize", broken)
    monkeypatch.setattr(bags, "_opened", lambda path: reader)
    with open_video(written[".mcap"], topic=IMAGE) as video:
        assert len(list(video)) == 15
    (warning,) = video.progress.warnings
    assert "the file is cut off or damaged; decoded and used 15 of about 24 frames" in warning


def test_batch_finds_bags(written, tmp_path):
    (tmp_path / "day").mkdir()
    for suffix, path in written.items():
        (tmp_path / "day" / f"x{suffix}").symlink_to(path, target_is_directory=path.is_dir())
    (tmp_path / "day" / "notes").mkdir()
    (tmp_path / "day" / "notes" / "metadata.yaml").write_text("author: me\n")
    found = find_videos([str(tmp_path / "day")])
    assert [one.name for one in found.videos] == ["x.bag", "x.db3", "x.mcap"]
    assert all(one.identity["bytes"] > 10_000 for one in found.videos)


def test_a_folder_of_a_bag_has_an_identity(written):
    folder = written[".db3"]
    (data,) = folder.glob("*.db3")
    assert fingerprint(folder)["bytes"] == data.stat().st_size and len(content_sha256(folder)) == 64


def test_the_command(runs, written, tmp_path):
    path = written[".mcap"]
    arguments = ("--topic", IMAGE, "--set", 3, "--format=none", "--out", tmp_path / "out")
    runs("run", path, *arguments, "--clips", tmp_path / "clips")
    assert yaml_of(tmp_path / "out/flight/run.yaml")["options"]["topic"] == IMAGE
    expected = run(FRAMES, 3, fps=30)
    np.testing.assert_allclose(read_result(tmp_path / "out/flight").mp, expected.mp, rtol=1e-6)
    (clip,) = (tmp_path / "clips").iterdir()
    assert cv2.VideoCapture(str(clip)).get(cv2.CAP_PROP_FRAME_COUNT) == 24
    again = runs(
        "run", path, "--config", tmp_path / "out/flight/run.yaml", "--overwrite", *arguments[-2:]
    )
    assert again.exit_code == 0  # the topic is in the file
    assert f"{IMAGE}: sensor_msgs/msg/Image, 24 messages" in runs("info", path).stdout


def test_the_package_is_named_where_it_is_missing(monkeypatch, written):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[ros\]'"):
        run(written[".bag"])
