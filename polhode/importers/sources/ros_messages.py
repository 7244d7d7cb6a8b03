"""Messages of ROS: images as grey pixels, poses as matrices, and the tree of frames (tf)."""

import re
import struct
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation, Slerp

from polhode.files.images import Raw
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, make_pose, matrix_from_wxyz
from polhode.importers.sources.recording import DecodedImage, StoredImage
from polhode.records.range_images import RangeModel
from polhode.runtime.errors import InputError

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY = "nav_msgs/msg/Odometry"
POSES = (
    ODOMETRY,
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
_COLOURS = {"rgb8": "RGB", "bgr8": "BGR", "8UC3": "BGR", "rgba8": "RGBA", "bgra8": "BGRA", "8UC4": "BGRA"}
_DEEP_COLOURS = ("rgb", "bgr", "rgba", "bgra")
"""With 16 behind"""
_LUMINANCE = 0.299, 0.587, 0.114
"""Of red, green and blue (ITU-R BT.601), as Pillow weighs them"""
_GREYS = {"mono8": 1, "8UC1": 1, "mono10": 2, "mono12": 2, "mono16": 2, "16UC1": 2}
_LUMA = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Position of the brightness in its two bytes."""
_BAYER = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
"""OpenCV calls a pattern by its second row and column."""
_MAGIC = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"II*\0": ".tiff", b"MM\0*": ".tiff", b"BM": ".bmp"}


def stamp_of(content: bytes, is_ros1: bool) -> int:
    """Time [ns] in the header with which a serialized message begins. Raises struct.error if it is cut
    off."""
    if is_ros1:
        _, seconds, nanoseconds = struct.unpack_from("<III", content)
    else:
        order = "<" if content[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", content, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def header_ns(message: Any) -> int:
    """Time [ns] of a message's header."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def image_of(message: Any, kind: str, name: str) -> StoredImage | DecodedImage:
    """An image message: compressed ones as they are, others as grey pixels. Raises InputError."""
    if kind == COMPRESSED:
        content = bytes(message.data)
        for magic, suffix in _MAGIC.items():
            if content.startswith(magic):
                return StoredImage(content, suffix)
        raise InputError(
            f"{name}: compressed as {str(message.format)[:40]!r}, which is neither PNG nor JPEG; record "
            "raw images"
        )
    return DecodedImage(_grey(message, name))


def ranges_of(message: Any, kind: str, name: str, model: RangeModel) -> StoredImage | DecodedImage:
    """A depth image message: 16 bits as they are, metres in units of the model. Raises InputError."""
    if kind == COMPRESSED:
        content = bytes(message.data)
        # the plugin compressedDepth puts 12 bytes before a PNG
        at = content.find(b"\x89PNG", 0, 64)
        if at < 0 or "32FC1" in str(message.format):
            raise InputError(
                f"{name}: depth compressed as {str(message.format)[:40]!r}; record it raw, 16UC1"
            )
        return StoredImage(content[at:], ".png")
    if str(message.encoding) != "32FC1":
        return DecodedImage(_grey(message, name))
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if width < 1 or height < 1 or step < 4 * width or len(data) < height * step:
        raise InputError(f"{name}: {len(data)} bytes do not hold {width}x{height} px; it is damaged")
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, : 4 * width])
    units = rows.view(">f4" if message.is_bigendian else "<f4").astype(np.float64) / model.scale_m
    known = np.isfinite(units) & (units > 0.0) & (units < 65535.5)
    return DecodedImage(np.where(known, np.rint(np.where(known, units, 0.0)), 0.0).astype(np.uint16))


def _grey(message: Any, name: str) -> Raw:
    encoding = str(message.encoding)
    height, width, step = int(message.height), int(message.width), int(message.step)
    bayer = re.fullmatch(r"bayer_(rggb|bggr|gbrg|grbg)(8|10|12|14|16)", encoding)
    if encoding.removesuffix("16") in _DEEP_COLOURS or encoding in _COLOURS:
        channels = 4 if "a" in encoding or encoding == "8UC4" else 3
    elif encoding in _LUMA:
        channels = 2
    elif encoding in _GREYS or bayer:
        channels = 1
    else:
        raise InputError(
            f"{name}: the encoding {encoding[:40]!r} is not supported; record mono8, mono16, rgb8, bgr8 or "
            "bayer"
        )
    is_deep = encoding.endswith(("10", "12", "14", "16")) or _GREYS.get(encoding) == 2
    size = 2 if is_deep else 1
    data = np.asarray(message.data, dtype=np.uint8)
    row = width * channels * size
    if width < 1 or height < 1 or step < row or len(data) < height * step:
        raise InputError(
            f"{name}: {len(data)} bytes do not hold {width}x{height} px of {encoding}; the recording is "
            "damaged"
        )
    pixels = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    if encoding in _LUMA:
        return np.ascontiguousarray(pixels[:, _LUMA[encoding] :: 2])
    if encoding in _COLOURS:
        return grey_of_colour(pixels.reshape(height, width, channels), _COLOURS[encoding])
    grey: Raw = pixels
    if size == 2:
        grey = pixels.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    if channels > 1:
        order = encoding.removesuffix("16").upper()
        weights = [_LUMINANCE["RGB".find(colour)] if colour in "RGB" else 0.0 for colour in order]
        return np.asarray(np.rint(grey.reshape(height, width, channels) @ weights), dtype=np.uint16)
    return cv2.cvtColor(grey, _BAYER[bayer[1]]).astype(grey.dtype) if bayer else grey  # type: ignore[return-value]


def grey_of_colour(pixels: NDArray[np.uint8], order: str) -> NDArray[np.uint8]:
    """Colour (H, W, 3 or 4) as grey (H, W), as polhode.files.images converts the colours of a file."""
    rgb = pixels[..., [order.index(colour) for colour in "RGB"]]
    return np.asarray(Image.fromarray(np.ascontiguousarray(rgb), "RGB").convert("L"))


def pose_of(message: Any, kind: str, name: str) -> tuple[str, str, Array, Array | None]:
    """Frame that the pose is in, frame that has it (empty: not stated), pose (4, 4), covariance (6, 6).

    Raises InputError for NaN and quaternions that are not of unit length.
    """
    covariance = None
    if kind.endswith("TransformStamped"):
        return message.header.frame_id, message.child_frame_id, rigid(message.transform, name), None
    pose, child = message.pose, ""
    if kind == ODOMETRY:
        child = str(message.child_frame_id)
    if hasattr(pose, "covariance"):
        covariance = np.asarray(pose.covariance, dtype=np.float64).reshape(6, 6)
        pose = pose.pose
    return str(message.header.frame_id), child, rigid(pose, name), covariance


def rigid(message: Any, name: str) -> Array:
    """(4, 4) of a Pose or a Transform. Raises InputError."""
    p = message.position if hasattr(message, "position") else message.translation
    q = message.orientation if hasattr(message, "orientation") else message.rotation
    t, wxyz = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])
    if not (np.isfinite(t).all() and np.isfinite(wxyz).all()):
        raise InputError(f"{name}: NaN or infinity in a pose; leave it out, or record it again")
    if abs(np.linalg.norm(wxyz) - 1.0) > 1e-2:
        raise InputError(f"{name}: a quaternion that is not of unit length; leave it out, or record it again")
    return np.asarray(make_pose(matrix_from_wxyz(wxyz), t))


@dataclass
class Edge:
    """A frame in its parent."""

    parent: str
    is_static: bool
    times_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    """(4, 4) each, of the child in the parent"""


@dataclass
class Frames:
    """The tree, child -> edge to its parent."""

    edges: dict[str, Edge] = field(default_factory=dict)

    def add(self, message: Any, is_static: bool, name: str) -> None:
        """Take over a TFMessage. Raises InputError for a transform that is none."""
        for transform in message.transforms:
            child = plain(transform.child_frame_id)
            edge = self.edges.setdefault(child, Edge(plain(transform.header.frame_id), is_static))
            if edge.is_static and edge.poses:
                continue
            edge.times_ns.append(header_ns(transform))
            edge.poses.append(rigid(transform.transform, f"{name}, frame {child}"))

    def fixed(self, a: str, b: str) -> Array | None:
        """(4, 4) frame b in frame a by fixed transforms alone; None: they are not linked by such."""
        chain = self._chain(plain(a), plain(b))
        if chain is None or any(not edge.is_static for edge, _ in chain):
            return None
        X = np.eye(4)
        for edge, forward in chain:
            X = X @ (edge.poses[0] if forward else inverse_pose(edge.poses[0]))
        return X

    def over_time(self, a: str, b: str, times_ns: Ints) -> tuple[Array, Bools] | None:
        """(n, 4, 4) frame b in frame a, and (n,) where transforms cover the time; None: not linked."""
        chain = self._chain(plain(a), plain(b))
        if chain is None:
            return None
        X, covered = np.tile(np.eye(4), (len(times_ns), 1, 1)), np.ones(len(times_ns), dtype=np.bool_)
        for edge, forward in chain:
            at, inside = _interpolated(edge, times_ns)
            X, covered = X @ (at if forward else inverse_pose(at)), covered & inside
        return X, covered

    def names(self) -> list[str]:
        """All frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    def _chain(self, a: str, b: str) -> list[tuple[Edge, bool]] | None:
        """Edges whose product is the pose of b in a; true: from parent to child."""
        up, down = self._to_root(a), self._to_root(b)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        rising = [(self.edges[name], False) for name in up[: up.index(common)]]
        falling = [(self.edges[name], True) for name in reversed(down[: down.index(common)])]
        return rising + falling

    def _to_root(self, name: str) -> list[str]:
        names = [name]
        while name in self.edges and len(names) <= len(self.edges):
            name = self.edges[name].parent
            names.append(name)
        return names


def plain(name: str) -> str:
    """A frame's name without the slash that earlier versions of tf begin with."""
    return str(name).removeprefix("/")


def _interpolated(edge: Edge, times_ns: Ints) -> tuple[Array, Bools]:
    """An edge at the times: position linear, attitude by slerp; the nearest one where it has none."""
    if edge.is_static or len(edge.poses) == 1:
        inside = np.full(len(times_ns), edge.is_static) | (times_ns == edge.times_ns[0])
        return np.repeat(edge.poses[0][None], len(times_ns), axis=0), inside
    own, first = np.unique(np.array(edge.times_ns, dtype=np.int64), return_index=True)
    poses = np.stack(edge.poses)[first]
    if len(own) == 1:
        return np.repeat(poses, len(times_ns), axis=0), times_ns == own[0]
    # differences in int64 first: nanoseconds since 1970 do not fit the 53 bits of a double
    inside = (times_ns >= own[0]) & (times_ns <= own[-1])
    t_own = (own - own[0]).astype(np.float64)
    t = np.clip((times_ns - own[0]).astype(np.float64), 0.0, t_own[-1])
    p = np.stack([np.interp(t, t_own, column) for column in poses[:, :3, 3].T], axis=-1)
    return np.asarray(
        make_pose(Slerp(t_own, Rotation.from_matrix(poses[:, :3, :3]))(t).as_matrix(), p)
    ), inside
