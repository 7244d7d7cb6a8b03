"""Bags of ROS 1 and of ROS 2 (sqlite3 and MCAP), read by the library rosbags.

The bag is read twice: for times, calibration and poses, then for the images that are wanted, each of which is
decoded once. Messages are read by ROS's own definitions of their types, never by those that a bag brings.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.importers.calibrations.camera_info import CameraInfo, rig_of
from polhode.importers.calibrations.rig import Rig
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents, FramedImage, Poses, Wanted
from polhode.importers.sources.ros_frames import Frames, plain
from polhode.importers.sources.ros_messages import (
    CAMERA_INFO,
    COMPRESSED,
    ODOMETRY,
    POSES,
    RAW,
    TRANSFORMS,
    header_ns,
    image_of,
    pose_of,
    stamp_of,
)
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import require_part
from polhode.runtime.progress import Progress

SAME_PLACE_M, SAME_TURN = 1e-9, 1e-9
"""Differences between tf and camera_info that are rounding."""
_LEFT, _RIGHT = (
    ("left", "cam0", "camera0", "cam_0", "infra1"),
    ("right", "cam1", "camera1", "cam_1", "infra2"),
)


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
    with _readable(path):
        reader = _reader(path)
        reader.open()
    try:
        yield _indexed(path, reader, options, progress)
    finally:
        reader.close()


@dataclass(frozen=True)
class _Stream:
    """The images of one camera."""

    topic: str
    kind: str
    order: dict[int, int]
    """Number of the message -> index into the sorted timestamps"""


@dataclass(frozen=True)
class RosBag:
    """An opened bag."""

    name: str
    contents: Contents
    _path: Path = field(repr=False)
    _reader: Any = field(repr=False)
    _store: "_Store" = field(repr=False)
    _streams: tuple[_Stream, _Stream] = field(repr=False)

    def images(self, wanted: Wanted) -> Iterator[FramedImage]:
        """The wanted images, in the order in which they were recorded."""
        counts = [0, 0]
        topics = [stream.topic for stream in self._streams]
        left = len(wanted[0]) + len(wanted[1])
        for topic, _, content in _messages(self._path, self._reader, topics):
            camera = topics.index(topic)
            stream, number = self._streams[camera], counts[camera]
            counts[camera] += 1
            index = stream.order.get(number)
            if index is None or index not in wanted[camera]:
                continue
            name = f"{self._path}, {topic}, image {number}"
            with _readable(self._path):
                image = image_of(self._store.read(content, stream.kind), stream.kind, name)
            yield FramedImage(camera, index, image, name)
            left -= 1
            if not left:
                return


@dataclass(frozen=True)
class _Store:
    """ROS's definitions of the types of messages."""

    is_ros1: bool
    types: Any

    def read(self, content: bytes, kind: str) -> Any:
        """A message; raises what the library raises for content that is none."""
        kind = TRANSFORMS[0] if kind in TRANSFORMS else kind
        read = self.types.deserialize_ros1 if self.is_ros1 else self.types.deserialize_cdr
        return read(content, kind)


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


def _reader(path: Path) -> Any:
    if path.suffix == ".bag":
        from rosbags.rosbag1 import Reader as Reader1

        return Reader1(path)
    from rosbags.rosbag2 import Reader as Reader2

    return Reader2(path)


def message_types(is_ros1: bool) -> Any:
    """ROS's own definitions of the types of messages that are read here."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if TRANSFORMS[0] not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS[0]))
    return store


def _messages(path: Path, reader: Any, topics: Sequence[str]) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time of recording [ns] and content of each message."""
    with _readable(path):
        connections = [each for each in reader.connections if each.topic in topics]
        messages = iter(reader.messages(connections=connections)) if connections else iter(())
    while True:
        with _readable(path):
            found = next(messages, None)
        if found is None:
            return
        yield found[0].topic, int(found[1]), bytes(found[2])


def _indexed(path: Path, reader: Any, options: ImportOptions, progress: Progress) -> RosBag:
    kinds = {each.topic: str(each.msgtype) for each in reader.connections if each.msgcount}
    if not kinds:
        raise InputError(f"{path}: an empty bag, without a single message; record it again")
    topics = _image_topics(path, kinds, options)
    infos = [_info_topic(topic, kinds) for topic in topics]
    pose_topic = _pose_topic(path, kinds, options)
    trees = [
        topic for topic, kind in kinds.items() if kind in TRANSFORMS and plain(topic) in ("tf", "tf_static")
    ]
    is_ros1 = path.suffix == ".bag"
    store = _Store(is_ros1, message_types(is_ros1))
    read = [*topics, *(info for info in infos if info), *trees, *([pose_topic] if pose_topic else [])]
    found = _Found()
    total = sum(each.msgcount for each in reader.connections if each.topic in read)
    with progress.stage("reading times", total) as advance:
        for topic, logged_ns, content in _messages(path, reader, read):
            with _readable(path):
                if topic in topics:
                    found.times_ns.setdefault(topic, []).append(stamp_of(content, store.is_ros1))
                    found.logged_ns.setdefault(topic, []).append(logged_ns)
                    found.firsts.setdefault(topic, content)
                elif kinds[topic] == CAMERA_INFO:
                    found.firsts.setdefault(topic, content)
                elif topic in trees:
                    is_static = plain(topic) == "tf_static"
                    found.frames.add(store.read(content, kinds[topic]), is_static, f"{path}, {topic}")
                else:
                    found.poses.append(store.read(content, kinds[topic]))
            advance()
    streams, stamps, warnings = [], [], []
    for topic in topics:
        stream, stamps_ns, said = _stream(path, topic, kinds[topic], found)
        streams.append(stream)
        stamps.append(stamps_ns)
        warnings += said
    notes = [f"left {topics[0]}, right {topics[1]}"]
    rig, said = (None, []) if options.calibration else _rig(path, topics, infos, store, found)
    frame = _camera_frame(topics[0], infos[0], kinds, store, found)
    poses, remarks = _poses(path, options, pose_topic, kinds, found, frame, stamps[0])
    contents = Contents(
        (stamps[0], stamps[1]),
        rig,
        poses,
        notes=(*notes, *remarks[0]),
        warnings=(*warnings, *said, *remarks[1]),
    )
    return RosBag(str(path), contents, path, reader, store, (streams[0], streams[1]))


@dataclass
class _Found:
    """What the first reading collects."""

    times_ns: dict[str, list[int]] = field(default_factory=dict)
    logged_ns: dict[str, list[int]] = field(default_factory=dict)
    firsts: dict[str, bytes] = field(default_factory=dict)
    """First message of each camera_info and image topic"""
    frames: Frames = field(default_factory=Frames)
    poses: list[Any] = field(default_factory=list)


def _image_topics(path: Path, kinds: dict[str, str], options: ImportOptions) -> tuple[str, str]:
    """Left and right. Raises InputError when they are not there, or cannot be remarks apart."""
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
    left = options.left_topic or _only(usable, _LEFT)
    right = options.right_topic or _only(usable, _RIGHT)
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


def _is_rectified(topic: str) -> bool:
    return "rect" in _base(topic).rpartition("/")[2]


def _info_topic(topic: str, kinds: dict[str, str]) -> str | None:
    """The camera_info beside an image topic."""
    name = f"{_base(topic).rpartition('/')[0]}/camera_info"
    return name if kinds.get(name) == CAMERA_INFO else None


def _pose_topic(path: Path, kinds: dict[str, str], options: ImportOptions) -> str | None:
    """The topic of the inspector's poses; without a choice of the user, odometry if there is one alone."""
    if options.poses == "none" or (options.poses or "").startswith("tf:"):
        return None
    known = sorted(topic for topic, kind in kinds.items() if kind in POSES)
    if options.poses is not None:
        if options.poses not in known:
            shown = ", ".join(known) or "none"
            raise InputError(
                f"{path}: --poses {options.poses} has no poses; topics with poses: {shown}; or give tf:FRAME"
            )
        return options.poses
    odometry = [topic for topic in known if kinds[topic] == ODOMETRY]
    return odometry[0] if len(odometry) == 1 else None


def _stream(path: Path, topic: str, kind: str, found: _Found) -> tuple[_Stream, Ints, list[str]]:
    """Messages of a camera sorted by time; of those with the same time the first one."""
    times = np.array(found.times_ns.get(topic, []), dtype=np.int64)
    warnings = []
    if not len(times):
        raise InputError(f"{path}: no image in {topic}; record it again, or choose another topic")
    if not times.any():
        times = np.array(found.logged_ns[topic], dtype=np.int64)
        warnings.append(f"{path}: {topic} has no timestamps; the times of recording are taken, which scatter")
    unique, first = np.unique(times, return_index=True)
    if len(unique) < len(times):
        warnings.append(f"{path}: {len(times) - len(unique)} images of {topic} repeat a timestamp; not used")
    return _Stream(topic, kind, {int(number): index for index, number in enumerate(first)}), unique, warnings


def _info(path: Path, topic: str, store: _Store, found: _Found) -> CameraInfo:
    with _readable(path):
        message = store.read(found.firsts[topic], CAMERA_INFO)
    values = {name.upper(): np.asarray(getattr(message, name), dtype=np.float64)
              for name in (("K", "R", "P", "D") if store.is_ros1 else ("k", "r", "p", "d"))}  # fmt: skip
    return CameraInfo(
        f"{path}, {topic}",
        int(message.width),
        int(message.height),
        str(message.distortion_model),
        tuple(values["D"].tolist()),
        values["K"].reshape(3, 3),
        values["R"].reshape(3, 3),
        values["P"].reshape(3, 4),
        str(message.header.frame_id),
    )


def _rig(
    path: Path, topics: tuple[str, str], info_topics: list[str | None], store: _Store, found: _Found
) -> tuple[Rig, list[str]]:
    """The calibration in the bag, and warnings. Raises InputError where it has none."""
    for topic, info in zip(topics, info_topics, strict=True):
        if info is None:
            name = f"{_base(topic).rpartition('/')[0]}/camera_info"
            raise InputError(
                f"{path}: {name} is missing, the calibration of {topic}; give --calibration FILE"
            )
    infos = [_info(path, info, store, found) for info in info_topics if info]
    rectified = _is_rectified(topics[0])
    X_tf = found.frames.fixed(infos[0].frame, infos[1].frame) if not rectified else None
    if X_tf is None or not abs(X_tf[:3, 3]).any():
        return rig_of(infos, rectified), []
    if not infos[1].P[:2, 3].any():
        return rig_of(infos, X_01=X_tf + 0.0), []
    rig = rig_of(infos)
    off = abs(rig.right.X_BC - X_tf)
    if off[:3, 3].max() < SAME_PLACE_M and off[:3, :3].max() < SAME_TURN:
        return rig_of(infos, X_01=X_tf + 0.0), []
    return rig, [
        f"{path}: tf places the right camera "
        f"{1e3 * np.linalg.norm(rig.right.X_BC[:3, 3] - X_tf[:3, 3]):.3g} mm from where camera_info does; "
        "camera_info is used, give --calibration for another one"
    ]


def _camera_frame(
    topic: str, info_topic: str | None, kinds: dict[str, str], store: _Store, found: _Found
) -> str:
    """Frame of the left camera: of its camera_info, else of its images."""
    name, kind = (info_topic, CAMERA_INFO) if info_topic else (topic, kinds[topic])
    if name not in found.firsts:
        return ""
    with _readable(Path(topic)):
        return plain(store.read(found.firsts[name], kind).header.frame_id)


def _poses(
    path: Path,
    options: ImportOptions,
    topic: str | None,
    kinds: dict[str, str],
    found: _Found,
    camera: str,
    frames_ns: Ints,
) -> tuple[Poses | None, tuple[list[str], list[str]]]:
    """The inspector's poses, and notes and warnings about them."""
    if (options.poses or "").startswith("tf:"):
        return _poses_of_tree(path, str(options.poses)[3:], found.frames, camera, frames_ns), ([], [])
    if topic is None:
        others = sorted(name for name, kind in kinds.items() if kind in POSES)
        if others and options.poses is None:
            return None, ([f"poses of {', '.join(others)} are not used: the cameras are taken to be at rest "
                           "(--poses TOPIC)"], [])  # fmt: skip
        return None, ([], [])
    rows = [
        (header_ns(message), *pose_of(message, kinds[topic], f"{path}, {topic}")) for message in found.poses
    ]
    if not rows:
        raise InputError(f"{path}: no pose in {topic}; choose another topic, or --poses none")
    body = options.pose_of or rows[0][2]
    X_BC0 = np.eye(4) if body == "left" else found.frames.fixed(body, camera) if body else None
    if X_BC0 is None and body != "body":
        which = f"frame {body!r}" if body else "an unnamed frame"
        line = (
            f"{topic} has poses of {which}, which tf_static does not link to the left camera "
            f"({camera or 'unnamed'})"
        )
        if options.poses is None:
            return None, ([], [f"{path}: {line}; not used, the cameras are taken to be at rest"])
        raise InputError(
            f"{path}: {line}; give --pose-of left if they are of the left camera, --pose-of body if of the "
            "body that the calibration refers to, or another frame"
        )
    times, first = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_index=True)
    sigmas = _sigmas([rows[k][4] for k in first])
    poses = Poses(times, np.stack([rows[k][3] for k in first]), *sigmas, X_BC0=X_BC0)
    return poses, ([f"inspector poses: {topic}, of {body} (--poses none: cameras at rest)"], [])


def _poses_of_tree(path: Path, fixed: str, frames: Frames, camera: str, frames_ns: Ints) -> Poses:
    at = frames.over_time(fixed, camera, frames_ns)
    if at is None:
        known = ", ".join(frames.names()) or "none"
        raise InputError(f"{path}: tf does not link {fixed} and the left camera ({camera}); frames: {known}")
    X_NC, covered = at
    if not covered.any():
        raise InputError(f"{path}: tf of {fixed} covers no image; are they of one clock?")
    return Poses(frames_ns[covered], X_NC[covered], X_BC0=np.eye(4))


def _sigmas(covariances: Sequence[Array | None]) -> tuple[float, float]:
    """Standard deviations of position [m] and attitude [rad], medians over the poses; 0: none are stated."""
    diagonals = np.array([np.diag(each) for each in covariances if each is not None])
    if not len(diagonals) or not np.isfinite(diagonals).all() or (diagonals < 0.0).any():
        return 0.0, 0.0
    p, theta = (
        float(np.sqrt(np.median(diagonals[:, part].mean(axis=1)))) for part in (slice(0, 3), slice(3, 6))
    )
    return p, theta
