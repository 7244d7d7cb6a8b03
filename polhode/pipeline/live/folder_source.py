"""Pairs from a folder of the contract's layout: one that fills while it is watched, or a recorded one.

The lists ``data.csv`` of both cameras are read as they grow. A pair is complete when both cameras list it,
both images can be read, and the inspector's pose is known if there is one. What stays incomplete while later
pairs come is passed over, by name.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.files.foreign_files import MIB, MissingFile, read_text
from polhode.files.images import UnreadableImage, read_mask, read_raw
from polhode.files.tables import wrong_name
from polhode.geometry.lie import Array, Bools
from polhode.pipeline.stream.stream import CameraMotion
from polhode.records.camera_folders import find_cameras
from polhode.records.dataset import read_inspector, read_sigmas, read_wrench
from polhode.records.pairing import TOLERANCE
from polhode.records.rig_calibration import read_calibration
from polhode.runtime.errors import InputError

END_MARKER = "end"
"""An empty file of this name in mav0/ says that no further pair will come."""
GRACE_S = 1.0
"""An image or pose that is not there so long after its pair was listed is missing."""
CAMERAS = ("cam0", "cam1")


@dataclass(frozen=True)
class SourcePair:
    """One pair as recorded."""

    stamps_ns: tuple[int, int]
    """Of the left image, which is the pair's, and of the right one"""
    names: tuple[str, str]
    """Files below data/"""
    left: NDArray[Any]
    right: NDArray[Any]
    masks: tuple[Bools | None, Bools | None]
    X_NB: Array | None
    written_s: float = 0.0
    """When the later one of the images was written, by ``time.time``"""


@dataclass(frozen=True)
class Passed:
    """A pair, or a single image, that is not used."""

    what: str


class _List:
    """``data.csv`` of a camera as it grows: complete lines only."""

    def __init__(self, path: Path) -> None:
        self._path, self._line = path, 0
        self.rows: list[tuple[int, str]] = []

    def read(self, whole: bool) -> None:
        """Read further lines; ``whole``: the last one counts without its line end. Raises InputError."""
        try:
            text = read_text(self._path, 512 * MIB, "a list of images")
        except MissingFile:
            return
        for line in text.splitlines(keepends=True)[self._line :]:
            if not line.endswith(("\n", "\r")) and not whole:
                return
            self._line += 1
            fields, where = [part.strip() for part in line.split(",")], f"{self._path} line {self._line}"
            if not line.strip() or fields[0].startswith("#"):
                continue
            try:
                stamp = int(fields[0])
            except ValueError:
                raise InputError(f"{where}: expected a timestamp [ns], got {fields[0][:40]!r}") from None
            if abs(stamp) >= 2**62:
                raise InputError(f"{where}: the timestamp {stamp} is too large; give nanoseconds")
            name = fields[1] if len(fields) > 1 and fields[1] else f"{fields[0]}.png"
            if wrong := wrong_name(name):
                raise InputError(f"{where}: the name {name[:60]!r} {wrong}")
            self.rows.append((stamp, name))


class FolderSource:
    """The pairs of a folder, in the order in which the left camera lists them."""

    def __init__(self, folder: Path, watched: bool, patience_s: float) -> None:
        """``watched``: the folder fills; without a marker it ends when nothing came for ``patience_s``.

        Raises InputError when the folder or its calibration is missing or wrong, or has range images.
        """
        if not (folder / "mav0").is_dir():
            raise InputError(f"{folder}: no such sequence: give the folder that contains mav0/")
        mav0 = folder / "mav0"
        cameras = find_cameras(mav0)
        if cameras.has_ranges or cameras.names != CAMERAS:
            raise InputError(f"{mav0}: --live needs two cameras, cam0 and cam1; use polhode run --data")
        self.folder, self.calibration = folder, read_calibration(mav0, cameras.names)
        self._mav0, self._watched, self._patience_s = mav0, watched, patience_s
        self._lists = tuple(_List(mav0 / name / "data.csv") for name in CAMERAS)
        self._inspector = mav0 / "inspector0" if (mav0 / "inspector0").is_dir() else None
        self._latest_ns: int | None = None

    def camera_motion(self) -> CameraMotion:
        """How well the inspector's poses are known, and known torques, as the folder states them now."""
        wrench_folder = self._mav0 / "wrench0"
        # of which only the times matter here, and the first one is as early as the first frame
        last = np.array([2**62 - 1], dtype=np.int64)
        wrench = read_wrench(wrench_folder, last) if wrench_folder.is_dir() else None
        if self._inspector is None:
            return CameraMotion(wrench=wrench, stated=False)
        sigma_p_m, sigma_theta_rad, _ = read_sigmas(self._inspector / "sensor.yaml")
        return CameraMotion(sigma_p_m, sigma_theta_rad, wrench, stated=True)

    def items(self, stopped: Callable[[], bool]) -> Iterator[SourcePair | Passed]:
        """Pairs, and what is passed over, as they come; until the end, or until ``stopped``."""
        left, right = self._lists
        next_left, taken, seen_at = 0, set[int](), monotonic()
        while not stopped():
            ended = not self._watched or (self._mav0 / END_MARKER).exists()
            before = len(left.rows) + len(right.rows)
            for each in self._lists:
                each.read(whole=ended)
            if len(left.rows) + len(right.rows) > before:
                seen_at = monotonic()
            waited_s = monotonic() - seen_at
            while next_left < len(left.rows) and not stopped():
                closing = ended or waited_s > self._patience_s
                found = self._pair(next_left, taken, closing or waited_s > GRACE_S)
                if found is None:
                    break
                next_left += 1
                yield found
            if next_left == len(left.rows) and (ended or waited_s > self._patience_s):
                for index, (stamp, _) in enumerate(right.rows):
                    if index not in taken:
                        yield Passed(f"{stamp} ns (only in cam1)")
                return
            if self._watched:
                sleep(0.05)

    def _pair(self, number: int, taken: set[int], final: bool) -> SourcePair | Passed | None:
        """The left camera's row with its partner; None: to be waited for. ``final``: nothing will come."""
        stamp, name = self._lists[0].rows[number]
        index = self._partner(number, taken)
        if index is None:
            later = any(other > stamp for other, _ in self._lists[1].rows)
            return Passed(f"{stamp} ns (only in cam0)") if final or later else None
        right_stamp, right_name = self._lists[1].rows[index]
        names = name, right_name
        try:
            paths = [self._mav0 / each / "data" / file for each, file in zip(CAMERAS, names, strict=True)]
            left, right = (read_raw(path, *self.calibration.size_px(k)) for k, path in enumerate(paths))
            # a copy that keeps the time of the recording has a change of its own
            written_s = max(path.stat().st_ctime for path in paths)
            X_NB = None if self._inspector is None else self._pose(stamp)
        except (UnreadableImage, InputError, OSError) as error:
            # perhaps it is still being written
            if not final:
                return None
            taken.add(index)
            return Passed(f"{stamp} ns ({error})")
        taken.add(index)
        masks = self._masks(stamp, right_stamp)
        return SourcePair((stamp, right_stamp), names, left, right, masks, X_NB, written_s)

    def _partner(self, number: int, taken: set[int]) -> int | None:
        """Row of the right camera with the nearest stamp, within a hundredth of the interval."""
        rows = self._lists[0].rows
        stamp = rows[number][0]
        around = [abs(rows[k][0] - stamp) for k in (number - 1, number + 1) if 0 <= k < len(rows)]
        tolerance_ns = TOLERANCE * min(around, default=0)
        apart = {k: abs(row[0] - stamp) for k, row in enumerate(self._lists[1].rows) if k not in taken}
        best = min(apart, key=lambda k: (apart[k], k), default=None)
        return best if best is not None and apart[best] <= tolerance_ns else None

    def _pose(self, stamp: int) -> Array:
        """X_NB (4, 4) at a time. Raises InputError: there is none yet."""
        assert self._inspector is not None
        # the interval to another pair, of the first one a tenth of a second, bounds how far the pose may be
        other = stamp + 100_000_000 if self._latest_ns in (None, stamp) else self._latest_ns
        stamps = np.array(sorted({other, stamp}), dtype=np.int64)
        poses = read_inspector(self._inspector, stamps)
        self._latest_ns = stamp
        return np.asarray(poses.X_NB[int(np.searchsorted(stamps, stamp))])

    def _masks(self, stamp: int, right_stamp: int) -> tuple[Bools | None, Bools | None]:
        found: list[Bools | None] = []
        for k, stamps in enumerate(((stamp,), (stamp, right_stamp))):
            mask = None
            for each in stamps:
                try:
                    mask = read_mask(self._mav0 / f"masks{k}" / f"{each}.png", *self.calibration.size_px(k))
                    break
                except UnreadableImage:
                    continue
            found.append(mask)
        return found[0], found[1]
