"""ROS 1 bags, ROS 2 bags and MCAP files as an input, read by the package rosbags."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.errors import MissingExtraError, SourceError, argument, counted
from dlgmd_cli.frame import Image
from dlgmd_cli.video.base import MAX_SIDE, TOO_LARGE, Unreadable, plausible_fps
from dlgmd_cli.video.images import image_of, info_of, require_like
from dlgmd_cli.video.timestamps import start_of, steady_fps

NAME = "rosbags"
_METADATA, _MARK = "metadata.yaml", b"rosbag2_bagfile_information"
_RAW, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# Number of messages that the frame rate is measured over.
_N_FIRST = 30
# Encodings of raw images: sample type, samples per pixel, OpenCV's conversion to BGR (or None).
_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1, None)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1, None)),
    **dict.fromkeys(("bgr8", "8UC3"), ("u1", 3, None)),
    "rgb8": ("u1", 3, cv2.COLOR_RGB2BGR),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2BGR),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2BGR),
    # ROS names a Bayer pattern by its first row, OpenCV by its second.
    "bayer_rggb8": ("u1", 1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": ("u1", 1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": ("u1", 1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": ("u1", 1, cv2.COLOR_BayerGB2BGR),
    **dict.fromkeys(("yuv422", "uyvy"), ("u1", 2, cv2.COLOR_YUV2BGR_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), ("u1", 2, cv2.COLOR_YUV2BGR_YUY2)),
}

# Fields of the messages of raw images and of compressed images.
_OF_RAW = ("encoding", "height", "width", "step", "is_bigendian", "data")
_OF_COMPRESSED = ("format", "data")


def is_bag(path: Path) -> bool:
    """Whether the path has the suffix of a bag, or is a folder written by rosbag2."""
    if not path.is_dir():
        return path.suffix in (".bag", ".mcap", ".db3")
    try:
        with (path / _METADATA).open("rb") as file:
            return _MARK in file.read(256)
    except OSError:
        return False


def bag_files(path: Path) -> list[Path]:
    """The files of a bag: the file itself, or all files in its folder."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


class BagDecoder:
    """Yields the raw or compressed images of one topic of a bag, at the times of their headers.

    Where the headers have no times, the times of recording are used. Images that were recorded out
    of order are sorted by their times.

    Parameters
    ----------
    path : Path
        The file or folder.
    topic : str, optional
        The topic to read; required if several have images, unless `any_topic` takes the first.

    Attributes
    ----------
    topic : str
        The topic that is read.
    topics : dict of str to str
        The type and number of messages of all topics, by their names.

    Raises
    ------
    SourceError
        If the bag cannot be read, or has no images under this topic.
    MissingExtraError
        If rosbags is not installed.
    """

    kind = NAME
    is_damaged = False
    takes_every_frame = False
    _message: Any = None

    def __init__(self, path: Path, topic: str | None = None, *, any_topic: bool = False) -> None:
        self._reader: Any = _opened(path)
        try:
            known = self._reader.topics
            self.topics = {
                name: f"{found.msgtype}, {counted(found.msgcount, 'message')}"
                for name, found in known.items()
            }
            self.topic = topic = _chosen(path, known, topic, any_topic)
            self._connections = known[topic].connections
            start = start_of(self._sort())
            next(self.stamps())
            first = decoded(self._message)
            stamps = self._times_s[:_N_FIRST]
            fps = steady_fps(stamps)
            if fps is None and stamps[-1] > stamps[0]:
                fps = plausible_fps((len(stamps) - 1) / (stamps[-1] - stamps[0]))
            codec = getattr(self._message, "encoding", "") or self._message.format
            info = info_of(first, fps, known[topic].msgcount, codec)
            self.info = replace(info, start=start)
        except BaseException as error:
            self.close()
            if isinstance(error, Unreadable):
                raise SourceError(str(path), f"topic {topic}: {error}") from None
            raise

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds since the first, in the order of the times."""
        waiting: dict[int, Any] = {}
        n_taken = 0
        for (_, _, message), rank in zip(self._messages(), self._ranks, strict=False):
            waiting[rank] = message
            while n_taken in waiting:
                self._message = waiting.pop(n_taken)
                yield self._times_s[n_taken]
                n_taken += 1

    def _messages(self) -> Iterator[tuple[int, int, Any]]:
        """The times of capture and of recording, in ns, and the messages; ends at damage."""
        messages = self._reader.messages(connections=self._connections)
        while True:
            try:
                connection, received_ns, data = next(messages)
                message = self._reader.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            except StopIteration:
                return
            except Exception:  # each bag format raises its own types
                self.is_damaged = True
                return
            yield stamp_ns, received_ns, message

    def _sort(self) -> float:
        """Find the order of the messages by their times; the first time in s. Raises Unreadable."""
        stamps_ns = [times for *times, _ in self._messages()]
        self.is_damaged = False  # until the images before the damage are read
        if not stamps_ns:
            raise Unreadable("no message could be read, the file is damaged")
        has_stamps = all(stamp_ns > 0 for stamp_ns, _ in stamps_ns)
        times_ns = [stamp_ns if has_stamps else received_ns for stamp_ns, received_ns in stamps_ns]
        order = sorted(range(len(times_ns)), key=times_ns.__getitem__)
        self._ranks = np.argsort(order).tolist()
        first_ns = times_ns[order[0]]
        self._times_s = [1e-9 * (times_ns[at] - first_ns) for at in order]
        return first_ns / 1e9

    def picture(self) -> Image:
        """The image of the latest message; raises Unreadable if undecodable or of another kind."""
        image = decoded(self._message)
        require_like(image, self.info, "an image")
        return image

    def close(self) -> None:
        """Free the file; may be called twice."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()


def _opened(path: Path) -> Any:
    """A reader of a bag; raises SourceError, MissingExtraError."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError.of(str(path), "rosbags") from None
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except Exception as error:  # each bag format raises its own types
        text = str(error).partition("\n")[0].rstrip(".") or type(error).__name__
        tools = {".bag": "'rosbag reindex'", ".mcap": "'mcap recover'"}
        tool = tools.get(path.suffix, "'.recover' of sqlite3")
        why = f"cannot be read as a ROS bag: {text}"
        raise SourceError(str(path), why, f"If it was cut off, try {tool}.") from None
    return reader


def _chosen(path: Path, known: Mapping[str, Any], topic: str | None, any_topic: bool) -> str:
    """The topic to read; raises SourceError."""
    images = [name for name, found in known.items() if found.msgtype in (_RAW, _COMPRESSED)]
    listed = ", ".join(images)
    hint = f"Choose from {listed}." if images else "'dlgmd info' lists its topics."
    if topic is not None:
        if topic not in known:
            raise SourceError(str(path), f"there is no topic {topic[:80]!r}", hint)
        if topic not in images:
            why = f"the topic {topic} is {known[topic].msgtype}, not images"
            raise SourceError(str(path), why, hint)
        return topic
    if not images:
        names = ", ".join(sorted(known)) or "none at all"
        raise SourceError(str(path), f"it has no topic of images, but {names}")
    if len(images) > 1 and not any_topic:
        why = f"it has {len(images)} topics of images: {listed}"
        raise SourceError(str(path), why, f"Choose one with {argument('topic')}.")
    return images[0]


def decoded(message: Any) -> Image:
    """The image of a message: uint8 or uint16, grey or BGR; raises Unreadable."""
    is_raw = hasattr(message, "encoding")
    if not all(hasattr(message, name) for name in (_OF_RAW if is_raw else _OF_COMPRESSED)):
        raise Unreadable("the definition of its messages is damaged")
    if not is_raw:
        with suppress(Unreadable):
            if "compressedDepth" not in message.format.partition(";")[2]:
                return image_of(message.data)
        raise Unreadable(f"images in the format {message.format[:40]!r} cannot be decoded")
    if message.encoding not in _ENCODINGS:
        raise Unreadable(f"images in the encoding {message.encoding[:40]!r} are not read")
    (kind, n, code), (height, width) = _ENCODINGS[message.encoding], (message.height, message.width)
    if max(height, width) > MAX_SIDE:
        raise Unreadable(TOO_LARGE)
    sample = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    n_used, step = width * n * sample.itemsize, message.step
    if not (0 < n_used <= step and 0 < height * step <= len(message.data)):
        raise Unreadable(f"an image of {width}x{height} has {len(message.data)} bytes, too few")
    rows = np.asarray(message.data, np.uint8)[: height * step].reshape(height, step)[:, :n_used]
    image = np.ascontiguousarray(rows).view(sample).astype(kind, copy=False)
    image = image.reshape((height, width) if n == 1 else (height, width, n))
    return image if code is None else cv2.cvtColor(image, code)
