"""covariance.npz and measurements.npz: arrays under names, the same bytes for the same content.

NumPy stamps every member of an archive with 1980-01-01, so no clock enters the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from polhode.atomic import replaced
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import Array
from polhode.records import Ints, MotionEstimate, RelativePoses, StereoTracks, Wrench

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
"""The same with attitude and rate of the body itself, along G."""

Arrays = dict[str, NDArray[np.generic]]
_TRACKS = tuple(f.name for f in fields(StereoTracks) if f.name not in ("rig", "wrench"))


@dataclass(frozen=True)
class Covariance:
    """What covariance.npz holds: SI units, ``inf`` on the diagonal where undetermined, never NaN."""

    timestamps_ns: Ints
    """(F,)"""
    covariance: Array
    """(F, 12, 12)"""
    last_joint: Array
    """(20, 20)"""
    last_body: Array | None = None
    """(20, 20) always finite; None in a run of an earlier version"""


@dataclass(frozen=True)
class Residuals:
    """What the back end left of each measurement."""

    residuals_px: Array
    """(M, 3) measured minus predicted uvd [px]"""
    inlier_weight: Array
    """(M,) weight of the robust kernel"""


def undetermined_as_inf(covariance: Array) -> Array:
    """A covariance (..., n, n) without NaN: undetermined rows and columns are 0, their diagonal ``inf``."""
    diagonal = np.diagonal(covariance, axis1=-2, axis2=-1)
    unknown = ~np.isfinite(diagonal) | (diagonal < 0.0)
    out = np.where(unknown[..., :, None] | unknown[..., None, :], 0.0, covariance)
    n = covariance.shape[-1]
    out[..., np.arange(n), np.arange(n)] = np.where(unknown, np.inf, diagonal)
    return np.nan_to_num(out, nan=0.0, posinf=np.inf)


def write_covariance(estimate: MotionEstimate, path: Path) -> None:
    """Keys: timestamps_ns, covariance (F, 12, 12), last_joint and last_body (20, 20), and their orders."""
    arrays: Arrays = {
        "timestamps_ns": estimate.timestamps_ns,
        "covariance": undetermined_as_inf(estimate.covariance),
        "last_joint": undetermined_as_inf(estimate.covariance_last_joint),
        "order": np.array(STATE_ORDER),
        "last_joint_order": np.array(JOINT_ORDER),
    }
    if estimate.covariance_last_body is not None:
        arrays |= {"last_body": estimate.covariance_last_body, "last_body_order": np.array(BODY_ORDER)}
    write_arrays(path, arrays)


def read_covariance(path: Path) -> Covariance:
    """Read covariance.npz (the file, or the run folder that holds it). Raises InputError, one line."""
    arrays = _load(path, "covariance.npz", ("timestamps_ns", "covariance", "last_joint"))
    return Covariance(
        np.asarray(arrays["timestamps_ns"], dtype=np.int64),
        np.asarray(arrays["covariance"], dtype=np.float64),
        np.asarray(arrays["last_joint"], dtype=np.float64),
        np.asarray(arrays["last_body"], dtype=np.float64) if "last_body" in arrays else None,
    )


def write_measurements(
    tracks: StereoTracks,
    path: Path,
    relative: RelativePoses | None = None,
    estimate: MotionEstimate | None = None,
) -> None:
    """Tracks, rig and noise; the relative poses and the back end's residuals when they are given.

    Keys: the fields of StereoTracks; ``rig_<field>``; ``wrench_<field>``; ``relative_<field>``; residuals_px,
    inlier_weight.
    """
    arrays: Arrays = {name: np.asarray(getattr(tracks, name)) for name in _TRACKS}
    if tracks.wrench is not None:
        arrays |= {f"wrench_{f.name}": np.asarray(getattr(tracks.wrench, f.name)) for f in fields(Wrench)}
    arrays |= {f"rig_{f.name}": np.asarray(getattr(tracks.rig, f.name)) for f in fields(tracks.rig)}
    if relative is not None:
        arrays |= {f"relative_{f.name}": np.asarray(getattr(relative, f.name)) for f in fields(relative)}
    if estimate is not None:
        arrays |= {"residuals_px": estimate.residuals_px, "inlier_weight": estimate.inlier_weight}
    write_arrays(path, arrays)


def read_measurements(path: Path) -> StereoTracks:
    """Read the tracks of measurements.npz (the file, or the run folder). Raises InputError, one line."""
    arrays = _load(path, "measurements.npz", (*_TRACKS, *(f"rig_{f.name}" for f in fields(RectifiedRig))))
    rig = RectifiedRig(
        focal_px=float(arrays["rig_focal_px"]),
        cx_px=float(arrays["rig_cx_px"]),
        cy_px=float(arrays["rig_cy_px"]),
        baseline_m=float(arrays["rig_baseline_m"]),
        width_px=int(arrays["rig_width_px"]),
        height_px=int(arrays["rig_height_px"]),
        disparity_offset_px=float(arrays["rig_disparity_offset_px"]),
    )
    _require_sound(path, arrays)
    return StereoTracks(
        rig=rig,
        timestamps_ns=np.asarray(arrays["timestamps_ns"], dtype=np.int64),
        X_NR=np.asarray(arrays["X_NR"], dtype=np.float64),
        frame=np.asarray(arrays["frame"], dtype=np.int64),
        landmark=np.asarray(arrays["landmark"], dtype=np.int64),
        uvd_px=np.asarray(arrays["uvd_px"], dtype=np.float64),
        sigma_px=np.asarray(arrays["sigma_px"], dtype=np.float64),
        sigma_camera_p_m=float(arrays["sigma_camera_p_m"]),
        sigma_camera_theta_rad=float(arrays["sigma_camera_theta_rad"]),
        X_BR=np.asarray(arrays["X_BR"], dtype=np.float64),
        wrench=_wrench(arrays),
    )


def _require_sound(path: Path, arrays: Arrays) -> None:
    """Raise InputError when measurements are NaN, or times do not increase."""
    for name in ("X_NR", "uvd_px", "sigma_px"):
        bad = ~np.isfinite(np.asarray(arrays[name], dtype=np.float64))
        if bad.any():
            row = int(np.argwhere(bad)[0][0])
            raise InputError(f"{path}: {name} holds NaN or infinity in row {row}; run 'polhode run' again")
    if np.any(np.asarray(arrays["sigma_px"], dtype=np.float64) <= 0.0):
        raise InputError(f"{path}: sigma_px is not positive everywhere; run 'polhode run' again")
    later = np.diff(np.asarray(arrays["timestamps_ns"], dtype=np.int64)) > 0
    if not later.all():
        row = int(np.argmin(later)) + 1
        raise InputError(f"{path}: timestamps_ns does not increase in row {row}; run 'polhode run' again")
    for name, size in (("frame", len(later) + 1), ("landmark", len(arrays["landmark"]))):
        index = np.asarray(arrays[name], dtype=np.int64)
        if len(index) and (index.min() < 0 or index.max() >= size):
            raise InputError(f"{path}: {name} points outside the run; run 'polhode run' again")


def _wrench(arrays: Arrays) -> Wrench | None:
    if "wrench_time_ns" not in arrays:
        return None
    return Wrench(
        time_ns=np.asarray(arrays["wrench_time_ns"], dtype=np.int64),
        force_N=np.asarray(arrays["wrench_force_N"], dtype=np.float64),
        torque_P=np.asarray(arrays["wrench_torque_P"], dtype=np.float64),
    )


def read_relative_poses(path: Path) -> RelativePoses | None:
    """The relative poses of measurements.npz; None when the run stopped before them."""
    arrays = _load(path, "measurements.npz", ())
    if "relative_i" not in arrays:
        return None
    return RelativePoses(
        i=np.asarray(arrays["relative_i"], dtype=np.int64),
        j=np.asarray(arrays["relative_j"], dtype=np.int64),
        X_RiRj=np.asarray(arrays["relative_X_RiRj"], dtype=np.float64),
        inliers=np.asarray(arrays["relative_inliers"], dtype=np.int64),
    )


def read_residuals(path: Path) -> Residuals | None:
    """The back end's residuals in measurements.npz; None when the run stopped before them."""
    arrays = _load(path, "measurements.npz", ())
    if "residuals_px" not in arrays:
        return None
    return Residuals(
        np.asarray(arrays["residuals_px"], dtype=np.float64),
        np.asarray(arrays["inlier_weight"], dtype=np.float64),
    )


def write_arrays(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """An .npz archive: the same bytes for the same content."""
    with replaced(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _load(path: Path, name: str, required: tuple[str, ...]) -> Arrays:
    file = path / name if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run")
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    except (BadZipFile, ValueError, OSError, EOFError) as error:
        raise InputError(f"{file}: not a readable archive of arrays ({error})") from error
    missing = [key for key in required if key not in arrays]
    if missing:
        raise InputError(f"{file}: the array {missing[0]} is missing; run 'polhode run' again")
    return arrays
