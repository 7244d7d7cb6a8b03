"""covariance.npz and measurements.npz: arrays under names, the same bytes for the same content.

NumPy stamps every member of an archive with 1980-01-01, so no clock enters the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polhode.atomic import replaced
from polhode.camera import RectifiedRig
from polhode.lie import Array
from polhode.pipeline.run_directory.archive_file import Archive, Arrays, load_archive
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
POSE_ORDER: tuple[str, ...] = tuple(f"{name}_G_{axis}" for name in ("shift", "turn") for axis in "xyz")
"""Rows and columns of the 6x6 covariance of X_NG."""

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
    covariance_X_NG: Array | None = None
    """(F, 6, 6) as in ``MotionEstimate``: the weight of each frame's depth; None: not known, or an earlier
    version"""


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
    """Keys: timestamps_ns, covariance (F, 12, 12), last_joint and last_body (20, 20), covariance_X_NG
    (F, 6, 6), and their orders."""
    arrays: Arrays = {
        "timestamps_ns": estimate.timestamps_ns,
        "covariance": undetermined_as_inf(estimate.covariance),
        "last_joint": undetermined_as_inf(estimate.covariance_last_joint),
        "order": np.array(STATE_ORDER),
        "last_joint_order": np.array(JOINT_ORDER),
    }
    if estimate.covariance_last_body is not None:
        arrays |= {"last_body": estimate.covariance_last_body, "last_body_order": np.array(BODY_ORDER)}
    if estimate.covariance_X_NG is not None:
        arrays["covariance_X_NG"] = undetermined_as_inf(estimate.covariance_X_NG)
        arrays["covariance_X_NG_order"] = np.array(POSE_ORDER)
    write_arrays(path, arrays)


def read_covariance(path: Path) -> Covariance:
    """Read covariance.npz (the file, or the run folder that holds it). Raises InputError, one line."""
    archive = load_archive(path, "covariance.npz")
    timestamps_ns = archive.times("timestamps_ns")
    count, n, m, k = len(timestamps_ns), len(STATE_ORDER), len(JOINT_ORDER), len(POSE_ORDER)
    of_poses = None
    if "covariance_X_NG" in archive:
        of_poses = archive.numbers("covariance_X_NG", count, k, k, infinite=True)
    return Covariance(
        timestamps_ns,
        archive.numbers("covariance", count, n, n, infinite=True),
        archive.numbers("last_joint", m, m, infinite=True),
        archive.numbers("last_body", m, m) if "last_body" in archive else None,
        of_poses,
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
    archive = load_archive(path, "measurements.npz")
    timestamps_ns = archive.times("timestamps_ns")
    frame = archive.whole("frame", None, below=len(timestamps_ns))
    count = len(frame)
    sigma_px = archive.numbers("sigma_px", count, 3)
    if np.any(sigma_px <= 0.0):
        raise archive.wrong("sigma_px is not positive everywhere")
    return StereoTracks(
        rig=_rig(archive),
        timestamps_ns=timestamps_ns,
        X_NR=archive.numbers("X_NR", len(timestamps_ns), 4, 4),
        frame=frame,
        landmark=archive.whole("landmark", count, below=count),
        uvd_px=archive.numbers("uvd_px", count, 3),
        sigma_px=sigma_px,
        sigma_camera_p_m=archive.number("sigma_camera_p_m"),
        sigma_camera_theta_rad=archive.number("sigma_camera_theta_rad"),
        X_BR=archive.numbers("X_BR", 4, 4),
        wrench=_wrench(archive),
    )


def _rig(archive: Archive) -> RectifiedRig:
    rig = RectifiedRig(
        focal_px=archive.number("rig_focal_px"),
        cx_px=archive.number("rig_cx_px"),
        cy_px=archive.number("rig_cy_px"),
        baseline_m=archive.number("rig_baseline_m"),
        width_px=int(archive.whole("rig_width_px")),
        height_px=int(archive.whole("rig_height_px")),
        disparity_offset_px=archive.number("rig_disparity_offset_px"),
    )
    for name in ("focal_px", "baseline_m", "width_px", "height_px"):
        if not getattr(rig, name) > 0:
            raise archive.wrong(f"rig_{name} is not positive")
    return rig


def _wrench(archive: Archive) -> Wrench | None:
    if "wrench_time_ns" not in archive:
        return None
    time_ns = archive.times("wrench_time_ns")
    return Wrench(
        time_ns=time_ns,
        force_N=archive.numbers("wrench_force_N", len(time_ns), 3),
        torque_P=archive.numbers("wrench_torque_P", len(time_ns), 3),
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


def read_residuals(path: Path) -> Residuals | None:
    """The back end's residuals in measurements.npz; None when the run stopped before them."""
    archive = load_archive(path, "measurements.npz")
    if "residuals_px" not in archive:
        return None
    count = len(archive.whole("frame", None))
    return Residuals(archive.numbers("residuals_px", count, 3), archive.numbers("inlier_weight", count))


def write_arrays(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """An .npz archive: the same bytes for the same content."""
    with replaced(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
