"""What has come, as a sequence on disk: the batch reads it at the end, as it reads any other.

Pairs from memory are written as they come. Pairs that are files already stay where they are: their folders
are linked, and only the lists say which of them have come.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools
from polhode.records.dataset_writer import image_path, mask_path, write_inspector, write_png, write_sensor
from polhode.records.rig_calibration import StereoCalibration

HEADER = "#timestamp [ns],filename\n"
PREFIX = "polhode-live-"
NOT_LINKED = ("cam0", "cam1")


class Recording(Protocol):
    """The sequence that grows."""

    @property
    def folder(self) -> Path:
        """That contains mav0/; complete after ``close``."""
        ...

    def close(self) -> None:
        """Write what could not be written before."""
        ...

    def remove(self) -> None:
        """Remove what is temporary."""
        ...


class FileRecording:
    """Pairs of a folder that are on disk: lists of their own, everything else linked."""

    def __init__(self, source: Path) -> None:
        self._temporary = TemporaryDirectory(prefix=PREFIX)
        self.folder = Path(self._temporary.name)
        self._rows: tuple[list[str], list[str]] = ([], [])
        mav0 = self.folder / "mav0"
        for entry in sorted((source.resolve() / "mav0").iterdir()):
            if entry.name in NOT_LINKED:
                (mav0 / entry.name).mkdir(parents=True)
                for name in ("data", "sensor.yaml"):
                    (mav0 / entry.name / name).symlink_to(entry / name)
            elif entry.is_dir():
                mav0.mkdir(exist_ok=True)
                (mav0 / entry.name).symlink_to(entry)

    def add(self, stamps_ns: tuple[int, int], names: tuple[str, str]) -> None:
        """A pair that is used: time and file of each image."""
        for rows, stamp, name in zip(self._rows, stamps_ns, names, strict=True):
            rows.append(f"{stamp},{name}\n")

    def close(self) -> None:
        for rows, camera in zip(self._rows, NOT_LINKED, strict=True):
            (self.folder / "mav0" / camera / "data.csv").write_text(HEADER + "".join(rows), encoding="utf-8")

    def remove(self) -> None:
        self._temporary.cleanup()


class ImageRecording:
    """Pairs from memory, written as PNG."""

    def __init__(self, calibration: StereoCalibration, sigmas: tuple[float, float]) -> None:
        self._temporary = TemporaryDirectory(prefix=PREFIX)
        self.folder = Path(self._temporary.name)
        self._stamps_ns: list[int] = []
        self._X_NB: list[Array] = []
        self._sigmas = sigmas
        cameras = (
            (calibration.K0, calibration.dist0, calibration.X_BC0, calibration.fisheye0),
            (calibration.K1, calibration.dist1, calibration.X_BC1, calibration.fisheye1),
        )
        for index, (K, dist, X_BC, fisheye) in enumerate(cameras):
            write_sensor(
                self._camera(index), K, dist, X_BC, *calibration.size_px(index), rate_hz=1.0,
                bits=calibration.bits or 8, fisheye=fisheye,
            )  # fmt: skip

    def add(
        self,
        timestamp_ns: int,
        images: tuple[NDArray[Any], NDArray[Any]],
        masks: tuple[Bools | None, Bools | None],
        X_NB: Array | None,
    ) -> None:
        """A pair that is used: images as they came, masks and pose of the inspector where there are any."""
        for index, (image, mask) in enumerate(zip(images, masks, strict=True)):
            write_png(image_path(self._camera(index), timestamp_ns), image)
            if mask is not None:
                write_png(mask_path(self.folder / "mav0", index, timestamp_ns), mask)
        self._stamps_ns.append(timestamp_ns)
        if X_NB is not None:
            self._X_NB.append(X_NB)

    def close(self) -> None:
        rows = "".join(f"{stamp},{stamp}.png\n" for stamp in self._stamps_ns)
        for index in (0, 1):
            (self._camera(index) / "data.csv").write_text(HEADER + rows, encoding="utf-8")
        if self._X_NB:
            stamps_ns = np.array(self._stamps_ns, dtype=np.int64)
            write_inspector(self.folder / "mav0", stamps_ns, np.stack(self._X_NB), *self._sigmas)

    def remove(self) -> None:
        self._temporary.cleanup()

    def _camera(self, index: int) -> Path:
        return self.folder / "mav0" / NOT_LINKED[index]
