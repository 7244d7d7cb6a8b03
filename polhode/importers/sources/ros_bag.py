"""Bags of ROS 1 and of ROS 2 (sqlite3 and MCAP), read by the library rosbags.

The bag is read twice: for times, calibration and poses, then for the images that are wanted, each of which is
decoded once. Messages are read by ROS's own definitions of their types, never by those that a bag brings.
"""

import re
import sqlite3
from bisect import bisect_left, insort
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.importers.calibrations.camera_info import CameraInfo, read_one, rig_of, shift_between
from polhode.importers.calibrations.rig import Rig, with_virtual_camera
from polhode.importers.options import ImportOptions
from polhode.importers.sources.image_folders import natural_key
from polhode.importers.sources.mcap_file import McapReader
from polhode.importers.sources.recording import Contents, FramedImage, Poses, Wanted
from polhode.importers.sources.ros_messages import (
    CAMERA_INFO,
    COMPRESSED,
    ODOMETRY,
    POSES,
    RAW,
    TRANSFORMS,
    Frames,
    header_ns,
    image_of,
    plain,
    pose_of,
    ranges_of,
    stamp_of,
)
from polhode.importers.times import require_plausible
from polhode.records.range_images import RangeModel
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import require_part
from polhode.runtime.progress import Progress

SUFFIXES = (".bag", ".db3", ".mcap")
FITS = 0.75
"""Of the usual interval, the distance to the next stamps of a message that only comes late"""
DEPTH_ENCODINGS = ("16UC1", "32FC1")
DEPTH_UNIT_M = 1e-3
"""Of depth images of 16 bits (ROS's REP 118)"""


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its suffix, or the folder that ROS 2 records."""
    if path.is_dir():
        return any(
            each.suffix in (".db3", ".mcap") or each.name == "metadata.yaml" for each in path.iterdir()
        )
    return path.suffix.lower() in SUFFIXES


@contextmanager
def opened_bag(path: Path, options: ImportOptions, progress: Progress) -> Iterator["RosBag"]:
    """The bag, its times read. Raises InputError for what is missing, cut off or not there to be chosen."""
    require_part("rosbags", "bags")
    if options.stamps or options.time_unit is not None:
        raise InputError(
            f"{path}: a bag has times of its own; leave --stamps and --time-unit out, or give --rate-hz"
        )
    files = [path]
    if path.is_dir():
        files = sorted(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
        if not (path / "metadata.yaml").exists() and len(files) != 1:
            raise InputError(f"{path}: metadata.yaml is missing; make it again: ros2 bag reindex {path}")
        files.sort(key=lambda each: natural_key(each.name))
    from rosbags import rosbag1, rosbag2

    with _readable(path):
        reader: Any
        if files and all(each.suffix.lower() == ".mcap" for each in files):
            reader = McapReader(files)
        elif path.suffix.lower() == ".bag":
            reader = rosbag1.Reader(path)
        else:
            reader = rosbag2.Reader(path if (path / "metadata.yaml").exists() else files[0])
        reader.open()
    try:
        yield _indexed(path, reader, files, options, progress)
    finally:
        reader.close()


@dataclass(frozen=True)
class RosBag:
    """An opened bag."""

    name: str
    contents: Contents
    _bag: "_Bag" = field(repr=False)
    _orders: dict[str, dict[int, int]] = field(repr=False)
    """Topic of the left and of the right camera -> number of the message -> index into sorted timestamps"""

    def images(self, wanted: Wanted) -> Iterator[FramedImage]:
        """The wanted images, in the order of the bag."""
        topics = list(self._orders)
        counts, left = dict.fromkeys(topics, 0), len(wanted[0]) + len(wanted[1])
        for topic, _, content in self._bag.messages(topics):
            camera, number = topics.index(topic), counts[topic]
            counts[topic] += 1
            index = self._orders[topic].get(number)
            if index is None or index not in wanted[camera]:
                continue
            name = f"{self.name}, {topic}, image {number}"
            with self._bag.readable():
                message, kind = self._bag.decoded(topic, content), self._bag.kinds[topic]
                ranges = self.contents.ranges if camera else None
                image = (
                    image_of(message, kind, name)
                    if ranges is None
                    else ranges_of(message, kind, name, ranges)
                )
            yield FramedImage(camera, index, image, name)
            left -= 1
            if not left:
                return


class _Bag:
    """The messages of a bag, and the first of each topic that was read."""

    def __init__(self, path: Path, reader: Any, files: Sequence[Path]) -> None:
        """Raises InputError for a bag without messages."""
        self.path, self._reader, self._files = path, reader, files
        self.is_ros1 = reader.is_ros1 if isinstance(reader, McapReader) else path.suffix.lower() == ".bag"
        self._types = message_types(self.is_ros1)
        self.kinds = {each.topic: str(each.msgtype) for each in reader.connections if each.msgcount}
        self.firsts: dict[str, bytes] = {}
        if not self.kinds:
            raise InputError(f"{path}: an empty bag, without a single message; record it again")

    def count(self, topics: Sequence[str]) -> int:
        """Number of messages of some topics."""
        return sum(each.msgcount for each in self._reader.connections if each.topic in topics)

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording [ns] and content of each message."""
        with self.readable():
            connections = [each for each in self._reader.connections if each.topic in topics]
            messages = iter(self._reader.messages(connections=connections)) if connections else iter(())
        while True:
            with self.readable():
                found = next(messages, None)
            if found is None:
                return
            yield found[0].topic, int(found[1]), bytes(found[2])

    def decoded(self, topic: str, content: bytes) -> Any:
        """A message; raises what the library raises for content that is none."""
        kind = self.kinds[topic]
        kind = TRANSFORMS[0] if kind in TRANSFORMS else kind
        decode = self._types.deserialize_ros1 if self.is_ros1 else self._types.deserialize_cdr
        return decode(content, kind)

    def logged_ns(self, topic: str) -> Ints | None:
        """Times (n,) at which the messages of a topic were recorded, in that order; None: as they are
        read.
        """
        if isinstance(self._reader, McapReader):
            return None
        if self.is_ros1:
            entries = [
                (each.chunk_pos, each.offset, each.time)
                for connection in self._reader.connections
                if connection.topic == topic
                for each in self._reader.indexes[connection.id]
            ]
            return np.array([time for _, _, time in sorted(entries)], dtype=np.int64)
        times: list[int] = []
        for file in self._files:
            if file.suffix != ".db3":
                return None
            with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as base:
                rows = base.execute(
                    "SELECT messages.timestamp FROM messages JOIN topics ON messages.topic_id = topics.id "
                    "WHERE topics.name = ? ORDER BY messages.id",
                    (topic,),
                )
                times += [int(row[0]) for row in rows]
        return np.array(times, dtype=np.int64)

    def first_encoding(self, topic: str) -> str:
        """Encoding or format of the first image of a topic."""
        if topic not in self.firsts:
            self.firsts[topic] = next(iter(self.messages([topic])))[2]
        message = self.first(topic)
        return str(getattr(message, "encoding", getattr(message, "format", "")))

    def first(self, topic: str) -> Any:
        """The first message of a topic that was read."""
        with self.readable():
            return self.decoded(topic, self.firsts[topic])

    def readable(self) -> AbstractContextManager[None]:
        """Raise InputError for whatever the library raises."""
        return _readable(self.path)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise InputError for whatever the library raises: a damaged bag ends in errors of any type."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:120].rstrip(".") or type(error).__name__
        repair = {".bag": "rosbag reindex", ".mcap": "mcap recover"}.get(
            path.suffix.lower(), "ros2 bag reindex"
        )
        raise InputError(
            f"{path}: empty, damaged or cut off ({said}); repair it ({repair}), or record it again"
        ) from error


def message_types(is_ros1: bool) -> Any:
    """ROS's own definitions of the types of messages that are read here."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if TRANSFORMS[0] not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS[0]))
    return store


def _indexed(
    path: Path, reader: Any, files: Sequence[Path], options: ImportOptions, progress: Progress
) -> RosBag:
    """Times, calibration and poses, by a first reading."""
    with _readable(path):
        bag = _Bag(path, reader, files)
    kinds, topics = bag.kinds, _image_topics(bag, options)
    ranges = _range_model(bag, topics, options)
    infos = [f"{_base(topic).rpartition('/')[0]}/camera_info" for topic in topics]
    pose_topic = _pose_topic(bag, options)
    trees = [
        topic for topic, kind in kinds.items() if kind in TRANSFORMS and plain(topic) in ("tf", "tf_static")
    ]
    wanted = [*topics, *(each for each in infos if kinds.get(each) == CAMERA_INFO), *trees]
    wanted += [pose_topic] if pose_topic else []
    times_ns: dict[str, list[int]] = {topic: [] for topic in topics}
    logged_ns: dict[str, list[int]] = {topic: [] for topic in topics}
    frames, messages = Frames(), []
    with progress.stage("reading times", bag.count(wanted)) as advance:
        for topic, logged, content in bag.messages(wanted):
            with bag.readable():
                if topic in topics:
                    times_ns[topic].append(stamp_of(content, bag.is_ros1))
                    logged_ns[topic].append(logged)
                if topic in trees:
                    message = bag.decoded(topic, content)
                    frames.add(message, plain(topic) == "tf_static", f"{path}, {topic}")
                elif topic == pose_topic:
                    messages.append(bag.decoded(topic, content))
                else:
                    bag.firsts.setdefault(topic, content)
            advance()
    orders, stamps, warnings, left_out = {}, [], [], 0
    origin = "--rate-hz" if options.rate_hz is not None else "the headers of the messages"
    parts: dict[str, Ints] = {}
    for topic in topics:
        times = np.array(times_ns[topic], dtype=np.int64)
        with bag.readable():
            parts[topic] = recorded_parts(times if times.any() else logged_ns[topic], bag.logged_ns(topic))
    part, number = _chosen_part(*parts.values())
    if number > 1:
        if messages or (options.poses or "none") != "none":
            raise InputError(
                f"{path}: the clock was set back while it was recorded, and the poses of its {number} parts "
                "are mixed; give --poses none, or record again"
            )
        left_out = sum(int((each != part).sum()) for each in parts.values())
        warnings.append(
            f"{path}: the clock was set back while it was recorded, which makes {number} parts; part "
            f"{part + 1} is imported, {left_out} images of the others are left out"
        )
    for topic in topics:
        # of messages with the same time the first one
        times = np.array(times_ns[topic], dtype=np.int64)
        if not len(times):
            raise InputError(f"{path}: no image in {topic}; record it again, or choose another topic")
        if not times.any():
            times, origin = np.array(logged_ns[topic], dtype=np.int64), "the times of recording"
            warnings.append(
                f"{path}: {topic} has no timestamps; the times of recording are taken, which scatter"
            )
        kept = np.flatnonzero(parts[topic] == part)
        if len(kept) > 1 and np.ptp(times[kept]) == 0 and options.rate_hz is None:
            raise InputError(
                f"{path}: all {len(kept)} images of {topic} have the time {times[kept[0]]} ns; give --rate-hz"
            )
        if options.rate_hz is not None:
            times[kept] = np.rint(np.arange(len(kept)) * 1e9 / options.rate_hz).astype(np.int64)
        unique, first = np.unique(times[kept], return_index=True)
        if repeated := len(kept) - len(unique):
            warnings.append(f"{path}: {repeated} images of {topic} repeat a timestamp; not used")
        orders[topic] = {int(kept[number]): index for index, number in enumerate(first)}
        require_plausible(f"{path}, {topic}", unique, "give --rate-hz instead of the times of the messages")
        stamps.append(unique)
    rig, said = (None, []) if options.calibration else _rig(bag, topics, infos, frames, ranges is not None)
    said += [] if ranges is None else _doubts_of_alignment(bag, topics)
    # frame of the left camera: of its camera_info, else of its images
    named = next((name for name in (infos[0], topics[0]) if name in bag.firsts), None)
    camera = plain(bag.first(named).header.frame_id) if named else ""
    poses, notes, remarks = _poses(bag, options, pose_topic, messages, frames, camera, stamps[0])
    contents = Contents(
        (stamps[0], stamps[1]),
        rig,
        poses,
        ranges=ranges,
        times=origin,
        left_out=left_out,
        notes=(_topics_in_words(topics, ranges), *notes),
        warnings=(*warnings, *said, *remarks),
    )
    return RosBag(str(path), contents, bag, orders)


def _image_topics(bag: _Bag, options: ImportOptions) -> tuple[str, str]:
    """Left and right. Raises InputError when they are not there, or cannot be told apart."""
    path, kinds = bag.path, bag.kinds
    images = sorted(topic for topic, kind in kinds.items() if kind in (RAW, COMPRESSED))
    shown = ", ".join(images) or f"none among {', '.join(sorted(kinds)[:20])}"
    for option, topic in (("--left-topic", options.left_topic), ("--right-topic", options.right_topic)):
        if topic is not None and topic not in images:
            raise InputError(f"{path}: {option} {topic} has no images; topics with images: {shown}")
    if options.left_topic is not None and options.left_topic == options.right_topic:
        raise InputError(f"--left-topic and --right-topic are both {options.left_topic}; give two topics")
    if options.left_topic is not None and options.right_topic is not None:
        return options.left_topic, options.right_topic
    # compressed images beside the same ones raw
    images = [topic for topic in images if _base(topic) == topic or _base(topic) not in images]
    depth = [topic for topic in images if _is_depth(bag, topic)]
    usable = [topic for topic in images if topic not in depth]
    aligned = [topic for topic in depth if "aligned" in topic.lower()] or depth
    if len(usable) == 1 and len(aligned) == 1:
        return usable[0], aligned[0]
    if len(usable) < 2:
        raise InputError(f"{path}: a stereo pair needs two topics with images; topics with images: {shown}")
    left = options.left_topic or _only(usable, ("left", "cam0", "camera0", "cam_0", "infra1"))
    right = options.right_topic or _only(usable, ("right", "cam1", "camera1", "cam_1", "infra2"))
    if left is None or right is None or left == right:
        raise InputError(
            f"{path}: which topic is the left camera's? give --left-topic and --right-topic; topics with "
            f"images: {shown}"
        )
    return left, right


def _only(topics: Sequence[str], marks: Sequence[str]) -> str | None:
    """The topic whose name has one of the marks; of one raw and rectified, the raw one; None: several or
    none."""
    found = [topic for topic in topics if any(mark in topic.lower() for mark in marks)]
    plain_ones = [topic for topic in found if "rect" not in topic.rpartition("/")[2]]
    return plain_ones[0] if len(plain_ones) == 1 else found[0] if len(found) == 1 else None


def _base(topic: str) -> str:
    return topic.removesuffix("/compressed").removesuffix("/compressedDepth")


def _is_depth(bag: _Bag, topic: str) -> bool:
    """Whether a topic has depth images, by a part of its name, and by the encoding of its first message."""
    encoding = bag.first_encoding(topic)
    if encoding in DEPTH_ENCODINGS:
        return encoding == "32FC1" or not re.search(r"infra|mono|/ir/|left|right|cam\d", topic.lower())
    return "compressedDepth" in encoding


def _topics_in_words(topics: Sequence[str], ranges: RangeModel | None) -> str:
    if ranges is None:
        return f"left {topics[0]}, right {topics[1]}"
    return f"images {topics[0]}, ranges {topics[1]}, {ranges.scale_m:g} m per unit (--range-scale-m)"


def _range_model(bag: _Bag, topics: Sequence[str], options: ImportOptions) -> RangeModel | None:
    """What the values of a depth topic mean; None: the second topic is a camera's. Raises InputError."""
    if not _is_depth(bag, topics[1]) or _is_depth(bag, topics[0]):
        return None
    if options.range_sigma_m is None:
        raise InputError(
            f"{bag.path}: {topics[1]} has depth images; give --range-sigma-m, the standard deviation of a "
            "pixel [m], and --range-growth-per-m if it grows with the square of the depth"
        )
    scale_m = options.range_scale_m or DEPTH_UNIT_M
    return RangeModel(scale_m, options.range_sigma_m, options.range_growth_per_m or 0.0)


def _doubts_of_alignment(bag: _Bag, topics: Sequence[str]) -> list[str]:
    """A warning if depth images are of another frame than the images."""
    frames = [plain(bag.first(topic).header.frame_id) for topic in topics]
    if frames[0] == frames[1]:
        return []
    return [
        f"{bag.path}: {topics[1]} is of frame {frames[1]}, {topics[0]} of {frames[0]}: ranges must be of the "
        "pixels of the images; record depth that is aligned to them"
    ]


def _chosen_part(left: Ints, right: Ints) -> tuple[int, int]:
    """The longest part by the left images, and the number of parts.

    Where the clock of one camera alone was set it is the first one: only before that do the two agree.
    """
    counts = [int(each.max(initial=0)) + 1 for each in (left, right)]
    same = counts[0] == counts[1] and len(left) > 0
    return int(np.bincount(left).argmax()) if same else 0, max(counts)


def recorded_parts(stamps_ns: Sequence[int] | Ints, logged_ns: Ints | None) -> Ints:
    """The part (n,) of a recording that each message belongs to: a new one begins where a clock was set back.

    stamps_ns: (n,) of messages as they are read, by time of recording; logged_ns: those times in the order of
    recording; None: messages are read in that order.
    """
    times = np.asarray(stamps_ns, dtype=np.int64)
    order = np.arange(len(times))
    if logged_ns is not None and len(logged_ns) == len(times):
        order[np.argsort(logged_ns, kind="stable")] = np.arange(len(times))
    recorded, parts, part = times[order], np.zeros(len(times), dtype=np.int64), 0
    usual_ns = float(np.median(np.abs(np.diff(recorded)))) if len(recorded) > 1 else 0.0
    before: list[int] = []
    for number, stamp in zip(order.tolist(), recorded.tolist(), strict=True):
        if before and stamp < before[-1]:
            at = bisect_left(before, stamp)
            nearest_ns = min(abs(stamp - each) for each in before[max(at - 1, 0) : at + 1])
            # a message that comes late has a gap that it fits into
            if at == 0 or nearest_ns < FITS * usual_ns:
                part, before = part + 1, []
        insort(before, stamp)
        parts[number] = part
    return parts


def _pose_topic(bag: _Bag, options: ImportOptions) -> str | None:
    """The topic of the inspector's poses; without a choice of the user, odometry if there is one alone."""
    known = sorted(topic for topic, kind in bag.kinds.items() if kind in POSES)
    if options.poses is None:
        odometry = [topic for topic in known if bag.kinds[topic] == ODOMETRY]
        return odometry[0] if len(odometry) == 1 else None
    if options.poses == "none" or options.poses.startswith("tf:"):
        return None
    if options.poses not in known:
        raise InputError(
            f"{bag.path}: --poses {options.poses} has no poses; topics with poses: "
            f"{', '.join(known) or 'none'}; or give tf:FRAME"
        )
    return options.poses


def _info(bag: _Bag, topic: str) -> CameraInfo:
    message = bag.first(topic)
    K, R, P, D = (
        np.asarray(getattr(message, name if bag.is_ros1 else name.lower()), np.float64) for name in "KRPD"
    )
    source, size = f"{bag.path}, {topic}", (int(message.width), int(message.height))
    model, frame = str(message.distortion_model), str(message.header.frame_id)
    shapes = K.reshape(3, 3), R.reshape(3, 3), P.reshape(3, 4)
    return CameraInfo(source, *size, model, tuple(D.tolist()), *shapes, frame)


def _rig(
    bag: _Bag, topics: Sequence[str], info_topics: Sequence[str], frames: Frames, has_ranges: bool
) -> tuple[Rig, list[str]]:
    """The calibration in the bag, of the first camera alone with ranges, and warnings.

    Raises InputError where the bag has none.
    """
    cameras = 1 if has_ranges else 2
    for topic, name in list(zip(topics, info_topics, strict=True))[:cameras]:
        if name not in bag.firsts:
            raise InputError(
                f"{bag.path}: {name} is missing, the calibration of {topic}; give --calibration FILE"
            )
    rectified = "rect" in _base(topics[0]).rpartition("/")[2]
    if has_ranges:
        return with_virtual_camera(read_one(_info(bag, info_topics[0]), rectified)), []
    infos = [_info(bag, name) for name in info_topics]
    X_tf = frames.fixed(infos[0].frame, infos[1].frame) if not rectified else None
    if rectified and not shift_between(infos).any():
        # cameras that were turned alike differ by their places alone
        X_tf = frames.fixed(infos[0].frame, infos[1].frame)
        if X_tf is not None and abs(X_tf[:3, :3] - np.eye(3)).max() < 1e-3 and X_tf[:3, 3].any():
            return rig_of(infos, True, X_tf + 0.0), []
    if rectified or X_tf is None or not abs(X_tf[:3, 3]).any():
        return rig_of(infos, rectified), []
    if not shift_between(infos).any() or rig_of(infos).remarks:
        return rig_of(infos, X_01=X_tf + 0.0), []
    rig = rig_of(infos)
    # smaller differences between tf and camera_info, in metres and in the matrix, are rounding
    if abs(rig.right.X_BC - X_tf)[:3].max() < 1e-9:
        return rig_of(infos, X_01=X_tf + 0.0), []
    return rig, [
        f"{bag.path}: tf places the right camera "
        f"{1e3 * np.linalg.norm(rig.right.X_BC[:3, 3] - X_tf[:3, 3]):.3g} mm from where camera_info does; "
        "camera_info is used, give --calibration for another one"
    ]


def _poses(
    bag: _Bag,
    options: ImportOptions,
    topic: str | None,
    messages: Sequence[Any],
    frames: Frames,
    camera: str,
    images_ns: Ints,
) -> tuple[Poses | None, list[str], list[str]]:
    """The inspector's poses, and notes and warnings about them. ``camera``: frame of the left camera."""
    path = bag.path
    if (options.poses or "").startswith("tf:"):
        fixed = str(options.poses)[3:]
        at = frames.over_time(fixed, camera, images_ns)
        if at is None:
            known = ", ".join(frames.names()) or "none"
            raise InputError(
                f"{path}: tf does not link {fixed} and the left camera ({camera}); frames: {known}"
            )
        X_NC, covered = at
        if not covered.any():
            raise InputError(f"{path}: tf of {fixed} covers no image; are they of one clock?")
        return Poses(images_ns[covered], X_NC[covered], X_BC0=np.eye(4)), [], []
    if topic is None:
        others = sorted(name for name, kind in bag.kinds.items() if kind in POSES)
        if not others or options.poses is not None:
            return None, [], []
        unused = f"poses of {', '.join(others)} are not used: the cameras are taken to be at rest"
        return None, [f"{unused} (--poses TOPIC)"], []
    kind, name = bag.kinds[topic], f"{path}, {topic}"
    rows = [(header_ns(message), *pose_of(message, kind, name)) for message in messages]
    if not rows:
        raise InputError(f"{path}: no pose in {topic}; choose another topic, or --poses none")
    body = options.pose_of or rows[0][2]
    X_BC0 = np.eye(4) if body == "left" else frames.fixed(body, camera) if body else None
    if X_BC0 is None and body != "body":
        which = f"frame {body!r}" if body else "an unnamed frame"
        line = (
            f"{topic} has poses of {which}, which tf_static does not link to the left camera "
            f"({camera or 'unnamed'})"
        )
        if options.poses is None:
            return None, [], [f"{path}: {line}; not used, the cameras are taken to be at rest"]
        raise InputError(
            f"{path}: {line}; give --pose-of left if they are of the left camera, --pose-of body if of the "
            "body that the calibration refers to, or another frame"
        )
    times, first = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_index=True)
    sigmas = _sigmas([rows[k][4] for k in first])
    poses = Poses(times, np.stack([rows[k][3] for k in first]), *sigmas, X_BC0=X_BC0)
    return poses, [f"inspector poses: {topic}, of {body} (--poses none: cameras at rest)"], []


def _sigmas(covariances: Sequence[Array | None]) -> tuple[float, float]:
    """Standard deviations of position [m] and attitude [rad], medians over the poses; 0: none are stated."""
    diagonals = np.array([np.diag(each) for each in covariances if each is not None])
    if not len(diagonals) or not np.isfinite(diagonals).all() or (diagonals < 0.0).any():
        return 0.0, 0.0
    variances = np.median(diagonals.reshape(-1, 2, 3).mean(axis=2), axis=0)
    return float(np.sqrt(variances[0])), float(np.sqrt(variances[1]))
