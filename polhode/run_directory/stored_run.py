"""What the report is made from: the files of a run, each absent when the run did not get that far."""

import logging
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.foreign_files import CONFIGURATION_BYTES, MIB, MissingFile, read_bytes, read_text
from polhode.files.json_files import read_json
from polhode.geometry.lie import Array
from polhode.mapping.mesh_files import read_ply
from polhode.records.estimate import Landmarks, OnlineEstimate
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import StereoTracks
from polhode.run_directory.archives import (
    REMEDY,
    Covariance,
    MeasurementResiduals,
    read_covariance,
    read_measurements,
    read_online,
    read_residuals,
)
from polhode.run_directory.film import StoredFilm, read_film
from polhode.run_directory.own_results import METRICS, own_metrics
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import (
    Trajectory,
    read_trajectory,
    require_same_frames,
    target_poses,
)
from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StoredMotion:
    """A run's estimate: trajectory, mass properties and covariance belong together."""

    trajectory: Trajectory
    covariance: Covariance
    moments: Array
    """(3,) Jxx >= Jyy >= Jzz, the middle one 1"""
    R_GP: Array
    """(3, 3)"""
    com_G: Array
    """(3,) [m]"""

    @property
    def X_NG(self) -> Array:
        """(F, 4, 4) pose of the geometric frame."""
        return target_poses(self.trajectory, self.R_GP, self.com_G)


@dataclass(frozen=True)
class StoredPicture:
    """An image file of RUN/pictures."""

    name: str
    caption: str
    content: bytes


@dataclass(frozen=True)
class StoredRun:
    """A run as stored; None or empty where the run has no such file."""

    name: str
    summary: Summary
    motion: StoredMotion | None
    online: OnlineEstimate | None
    tracks: StereoTracks | None
    residuals: MeasurementResiduals | None
    landmarks: Landmarks | None
    surface: SurfaceModel | None
    metrics: dict[str, Any]
    pictures: tuple[StoredPicture, ...]
    film: StoredFilm | None
    config_text: str


def read_stored_run(folder: Path, name: str, metrics: dict[str, Any] | None = None) -> StoredRun:
    """Read a run; ``metrics`` instead of those that are there.

    Raises InputError when summary.json is missing or a file is damaged.
    """
    summary = read_summary(folder)
    if metrics is None:
        metrics = own_metrics(folder, _json(folder / METRICS, "metrics"))
    has_tracks = (folder / "measurements.npz").is_file()
    motion, tracks = read_motion(folder, summary), read_measurements(folder) if has_tracks else None
    config_text = ""
    with suppress(MissingFile):
        config_text = read_text(folder / "config.yaml", CONFIGURATION_BYTES, "a configuration")
    if motion is not None and tracks is not None:
        require_same_frames(folder, motion.trajectory, tracks.timestamps_ns, "measurements.npz")
    return StoredRun(
        name=name,
        summary=summary,
        motion=motion,
        online=read_online(folder),
        tracks=tracks,
        residuals=read_residuals(folder) if has_tracks else None,
        landmarks=read_landmarks(folder) if (folder / "landmarks.ply").is_file() else None,
        surface=read_ply(folder / "mesh.ply") if (folder / "mesh.ply").is_file() else None,
        metrics=metrics,
        pictures=_pictures(folder / "pictures"),
        film=read_film(folder / "pictures"),
        config_text=config_text,
    )


def read_motion(folder: Path, summary: Summary) -> StoredMotion | None:
    """The estimate of a run; None: it ended before it had one. Raises InputError for damaged files."""
    files = (folder / "trajectory.csv", folder / "covariance.npz")
    if summary.inertia is None or summary.R_GP is None or summary.com_G is None:
        return None
    if not all(file.is_file() for file in files):
        return None
    trajectory, covariance = read_trajectory(files[0]), read_covariance(files[1])
    require_same_frames(folder, trajectory, covariance.timestamps_ns, "covariance.npz")
    return StoredMotion(
        trajectory=trajectory,
        covariance=covariance,
        moments=np.array(summary.inertia.moments),
        R_GP=np.array(summary.R_GP),
        com_G=np.array(summary.com_G),
    )


def _pictures(folder: Path) -> tuple[StoredPicture, ...]:
    """The pictures in the folder itself: captions cannot name other files of the machine."""
    file = folder / "captions.json"
    captions: dict[str, str] = _json(file, "captions of pictures")
    if not all(isinstance(words, str) for words in captions.values()):
        raise InputError(f"{file}: a caption is not a text; {REMEDY}")
    found = []
    for name, words in captions.items():
        if Path(name).name != name:
            raise InputError(f"{file}: '{name}' is no file beside it; {REMEDY}")
        content = read_bytes(folder / name, 32 * MIB, "a picture")
        if content.startswith((b"\x89PNG\r\n", b"\xff\xd8\xff")):
            found.append(StoredPicture(name, words, content))
        else:
            _log.warning("%s is neither PNG nor JPEG and is left out", folder / name)
    return tuple(found)


def _json(file: Path, kind: str) -> dict[str, Any]:
    """A file of names and values; empty when there is none."""
    try:
        content = read_json(file, kind)
    except MissingFile:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{file}: not {kind} that polhode wrote; {REMEDY}")
    return content
