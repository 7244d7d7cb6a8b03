"""The folders of a sequence with its two cameras, or with its camera and its range images."""

from dataclasses import dataclass
from pathlib import Path

from polhode.records.range_images import RANGE_FOLDER
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class CameraFolders:
    """The folders of camera 0 (left) and camera 1 (right), or of the ranges in the place of the latter."""

    mav0: Path
    names: tuple[str, str]

    @property
    def has_ranges(self) -> bool:
        """Whether the second folder holds range images."""
        return self.names[1] == RANGE_FOLDER

    def folder(self, camera: int) -> Path:
        """With ``sensor.yaml``, ``data.csv`` and the images in ``data``."""
        return self.mav0 / self.names[camera]

    def masks(self, camera: int) -> Path:
        """masks0 (left) and masks1 (right)."""
        return self.mav0 / f"masks{camera}"


def find_cameras(mav0: Path) -> CameraFolders:
    """cam0 and cam1, or cam0 and range0. Raises InputError where they are missing."""
    for name in ("cam1", RANGE_FOLDER):
        if all((mav0 / each).is_dir() for each in ("cam0", name)):
            return CameraFolders(mav0, ("cam0", name))
    missing = next(mav0 / name for name in ("cam0", "cam1") if not (mav0 / name).is_dir())
    raise InputError(
        f"{missing} is missing: a sequence needs mav0/cam0 and mav0/cam1, or mav0/{RANGE_FOLDER} in the "
        "place of a second camera (see docs/dataset.md)"
    )
