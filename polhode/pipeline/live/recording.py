"""What has come, as a sequence on disk: the batch reads it at the end, as it reads any other.

Pairs from memory are written as they come. Pairs that are files already stay where they are: their folders
are linked, and only the lists say which of them have come.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools
from polhode.records.calibration_prior import COVARIANCE_FILE
from polhode.records.dataset_writer import (
    image_path,
    mask_path,
    write_inspector,
    write_png,
    write_prior,
    write_sensor,
)
from polhode.records.rig_calibration import StereoCalibration

CAMERAS = ("cam0", "cam1")


class FileRecording:
    """Pairs of a folder that are on disk: lists of their own, everything else linked."""

    def __init__(self, source: Path | None) -> None:
        self._temporary = TemporaryDirectory(prefix="polhode-live-")
        self.folder = Path(self._temporary.name)
        """That contains mav0/; complete after ``close``"""
        self.mav0 = self.folder / "mav0"
        self._rows: tuple[list[str], list[str]] = ([], [])
        for entry in sorted((source.resolve() / "mav0").iterdir()) if source is not None else ():
            if entry.name in CAMERAS:
                (self.mav0 / entry.name).mkdir(parents=True)
                for name in ("data", "sensor.yaml"):
                    (self.mav0 / entry.name / name).symlink_to(entry / name)
            elif entry.is_dir() or entry.name == COVARIANCE_FILE:
                self.mav0.mkdir(exist_ok=True)
                (self.mav0 / entry.name).symlink_to(entry)

    def add(self, stamps_ns: tuple[int, int], names: tuple[str, str]) -> None:
        """A pair that is used: time and file of each image."""
        for rows, stamp, name in zip(self._rows, stamps_ns, names, strict=True):
            rows.append(f"{stamp},{name}\n")

    def close(self) -> None:
        """Write what could not be written before."""
        for rows, camera in zip(self._rows, CAMERAS, strict=True):
            text = "#timestamp [ns],filename\n" + "".join(rows)
            (self.mav0 / camera / "data.csv").write_text(text, encoding="utf-8")

    def remove(self) -> None:
        """Remove what is temporary."""
        self._temporary.cleanup()


class ImageRecording(FileRecording):
    """Pairs from memory, written as PNG."""

    def __init__(self, calibration: StereoCalibration, sigmas: tuple[float, float]) -> None:
        super().__init__(None)
        self._sigmas, self._stamps_ns, self._X_NB = sigmas, list[int](), list[Array]()
        cameras = (
            (calibration.K0, calibration.dist0, calibration.X_BC0, calibration.fisheye0),
            (calibration.K1, calibration.dist1, calibration.X_BC1, calibration.fisheye1),
        )
        for index, (K, dist, X_BC, fisheye) in enumerate(cameras):
            write_sensor(
                self.mav0 / CAMERAS[index], K, dist, X_BC, calibration.size_px(index), rate_hz=1.0,
                bits=calibration.bits or 8, fisheye=fisheye,
            )  # fmt: skip
        if calibration.prior is not None:
            write_prior(self.mav0, calibration.prior)

    def add_images(
        self,
        timestamp_ns: int,
        images: tuple[NDArray[Any], NDArray[Any]],
        masks: tuple[Bools | None, Bools | None],
        X_NB: Array | None,
    ) -> None:
        """A pair that is used: images as they came, masks and pose of the inspector where there are any."""
        for index, (image, mask) in enumerate(zip(images, masks, strict=True)):
            write_png(image_path(self.mav0 / CAMERAS[index], timestamp_ns), image)
            if mask is not None:
                write_png(mask_path(self.mav0, index, timestamp_ns), mask)
        name = f"{timestamp_ns}.png"
        self.add((timestamp_ns, timestamp_ns), (name, name))
        self._stamps_ns.append(timestamp_ns)
        if X_NB is not None:
            self._X_NB.append(X_NB)

    def close(self) -> None:
        """Write the lists and the poses."""
        super().close()
        if self._X_NB:
            stamps_ns = np.array(self._stamps_ns, dtype=np.int64)
            write_inspector(self.mav0, stamps_ns, np.stack(self._X_NB), *self._sigmas)
