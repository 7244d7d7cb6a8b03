"""covariance.npz, measurements.npz and online.npz: named arrays, the same bytes for the same content.

NumPy stamps every member of an archive with 1980-01-01, so no clock enters the file. On reading, every array
must have its shape and no NaN; what is wrong raises InputError, one line that names file, array and row.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.files.array_files import read_arrays
from polhode.files.atomic import replaced
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.calibration_effects import CalibrationEffects, kept_terms
from polhode.records.estimate import MotionEstimate, OnlineEstimate, RotationHypothesis
from polhode.records.occupancy import STATES, Occupancy
from polhode.records.tracks import RelativePoses, StereoTracks, Wrench
from polhode.runtime.errors import InputError

Arrays = dict[str, NDArray[np.generic]]
REMEDY = "run 'polhode run' again"

STATE_ORDER: tuple[str, ...] = tuple(
    f"{name}_{axis}" for name in ("r_N", "v_N", "theta_P", "w_P") for axis in "xyz"
)
"""Rows and columns of the 12x12 covariance of a frame."""
JOINT_ORDER: tuple[str, ...] = (
    *STATE_ORDER,
    *(f"inertia_{i}" for i in range(5)),
    *(f"com_G_{a}" for a in "xyz"),
)
"""Rows and columns of the 20x20 joint covariance: last state, the solver's inertia parameters, com_G."""
BODY_ORDER: tuple[str, ...] = tuple(name.replace("_P_", "_G_") for name in JOINT_ORDER)
"""The same with attitude and angular velocity of the body itself, along G."""
POSE_ORDER: tuple[str, ...] = tuple(f"{name}_G_{axis}" for name in ("shift", "turn") for axis in "xyz")
"""Rows and columns of the 6x6 covariance of X_NG."""


@dataclass(frozen=True)
class Covariance:
    """Content of covariance.npz: SI units, ``inf`` on the diagonal where undetermined, never NaN."""

    timestamps_ns: Ints
    """(F,)"""
    covariance: Array
    """(F, 12, 12)"""
    last_joint: Array
    """(20, 20)"""
    last_body: Array | None = None
    """(20, 20) always finite; None in a run of an earlier version"""
    covariance_X_NG: Array | None = None
    """(F, 6, 6) as in ``MotionEstimate``: it weights each frame's depth; None: not stored"""
    covariance_of_marks: Array | None = None
    """(F, 12, 12) of the body itself, as in ``MotionEstimate``, always finite; None: not stored"""


@dataclass(frozen=True)
class MeasurementResiduals:
    """Residual and weight of each measurement after the estimate."""

    residuals_px: Array
    """(M, 3) measured minus predicted uvd [px]"""
    inlier_weight: Array
    """(M,) weight of the robust kernel"""


@dataclass(frozen=True)
class Archive:
    """An .npz file with its arrays, each checked when it is taken out."""

    file: Path
    arrays: Arrays
    remedy: str = REMEDY

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def optional(self, name: str, *shape: int | None, infinite: bool = False) -> Array | None:
        """As ``numbers``; None: the file does not have it."""
        return self.numbers(name, *shape, infinite=infinite) if name in self else None

    def numbers(self, name: str, *shape: int | None, infinite: bool = False) -> Array:
        """An array of floats, all finite, or with ``infinite`` none NaN. A shape of None is any length."""
        values = self._take(name, shape, "fiu").astype(np.float64)
        bad = np.isnan(values) if infinite else ~np.isfinite(values)
        if bad.any():
            row = f" in row {np.argwhere(bad)[0][0]}" if shape else ""
            raise self.wrong(f"{name} holds {'NaN' if infinite else 'NaN or infinity'}{row}")
        return values

    def whole(self, name: str, *shape: int | None, below: int | None = None) -> Ints:
        """An array of integers; with ``below`` they are indices, 0 <= i < below."""
        values = self._take(name, shape, "iu").astype(np.int64)
        if below is not None and values.size and (values.min() < 0 or values.max() >= below):
            raise self.wrong(f"{name} points outside the run")
        return values

    def number(self, name: str) -> float:
        """A single finite number."""
        return float(self.numbers(name))

    def flags(self, name: str, *shape: int | None) -> Bools:
        """An array of booleans."""
        return self._take(name, shape, "b").astype(np.bool_)

    def text(self, name: str) -> str:
        """A single text."""
        return str(self._take(name, (), "U"))

    def texts(self, name: str) -> tuple[str, ...]:
        """(n,) texts."""
        return tuple(map(str, self._take(name, (None,), "U").tolist()))

    def times(self, name: str, count: int | None = None) -> Ints:
        """(n,) strictly increasing [ns]"""
        stamps = self.whole(name, count)
        later = np.diff(stamps) > 0
        if not later.all():
            raise self.wrong(f"{name} does not increase in row {int(np.argmin(later)) + 1}")
        return stamps

    def wrong(self, what: str) -> InputError:
        """The error to raise."""
        return InputError(f"{self.file}: {what}; {self.remedy}")

    def _take(self, name: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[np.generic]:
        if name not in self.arrays:
            raise self.wrong(f"the array {name} is missing")
        values = self.arrays[name]
        if values.dtype.kind not in kinds:
            wanted = {"fiu": "numbers", "iu": "whole numbers", "b": "booleans", "U": "a text"}[kinds]
            raise self.wrong(f"{name} holds {values.dtype}, expected {wanted}")
        same_rank = len(values.shape) == len(shape)
        if not same_rank or any(n not in (None, m) for n, m in zip(shape, values.shape, strict=True)):
            wanted = " x ".join("n" if size is None else str(size) for size in shape) or "one number"
            given = " x ".join(map(str, values.shape)) or "one number"
            raise self.wrong(f"{name} is {given}, expected {wanted}")
        return values


def undetermined_as_inf(covariance: Array) -> Array:
    """A covariance (..., n, n) without NaN: undetermined rows and columns are 0, their diagonal ``inf``."""
    diagonal = np.diagonal(covariance, axis1=-2, axis2=-1)
    unknown = ~np.isfinite(diagonal) | (diagonal < 0.0)
    out = np.where(unknown[..., :, None] | unknown[..., None, :], 0.0, covariance)
    n = covariance.shape[-1]
    out[..., np.arange(n), np.arange(n)] = np.where(unknown, np.inf, diagonal)
    return np.nan_to_num(out, nan=0.0, posinf=np.inf)


def write_covariance(estimate: MotionEstimate, path: Path) -> None:
    """Keys: timestamps_ns, covariance and covariance_of_marks (F, 12, 12), last_joint and last_body (20, 20),
    covariance_X_NG (F, 6, 6), and their orders: docs/run_directory.md describes each."""
    arrays: Arrays = {
        "timestamps_ns": estimate.timestamps_ns,
        "covariance": undetermined_as_inf(estimate.covariance),
        "last_joint": undetermined_as_inf(estimate.covariance_last_joint),
        "order": np.array(STATE_ORDER),
        "last_joint_order": np.array(JOINT_ORDER),
    }
    if (body := estimate.covariance_last_body) is not None:
        arrays |= {"last_body": body, "last_body_order": np.array(BODY_ORDER)}
    if (poses := estimate.covariance_X_NG) is not None:
        arrays["covariance_X_NG"] = undetermined_as_inf(poses)
        arrays["covariance_X_NG_order"] = np.array(POSE_ORDER)
    if (marks := estimate.covariance_of_marks) is not None:
        arrays["covariance_of_marks"] = marks
    write_arrays(path, arrays)


def write_hypotheses(hypotheses: Sequence[RotationHypothesis], path: Path) -> None:
    """hypotheses.npz: the fields of each ``RotationHypothesis``, one after the other."""
    names = [field.name for field in fields(RotationHypothesis)]
    write_arrays(path, {name: np.stack([getattr(each, name) for each in hypotheses]) for name in names})


def read_hypotheses(run: Path) -> tuple[RotationHypothesis, ...]:
    """The motions with other rotations between frames, the run's own first; none: the run has no such file.

    Raises InputError, one line.
    """
    if not (run / "hypotheses.npz").exists():
        return ()
    archive = load_archive(run, "hypotheses.npz")
    count, n = len(archive.numbers("odds", None)), len(BODY_ORDER)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("R_NG", "J_G", "R_GP"), (3, 3))
    shapes |= {"covariance": (n, n), "odds": (), "accel_psd": (), "torque_psd": (), "turn_deg": ()}
    shapes["level_decades"] = (2,)
    names = [field.name for field in fields(RotationHypothesis)]
    columns = {name: archive.numbers(name, count, *shapes.get(name, (3,))) for name in names}
    return tuple(RotationHypothesis(**{name: columns[name][k] for name in names}) for k in range(count))


def read_covariance(path: Path) -> Covariance:
    """Read covariance.npz (the file, or its run folder). Raises InputError, one line."""
    archive = load_archive(path, "covariance.npz")
    timestamps_ns = archive.times("timestamps_ns")
    count, n, m, k = len(timestamps_ns), len(STATE_ORDER), len(JOINT_ORDER), len(POSE_ORDER)
    return Covariance(
        timestamps_ns,
        archive.numbers("covariance", count, n, n, infinite=True),
        archive.numbers("last_joint", m, m, infinite=True),
        archive.optional("last_body", m, m),
        archive.optional("covariance_X_NG", count, k, k, infinite=True),
        archive.optional("covariance_of_marks", count, n, n),
    )


def write_occupancy(occupancy: Occupancy, path: Path) -> None:
    """occupancy.npz: the fields of ``Occupancy``."""
    write_arrays(path, _fields(occupancy))


def read_occupancy(run: Path) -> Occupancy | None:
    """What the images leave possible beside the mesh; None: a run of an earlier version, or without images.

    Raises InputError, one line.
    """
    if not (run / "occupancy.npz").exists():
        return None
    archive = load_archive(run, "occupancy.npz")
    step_m = archive.number("step_m")
    if not step_m > 0.0:
        raise archive.wrong("step_m is not positive")
    state = archive.whole("state", None, None, None, below=len(STATES))
    return Occupancy(archive.numbers("origin_G", 3), step_m, state.astype(np.uint8))


def write_measurements(
    tracks: StereoTracks,
    path: Path,
    relative: RelativePoses | None = None,
    estimate: MotionEstimate | None = None,
) -> None:
    """Tracks, rig and noise; the relative poses and the back end's residuals when they are given.

    Keys: the fields of StereoTracks; ``rig_<field>``; ``wrench_<field>``; ``calibration_<field>``;
    ``relative_<field>``; residuals_px, inlier_weight.
    """
    parts = {"wrench": tracks.wrench, "rig": tracks.rig, "calibration": tracks.calibration}
    arrays = _fields(tracks, without=tuple(parts))
    for prefix, record in {**parts, "relative": relative}.items():
        arrays |= {} if record is None else _fields(record, f"{prefix}_")
    if estimate is not None:
        arrays |= {"residuals_px": estimate.residuals_px, "inlier_weight": estimate.inlier_weight}
    write_arrays(path, arrays)


def _fields(record: Any, prefix: str = "", without: Sequence[str] = ()) -> Arrays:
    names = [each.name for each in fields(record) if each.name not in without]
    return {f"{prefix}{name}": np.asarray(getattr(record, name)) for name in names}


def read_measurements(path: Path) -> StereoTracks:
    """Read the tracks of measurements.npz (the file, or the run folder). Raises InputError, one line."""
    archive = load_archive(path, "measurements.npz")
    timestamps_ns = archive.times("timestamps_ns")
    frame = archive.whole("frame", None, below=len(timestamps_ns))
    count = len(frame)
    sigma_px = archive.numbers("sigma_px", count, 3)
    if np.any(sigma_px <= 0.0):
        raise archive.wrong("sigma_px is not positive everywhere")
    sizes = {name: int(archive.whole(f"rig_{name}")) for name in ("width_px", "height_px")}
    lengths = [f.name for f in fields(RectifiedRig) if f.name not in sizes]
    found: dict[str, Any] = {**{name: archive.number(f"rig_{name}") for name in lengths}, **sizes}
    for name in ("focal_px", "baseline_m", "width_px", "height_px"):
        if not found[name] > 0:
            raise archive.wrong(f"rig_{name} is not positive")
    wrench = None
    if "wrench_time_ns" in archive:
        time_ns = archive.times("wrench_time_ns")
        vectors = (archive.numbers(f"wrench_{name}", len(time_ns), 3) for name in ("force_N", "torque_P"))
        wrench = Wrench(time_ns, *vectors)
    return StereoTracks(
        rig=RectifiedRig(**found),
        timestamps_ns=timestamps_ns,
        X_NR=archive.numbers("X_NR", len(timestamps_ns), 4, 4),
        frame=frame,
        landmark=archive.whole("landmark", count, below=count),
        uvd_px=archive.numbers("uvd_px", count, 3),
        sigma_px=sigma_px,
        sigma_camera_p_m=archive.number("sigma_camera_p_m"),
        sigma_camera_theta_rad=archive.number("sigma_camera_theta_rad"),
        X_BR=archive.numbers("X_BR", 4, 4),
        wrench=wrench,
        calibration=_calibration_effects(archive) if "calibration_source" in archive else None,
    )


def _calibration_effects(archive: Archive) -> CalibrationEffects:
    later_s = archive.numbers("calibration_right_later_s", None)
    c, terms = len(later_s), int(kept_terms().sum())
    left, right = (archive.numbers(f"calibration_{side}", terms, 2, c) for side in ("left", "right"))
    poses = ("right_shift_m", "right_turn_rad", "body_shift_m", "body_turn_rad")
    # measurements of earlier versions lack the names
    named = "calibration_names" in archive
    names = archive.texts("calibration_names") if named else ()
    return CalibrationEffects(
        source=archive.text("calibration_source"),
        left=left,
        right=right,
        right_later_s=later_s,
        has_ranges=bool(archive.flags("calibration_has_ranges")),
        names=names,
        factor=archive.numbers("calibration_factor", len(names), c) if named else np.zeros((0, c)),
        **{name: archive.numbers(f"calibration_{name}", 3, c) for name in poses},
    )


def read_relative_poses(path: Path) -> RelativePoses | None:
    """The relative poses of measurements.npz; None when the run stopped before them."""
    archive = load_archive(path, "measurements.npz")
    if "relative_i" not in archive:
        return None
    n_frames = len(archive.times("timestamps_ns"))
    i = archive.whole("relative_i", None, below=n_frames)
    return RelativePoses(
        i=i,
        j=archive.whole("relative_j", len(i), below=n_frames),
        X_RiRj=archive.numbers("relative_X_RiRj", len(i), 4, 4),
        inliers=archive.whole("relative_inliers", len(i)),
    )


def read_residuals(path: Path) -> MeasurementResiduals | None:
    """The back end's residuals in measurements.npz; None when the run stopped before them."""
    archive = load_archive(path, "measurements.npz")
    if "residuals_px" not in archive:
        return None
    count = len(archive.whole("frame", None))
    return MeasurementResiduals(
        archive.numbers("residuals_px", count, 3), archive.numbers("inlier_weight", count)
    )


def write_arrays(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """An .npz archive: the same bytes for the same content."""
    with replaced(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load_archive(path: Path, name: str, remedy: str = REMEDY) -> Archive:
    """Read the file, or that of this name in the folder of a run. ``remedy`` is what errors advise."""
    file = path / name if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run")
    return Archive(file, read_arrays(file), remedy)


def write_online(online: OnlineEstimate, path: Path) -> None:
    """Keys: the fields of OnlineEstimate. The same bytes for the same content."""
    write_arrays(path, _fields(online))


def read_online(path: Path) -> OnlineEstimate | None:
    """Read online.npz (the file, or its run folder); None when the run has none.

    Raises InputError, one line, when it cannot be read.
    """
    file = path / "online.npz" if path.is_dir() else path
    if not file.is_file():
        return None
    archive = load_archive(file, "online.npz")
    count = len(archive.times("timestamps_ns"))
    found: dict[str, Any] = {}
    for name in (field.name for field in fields(OnlineEstimate)):
        values = archive.arrays.get(name)
        if values is None and name == "frame":
            # written before there was one
            values = np.zeros(count, dtype=np.int64)
        if values is None or values.shape[:1] != (count,):
            raise archive.wrong(f"{name} has not one row for each of {count} frames")
        is_float = values.dtype.kind == "f"
        found[name] = archive.numbers(name, *values.shape, infinite=True) if is_float else values
    return OnlineEstimate(**found)
