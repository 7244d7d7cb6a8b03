"""Bags of ROS 1 and of ROS 2 (sqlite3 and MCAP), read by the library rosbags.

The bag is read twice: for times, calibration and poses, then for the images that are wanted, each of which is
decoded once. Messages are read by ROS's own definitions of their types, never by those that a bag brings.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.importers.calibrations.camera_info import CameraInfo, rig_of
from polhode.importers.calibrations.rig import Rig
from polhode.importers.options import ImportOptions
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
    stamp_of,
)
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import require_part
from polhode.runtime.progress import Progress


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its suffix, or the folder that ROS 2 records."""
    if path.is_dir():
        return any(
            each.suffix in (".db3", ".mcap") or each.name == "metadata.yaml" for each in path.iterdir()
        )
    return path.suffix in (".bag", ".db3", ".mcap")


@contextmanager
def opened_bag(path: Path, options: ImportOptions, progress: Progress) -> Iterator["RosBag"]:
    """The bag, its times read. Raises InputError for what is missing, cut off or not there to be chosen."""
    require_part("rosbags", "bags")
    if path.is_dir() and not (path / "metadata.yaml").exists():
        files = sorted(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
        if len(files) != 1:
            raise InputError(f"{path}: metadata.yaml is missing; make it again: ros2 bag reindex {path}")
        path = files[0]
    from rosbags import rosbag1, rosbag2

    with _readable(path):
        reader: Any = rosbag1.Reader(path) if path.suffix == ".bag" else rosbag2.Reader(path)
        reader.open()
    try:
        yield _indexed(path, reader, options, progress)
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
        """The wanted images, in the order in which they were recorded."""
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
                image = image_of(self._bag.decoded(topic, content), self._bag.kinds[topic], name)
            yield FramedImage(camera, index, image, name)
            left -= 1
            if not left:
                return


class _Bag:
    """The messages of a bag, and the first of each topic that was read."""

    def __init__(self, path: Path, reader: Any) -> None:
        """Raises InputError for a bag without messages."""
        self.path, self.is_ros1, self._reader = path, path.suffix == ".bag", reader
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
        repair = "rosbag reindex" if path.suffix == ".bag" else "ros2 bag reindex"
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


def _indexed(path: Path, reader: Any, options: ImportOptions, progress: Progress) -> RosBag:
    """Times, calibration and poses, by a first reading."""
    bag = _Bag(path, reader)
    kinds, topics = bag.kinds, _image_topics(bag, options)
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
    orders, stamps, warnings = {}, [], []
    for topic in topics:
        # of messages with the same time the first one
        times = np.array(times_ns[topic], dtype=np.int64)
        if not len(times):
            raise InputError(f"{path}: no image in {topic}; record it again, or choose another topic")
        if not times.any():
            times = np.array(logged_ns[topic], dtype=np.int64)
            warnings.append(
                f"{path}: {topic} has no timestamps; the times of recording are taken, which scatter"
            )
        unique, first = np.unique(times, return_index=True)
        if repeated := len(times) - len(unique):
            warnings.append(f"{path}: {repeated} images of {topic} repeat a timestamp; not used")
        orders[topic] = {int(number): index for index, number in enumerate(first)}
        stamps.append(unique)
    rig, said = (None, []) if options.calibration else _rig(bag, topics, infos, frames)
    # frame of the left camera: of its camera_info, else of its images
    named = next((name for name in (infos[0], topics[0]) if name in bag.firsts), None)
    camera = plain(bag.first(named).header.frame_id) if named else ""
    poses, notes, remarks = _poses(bag, options, pose_topic, messages, frames, camera, stamps[0])
    contents = Contents(
        (stamps[0], stamps[1]),
        rig,
        poses,
        notes=(f"left {topics[0]}, right {topics[1]}", *notes),
        warnings=(*warnings, *said, *remarks),
    )
    return RosBag(str(path), contents, bag, orders)


def _image_topics(bag: _Bag, options: ImportOptions) -> tuple[str, str]:
    """Left and right. Raises InputError when they are not there, or cannot be told apart."""
    path, kinds = bag.path, bag.kinds
    images = sorted(topic for topic, kind in kinds.items() if kind in (RAW, COMPRESSED))
    shown = ", ".join(images) or f"none among {', '.join(sorted(kinds))}"
    for option, topic in (("--left-topic", options.left_topic), ("--right-topic", options.right_topic)):
        if topic is not None and topic not in images:
            raise InputError(f"{path}: {option} {topic} has no images; topics with images: {shown}")
    if options.left_topic is not None and options.left_topic == options.right_topic:
        raise InputError(f"--left-topic and --right-topic are both {options.left_topic}; give two topics")
    usable = [topic for topic in images if "depth" not in topic.lower()]
    # compressed images beside the same ones raw
    usable = [topic for topic in usable if not (kinds[topic] == COMPRESSED and _base(topic) in usable)]
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
    return topic.removesuffix("/compressed")


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
    bag: _Bag, topics: Sequence[str], info_topics: Sequence[str], frames: Frames
) -> tuple[Rig, list[str]]:
    """The calibration in the bag, and warnings. Raises InputError where it has none."""
    for topic, name in zip(topics, info_topics, strict=True):
        if name not in bag.firsts:
            raise InputError(
                f"{bag.path}: {name} is missing, the calibration of {topic}; give --calibration FILE"
            )
    infos = [_info(bag, name) for name in info_topics]
    rectified = "rect" in _base(topics[0]).rpartition("/")[2]
    X_tf = frames.fixed(infos[0].frame, infos[1].frame) if not rectified else None
    if X_tf is None or not abs(X_tf[:3, 3]).any():
        return rig_of(infos, rectified), []
    if not infos[1].P[:2, 3].any():
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
