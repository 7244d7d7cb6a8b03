"""What any method finds in stereo images: poses of the target for some frames, and points on it."""

from dataclasses import dataclass

import numpy as np
import trimesh

from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points
from polhode.geometry.rigid_fit import mean_rotation
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.metrics import angle_deg, rms


@dataclass(frozen=True)
class FoundPoses:
    """Poses in the rectified left camera of a frame G that is fixed to the target, of the method's choice."""

    frames: Ints
    """(F,) with a pose, ascending"""
    X_RG: Array
    """(F, 4, 4)"""
    p_G: Array
    """(n, 3) points on the target [m]"""
    pieces: int = 1
    """Reconstructions that were not joined; this is the largest of them"""


@dataclass(frozen=True)
class PoseErrors:
    """Errors after one constant transform between the method's G and the true one; no scale is fitted."""

    frames: int
    """With a pose"""
    rms_position_mm: float
    attitude_median_deg: float
    attitude_max_deg: float
    scale_error_percent: float
    """Size of the camera's path about the target, against the true one"""
    points: int
    point_median_mm: float
    """Distance of the points to the true surface"""


def pose_errors(found: FoundPoses, X_RG: Array, surface: trimesh.Trimesh) -> PoseErrors:
    """Compare with the true poses X_RG (all frames, 4, 4) and the true surface in the true G [m].

    Raises ValueError with fewer than three poses.
    """
    if len(found.frames) < 3:
        raise ValueError("fewer than three poses were found")
    truth = X_RG[found.frames]
    X_GA = constant_transform(found.X_RG, truth)
    fitted = found.X_RG @ X_GA
    angles = angle_deg(np.swapaxes(fitted[:, :3, :3], 1, 2) @ truth[:, :3, :3])
    on_target = transform_points(inverse_pose(X_GA), found.p_G)
    return PoseErrors(
        frames=len(found.frames),
        rms_position_mm=1e3 * rms(fitted[:, :3, 3] - truth[:, :3, 3]),
        attitude_median_deg=float(np.median(angles)),
        attitude_max_deg=float(angles.max()),
        scale_error_percent=100.0 * (size_ratio(found.X_RG, truth) - 1.0),
        points=len(found.p_G),
        point_median_mm=1e3 * float(np.median(distance_to_surface(surface, on_target))),
    )


def constant_transform(X_RG: Array, X_RA: Array) -> Array:
    """X_GA (4, 4), constant, with which X_RG X_GA is nearest to X_RA; both (F, 4, 4).

    Rotation first, as ``metrics.json`` fits it; then the shift, by least squares.
    """
    R_GR = np.swapaxes(X_RG[:, :3, :3], 1, 2)
    X_GA = np.eye(4)
    X_GA[:3, :3] = mean_rotation(R_GR @ X_RA[:, :3, :3])
    X_GA[:3, 3] = np.mean((R_GR @ (X_RA[:, :3, 3] - X_RG[:, :3, 3])[..., None])[..., 0], axis=0)
    return X_GA


def size_ratio(X_RG: Array, X_RA: Array) -> float:
    """Spread of the camera's places about the target in G over that in A; poses (F, 4, 4)."""
    spreads = [np.std(inverse_pose(X)[:, :3, 3], axis=0) for X in (X_RG, X_RA)]
    return float(np.linalg.norm(spreads[0]) / np.linalg.norm(spreads[1]))
