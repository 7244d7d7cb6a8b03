"""A folder of KITTI: a drive of the raw data, or a sequence of the odometry benchmark.

Images lie in image_00/data (raw) or image_0 (odometry), the grey cameras as 0 and 1, the colour ones as 2
and 3. Times are in timestamps.txt or times.txt, the calibration in calib.txt, or calib_cam_to_cam.txt of the
day.
"""

from dataclasses import dataclass
from pathlib import Path

CALIBRATIONS = ("calib.txt", "calib_cam_to_cam.txt")


@dataclass(frozen=True)
class KittiFolders:
    """The images of two cameras, and their calibration."""

    left: Path
    right: Path
    calibration: tuple[Path, ...]
    """Empty: it is not there"""


def kitti_folders(path: Path) -> KittiFolders | None:
    """The folders of a drive or sequence; None: it is none. The grey cameras go before the colour ones."""
    for pattern in ("image_{:02d}/data", "image_{}"):
        for numbers in ((0, 1), (2, 3)):
            left, right = (path / pattern.format(k) for k in numbers)
            if left.is_dir() and right.is_dir():
                places = [place / name for place in (path, path.parent) for name in CALIBRATIONS]
                return KittiFolders(left, right, tuple(place for place in places if place.is_file())[:1])
    return None
