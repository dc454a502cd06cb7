"""ROS bags and MCAP files, written by rosbags itself."""

from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
START_NS = 1_700_000_000 * 10**9
RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def header(store, ros, stamp_ns):
    """The header of a message."""
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    more = {"seq": 0} if ros == 1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="camera", **more)


def raw(ros, image, stamp_ns, encoding="mono8", **changed):
    """A raw image; `changed` are fields with other values."""
    store = STORES[ros]
    facts = {
        "header": header(store, ros, stamp_ns),
        "height": image.shape[0],
        "width": image.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": image.strides[0],
        "data": image.reshape(-1).view(np.uint8),
    } | changed
    return store.types[RAW](**facts)


def compressed(ros, image, stamp_ns, suffix=".png", kind="png"):
    """A compressed image."""
    store, data = STORES[ros], cv2.imencode(suffix, image)[1].ravel()
    about = header(store, ros, stamp_ns)
    return store.types[COMPRESSED](header=about, format=f"mono8; {kind} compressed", data=data)


def imu(ros, stamp_ns):
    """A message of another type."""
    store = STORES[ros]
    return store.types["std_msgs/msg/Header"](**vars(header(store, ros, stamp_ns)))


def write_bag(path: Path, topics):
    """Write a bag; its name tells the kind: a folder .db3 or .mcap of ROS 2, or a .bag of ROS 1.

    `topics` has lists of (time in ns, message) by names.
    """
    ros = 1 if path.suffix == ".bag" else 2
    store = STORES[ros]
    if ros == 1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
        folder = path.with_suffix(".writing" if path.suffix == ".mcap" else "")
        writer = Writer2(folder, version=9, storage_plugin=plugin)
    with writer:
        waiting = []
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store)
            waiting += [(at, connection, kind, one) for at, one in messages]
        for at, connection, kind, one in sorted(waiting, key=lambda entry: entry[0]):
            pack = store.serialize_ros1 if ros == 1 else store.serialize_cdr
            writer.write(connection, at, pack(one, kind))
    if ros == 1:
        return path
    if path.suffix == ".mcap":  # a file alone, as other recorders write it
        (file,) = folder.glob("*.mcap")
        file.rename(path)
        for rest in folder.iterdir():
            rest.unlink()
        folder.rmdir()
        return path
    return folder


def film(ros, frames, fps=30.0, make=raw):
    """The messages of a film."""
    times = [START_NS + round(number * 1e9 / fps) for number in range(len(frames))]
    return [(at, make(ros, frame, at)) for at, frame in zip(times, frames, strict=True)]
