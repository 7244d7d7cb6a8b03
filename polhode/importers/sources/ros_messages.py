"""Messages of ROS: images as grey pixels, poses as matrices."""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from polhode.files.images import Raw
from polhode.geometry.lie import Array, make_pose, matrix_from_wxyz
from polhode.importers.sources.recording import DecodedImage, StoredImage
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
_GREYS = {"mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2}
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


def _grey(message: Any, name: str) -> Raw:
    encoding = str(message.encoding)
    height, width, step = int(message.height), int(message.width), int(message.step)
    pattern = encoding.removeprefix("bayer_").removesuffix("8").removesuffix("16")
    is_bayer = encoding.startswith("bayer_") and pattern in _BAYER
    if encoding in _COLOURS:
        channels = len(_COLOURS[encoding])
    elif encoding in _LUMA:
        channels = 2
    elif encoding in _GREYS or is_bayer:
        channels = 1
    else:
        raise InputError(
            f"{name}: the encoding {encoding[:40]!r} is not supported; record mono8, mono16, rgb8, bgr8 or "
            "bayer"
        )
    size = 2 if encoding.endswith("16") or _GREYS.get(encoding) == 2 else 1
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
    return cv2.cvtColor(grey, _BAYER[pattern]).astype(grey.dtype) if is_bayer else grey  # type: ignore[return-value]


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
