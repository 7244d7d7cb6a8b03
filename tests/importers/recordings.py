"""A dataset written as recordings of other programs: bags of ROS, videos, folders with calibrations.

The images, times and numbers are those of the dataset, so that an import must bring them back.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from polhode.files.tables import read_listing
from polhode.geometry.lie import Array, inverse_pose, wxyz_from_matrix
from polhode.importers.sources.ros_bag import message_types
from polhode.importers.sources.ros_messages import CAMERA_INFO, ODOMETRY, TRANSFORMS
from polhode.records.rig_calibration import StereoCalibration, read_calibration

FRAMES = ("left_optical", "right_optical")
TOPICS = ("/stereo/left/image_raw", "/stereo/right/image_raw")


@dataclass(frozen=True)
class Original:
    """The dataset that is written as something else."""

    folder: Path
    calibration: StereoCalibration
    files: tuple[dict[int, Path], dict[int, Path]]
    """Timestamp [ns] -> image, of each camera"""

    def pixels(self, camera: int, stamp: int) -> NDArray[Any]:
        """(H, W) or (H, W, 3) as the file has them."""
        return np.asarray(Image.open(self.files[camera][stamp]))

    @property
    def K(self) -> tuple[Array, Array]:
        """Camera matrices."""
        return self.calibration.K0, self.calibration.K1

    @property
    def dist(self) -> tuple[Array, Array]:
        """Coefficients of distortion."""
        return self.calibration.dist0, self.calibration.dist1

    @property
    def X_01(self) -> Array:
        """(4, 4) right camera in the left one."""
        if np.array_equal(self.calibration.X_BC0, np.eye(4)):
            return self.calibration.X_BC1
        return inverse_pose(self.calibration.X_BC0) @ self.calibration.X_BC1

    @property
    def X_10(self) -> Array:
        """(4, 4) left camera in the right one."""
        return inverse_pose(self.X_01) + 0.0


def original(folder: Path, frames: int | None = None) -> Original:
    """A dataset, or its first frames."""
    mav0 = folder / "mav0"
    files = []
    for camera in ("cam0", "cam1"):
        names = list(read_listing(mav0 / camera / "data.csv").items())[:frames]
        files.append({stamp: mav0 / camera / "data" / name for stamp, name in names})
    return Original(folder, read_calibration(mav0), (files[0], files[1]))


def write_folders(data: Original, folder: Path, right_later_ns: int = 0) -> tuple[Path, Path]:
    """Two folders of images, named by their times."""
    folders = folder / "left", folder / "right"
    for camera, place in enumerate(folders):
        place.mkdir(parents=True)
        for stamp, path in data.files[camera].items():
            shutil.copy(path, place / f"{stamp + camera * right_later_ns}.png")
    return folders


def write_kalibr(data: Original, path: Path) -> Path:
    """A camchain."""
    chain: dict[str, Any] = {}
    for camera, (K, dist) in enumerate(zip(data.K, data.dist, strict=True)):
        chain[f"cam{camera}"] = {
            "camera_model": "pinhole",
            "distortion_coeffs": dist.tolist(),
            "distortion_model": "radtan",
            "intrinsics": [K[0, 0].item(), K[1, 1].item(), K[0, 2].item(), K[1, 2].item()],
            "resolution": list(data.calibration.size_px(camera)),
            "rostopic": TOPICS[camera],
        }
    chain["cam1"]["T_cn_cnm1"] = data.X_10.tolist()
    path.write_text(yaml.safe_dump(chain))
    return path


def write_opencv(data: Original, path: Path, unit_m: float = 1.0) -> Path:
    """A file of OpenCV's FileStorage, YAML or JSON by its suffix."""
    import cv2

    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for camera, (K, dist) in enumerate(zip(data.K, data.dist, strict=True), start=1):
        storage.write(f"M{camera}", K)
        storage.write(f"D{camera}", dist[None])
    storage.write("R", data.X_10[:3, :3].copy())
    storage.write("T", data.X_10[:3, 3:].copy() / unit_m)
    storage.write("image_width", data.calibration.width_px)
    storage.write("image_height", data.calibration.height_px)
    storage.release()
    return path


def rectified(data: Original) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """R (3, 3) and P (3, 4) of both cameras, as ROS states them: p_1 = R_1^T (R_0 p_0 + P_1[:, 3] / f)."""
    X_10, f = data.X_10, data.calibration.K0[0, 0]
    t = X_10[:3, 3]
    if np.array_equal(X_10[:3, :3], np.eye(3)) and not t[1:].any():
        rotations: tuple[Array, Array] = (np.eye(3), np.eye(3))
    else:
        # rows of R_1 are the axes of the rectified cameras, the first along the baseline
        x = -t / np.linalg.norm(t)
        z = np.cross(x, [0.0, 1.0, 0.0])
        z /= np.linalg.norm(z)
        R_1 = np.stack([x, np.cross(z, x), z])
        rotations = (R_1 @ X_10[:3, :3], R_1)
    width = float(np.linalg.norm(t)) if t[1:].any() else -float(t[0])
    matrices = []
    for product in (0.0, -f * width):
        P = np.zeros((3, 4))
        P[:, :3], P[0, 3] = [[f, 0.0, 320.0], [0.0, f, 240.0], [0.0, 0.0, 1.0]], product
        matrices.append(P)
    return rotations, (matrices[0], matrices[1])


def _five(dist: Array) -> list[float]:
    """ROS's plumb_bob has five coefficients."""
    return [*dist.tolist(), 0.0] if len(dist) == 4 else dist.tolist()


def write_camera_info(data: Original, folder: Path) -> tuple[Path, Path]:
    """left.yaml and right.yaml of camera_calibration."""
    R, P = rectified(data)
    paths = folder / "left.yaml", folder / "right.yaml"
    for camera, path in enumerate(paths):
        D = _five(data.dist[camera])
        matrices = {
            "camera_matrix": data.K[camera],
            "distortion_coefficients": np.array([D]),
            "rectification_matrix": R[camera],
            "projection_matrix": P[camera],
        }
        content: dict[str, Any] = {
            "image_width": data.calibration.width_px,
            "image_height": data.calibration.height_px,
            "camera_name": path.stem,
            "distortion_model": "plumb_bob" if len(D) == 5 else "rational_polynomial",
        }
        for name, values in matrices.items():
            rows, columns = values.shape
            content[name] = {"rows": rows, "cols": columns, "data": values.ravel().tolist()}
        path.write_text(yaml.safe_dump(content))
    return paths


@dataclass(frozen=True)
class BagContents:
    """What a bag gets."""

    right_later_ns: int = 0
    compressed: bool = False
    info: bool = True
    tf: bool = True
    cameras: tuple[int, ...] = (0, 1)
    odometry: Array | None = None
    """(F, 4, 4) poses of base_link in odom at the left images"""
    posestamped: Array | None = None
    moving_tf: Array | None = None
    """(F, 4, 4) poses of base_link in map, as tf"""
    X_BC0: Array | None = None
    """(4, 4) left camera in base_link, as tf_static"""


def write_ros1(
    data: Original, path: Path, contents: BagContents | None = None, compression: str = ""
) -> Path:
    """A bag of ROS 1."""
    from rosbags.rosbag1 import Writer

    bag = Writer(path)
    if compression:
        bag.set_compression(Writer.CompressionFormat[compression])
    with bag:
        _fill(bag, data, contents or BagContents(), True)
    return path


def write_ros2(
    data: Original, path: Path, contents: BagContents | None = None, storage: str = "SQLITE3"
) -> Path:
    """A bag of ROS 2, with SQLITE3 or MCAP."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        _fill(bag, data, contents or BagContents(), False)
    return path


def _fill(bag: Any, data: Original, contents: BagContents, is_ros1: bool) -> None:
    """Messages sorted by time."""
    store = message_types(is_ros1)

    def make(kind: str, *values: Any, **named: Any) -> Any:
        package, name = kind.split("/")
        return store.types[f"{package}/msg/{name}"](*values, **named)

    def header(time: int, frame: str) -> Any:
        stamp = make("builtin_interfaces/Time", sec=time // 10**9, nanosec=time % 10**9)
        return make("std_msgs/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if is_ros1 else {}))

    def parts(X: Array, kind: str = "Point") -> tuple[Any, Any]:
        """Place (a Point or a Vector3) and attitude."""
        x, y, z = X[:3, 3].tolist()
        w, i, j, k = wxyz_from_matrix(X[:3, :3]).tolist()
        quaternion = make("geometry_msgs/Quaternion", x=i, y=j, z=k, w=w)
        return make(f"geometry_msgs/{kind}", x=x, y=y, z=z), quaternion

    def image(time: int, frame: str, path: Path) -> Any:
        if contents.compressed:
            png = np.frombuffer(path.read_bytes(), np.uint8)
            return make("sensor_msgs/CompressedImage", header(time, frame), "png", png)
        pixels = np.ascontiguousarray(np.asarray(Image.open(path)))
        height, width = pixels.shape[:2]
        encoding = {2: "mono8" if pixels.dtype == np.uint8 else "mono16", 3: "rgb8"}[pixels.ndim]
        step, content = pixels.nbytes // height, pixels.view(np.uint8).ravel()
        return make("sensor_msgs/Image", header(time, frame), height, width, encoding, 0, step, content)

    def camera_info(time: int, camera: int) -> Any:
        D = _five(data.dist[camera])
        values = {"D": np.array(D), "K": data.K[camera].ravel(), "R": R[camera].ravel()}
        values["P"] = P[camera].ravel()
        return make(
            "sensor_msgs/CameraInfo",
            header=header(time, FRAMES[camera]),
            height=data.calibration.height_px,
            width=data.calibration.width_px,
            distortion_model="plumb_bob" if len(D) == 5 else "rational_polynomial",
            binning_x=0,
            binning_y=0,
            roi=make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False),
            **{name if is_ros1 else name.lower(): value for name, value in values.items()},
        )

    def tf(time: int, *transforms: tuple[str, str, Array]) -> Any:
        made = [
            make(
                "geometry_msgs/TransformStamped",
                header(time, parent),
                child,
                make("geometry_msgs/Transform", *parts(X, "Vector3")),
            )
            for parent, child, X in transforms
        ]
        return make("tf2_msgs/TFMessage", transforms=made)

    def odometry(time: int, X: Array) -> Any:
        covariance = np.diag([1e-6] * 3 + [4e-6] * 3).ravel()
        zero = parts(np.eye(4), "Vector3")[0]
        twist = make("geometry_msgs/Twist", linear=zero, angular=zero)
        return make(
            "nav_msgs/Odometry",
            header=header(time, "odom"),
            child_frame_id="base_link",
            pose=make("geometry_msgs/PoseWithCovariance", make("geometry_msgs/Pose", *parts(X)), covariance),
            twist=make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36)),
        )

    def pose_stamped(time: int, X: Array) -> Any:
        pose = make("geometry_msgs/Pose", *parts(X))
        return make("geometry_msgs/PoseStamped", header=header(time, "odom"), pose=pose)

    rows: list[tuple[int, str, str, Any]] = []
    R, P = rectified(data)
    for camera in contents.cameras:
        topic, frame = TOPICS[camera], FRAMES[camera]
        kind, end = ("CompressedImage", "/compressed") if contents.compressed else ("Image", "")
        for stamp, path in data.files[camera].items():
            time = stamp + camera * contents.right_later_ns
            rows.append((time, f"{topic}{end}", f"sensor_msgs/msg/{kind}", image(time, frame, path)))
            if contents.info:
                info = camera_info(time, camera)
                rows.append((time, f"{topic.rpartition('/')[0]}/camera_info", CAMERA_INFO, info))
    stamps = list(data.files[0])
    fixed = [(FRAMES[0], FRAMES[1], data.X_01)] if contents.tf else []
    fixed += [] if contents.X_BC0 is None else [("base_link", FRAMES[0], contents.X_BC0)]
    if fixed:
        rows.append((stamps[0], "/tf_static", TRANSFORMS[0], tf(stamps[0], *fixed)))
    for poses, topic, kind, message in (
        (contents.odometry, "/odom", ODOMETRY, odometry),
        (contents.posestamped, "/pose", "geometry_msgs/msg/PoseStamped", pose_stamped),
        (contents.moving_tf, "/tf", TRANSFORMS[0], lambda time, X: tf(time, ("map", "base_link", X))),
    ):
        for time, X in zip(stamps, () if poses is None else poses, strict=False):
            rows.append((time, topic, kind, message(time, X)))
    connections: dict[str, Any] = {}
    serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    for time, topic, kind, message in sorted(rows, key=lambda row: row[:2]):
        if topic not in connections:
            connections[topic] = bag.add_connection(topic, kind, typestore=store)
        bag.write(connections[topic], time, serialize(message, kind))


def write_video(images: Iterable[NDArray[Any]], path: Path, rate_hz: int = 2) -> Path:
    """A video without loss of grey images (H, W)."""
    import av

    with av.open(str(path), "w") as container:
        stream: Any = None
        for k, image in enumerate(images):
            if stream is None:
                stream = container.add_stream("ffv1", rate=rate_hz)
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "gray" if image.dtype == np.uint8 else "gray16le"
                stream.time_base = Fraction(1, rate_hz)
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=stream.pix_fmt)
            frame.pts, frame.time_base = k, Fraction(1, rate_hz)
            container.mux(stream.encode(frame))
        if stream is not None:
            container.mux(stream.encode())
    return path


def write_side_by_side(data: Original, path: Path) -> Path:
    """One video of both cameras."""
    pairs = (np.hstack([data.pixels(0, stamp), data.pixels(1, stamp)]) for stamp in data.files[0])
    return write_video(pairs, path)
