"""Recordings as drivers and people leave them: bags of any order and encoding, trimmed and turned videos."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.importers.sources.ros_bag import message_types

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


@dataclass(frozen=True)
class BagImage:
    """A message with an image."""

    topic: str
    logged_ns: int
    stamp_ns: int
    content: NDArray[Any] | bytes
    encoding: str
    """Of pixels, or the format of a compressed image"""
    frame: str = "camera"


def write_bag(path: Path, images: Sequence[BagImage], kind: str = "sqlite3") -> Path:
    """A bag with the images in the given order; kind: ros1, sqlite3, mcap (ROS 2), or mcap-ros1."""
    is_ros1 = "ros1" in kind
    store = message_types(is_ros1)
    rows = [(each, *_serialized(store, each, is_ros1)) for each in images]
    if kind.startswith("mcap"):
        return _write_mcap(path, rows, "ros1" if is_ros1 else "ros2", store)
    writer: Any
    if is_ros1:
        from rosbags.rosbag1 import Writer as Writer1

        writer = Writer1(path)
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        writer = Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer as bag:
        connections: dict[str, Any] = {}
        for image, name, content in rows:
            if image.topic not in connections:
                connections[image.topic] = bag.add_connection(image.topic, name, typestore=store)
            bag.write(connections[image.topic], image.logged_ns, content)
    return path


def _serialized(store: Any, image: BagImage, is_ros1: bool) -> tuple[str, bytes]:
    """Type and content of a message."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=image.stamp_ns // 10**9, nanosec=image.stamp_ns % 10**9)
    more = {"seq": 0} if is_ros1 else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=image.frame, **more)
    if isinstance(image.content, bytes):
        name, data = COMPRESSED, np.frombuffer(image.content, np.uint8)
        message = types[name](header, image.encoding, data)
    else:
        name, pixels = IMAGE, np.ascontiguousarray(image.content)
        height, width = pixels.shape[:2]
        data = pixels.view(np.uint8).ravel()
        message = types[name](header, height, width, image.encoding, 0, pixels.nbytes // height, data)
    serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    return name, bytes(serialize(message, name))


def _write_mcap(path: Path, rows: Sequence[tuple[BagImage, str, bytes]], profile: str, store: Any) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer: Any = Writer(stream, chunk_size=4096)
        writer.start(profile=profile)
        channels: dict[str, int] = {}
        for image, name, content in rows:
            if image.topic not in channels:
                named = name.replace("/msg/", "/") if profile == "ros1" else name
                definition, _ = store.generate_msgdef(name)
                encoding = "ros1msg" if profile == "ros1" else "ros2msg"
                schema = writer.register_schema(named, encoding, definition.encode())
                channels[image.topic] = writer.register_channel(
                    image.topic, "ros1" if profile == "ros1" else "cdr", schema
                )
            writer.add_message(channels[image.topic], image.logged_ns, content, image.logged_ns)
        writer.finish()
    return path


def write_mcap_of(path: Path, encoding: str | None) -> Path:
    """An MCAP with a message of another encoding; None: without any."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start()
        if encoding is not None:
            schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
            channel = writer.register_channel("/camera", encoding, schema)
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return path


def encode(images: Sequence[NDArray[np.uint8]], path: Path, rate_hz: int = 2, group: int = 10) -> Path:
    """Frames (H, W) as H.264 with key frames ``group`` apart; without container for .h264."""
    import av

    with av.open(str(path), "w", format="h264" if path.suffix == ".h264" else None) as container:
        stream: Any = container.add_stream("libx264", rate=rate_hz, options={"g": str(group), "crf": "1"})
        stream.height, stream.width = images[0].shape
        stream.pix_fmt = "yuv420p"
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(np.repeat(image[..., None], 3, axis=2), format="rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def trimmed(source: Path, path: Path, start_s: Fraction) -> Path:
    """The video from a time on, its packets copied: earlier ones remain, and an edit list hides them."""
    import av

    options = {"avoid_negative_ts": "disabled", "use_editlist": "1"}
    with av.open(str(source)) as old, av.open(str(path), "w", options=options) as new:
        stream = old.streams.video[0]
        out = new.add_stream_from_template(stream)
        shift = int(start_s / Fraction(stream.time_base or 1))
        for packet in old.demux(stream):
            if packet.dts is not None and packet.pts is not None:
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, out
                new.mux(packet)
    return path
