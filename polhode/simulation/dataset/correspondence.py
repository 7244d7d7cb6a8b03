"""Correspondences between two views, of any frames and cameras, by ray casting.

Rays go through the pixels of view a to the body in G, and from there to camera b. A file of
correspondences holds one row for each pixel of image a that shows the target: ``uv_a_px`` and the fields of
``Correspondence``.
"""

from dataclasses import dataclass, fields
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools, inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.plan import SequencePlan
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.stereo_camera import Camera

MIN_DISTANCE_M = 1e-6
"""Points nearer to the camera's plane than this, or behind it, have no image [m]."""
RAY_TOLERANCE = 1e-6
"""Maximum distance of equal unit rays: a distorting lens folds far points back into the image."""


class Reason(IntEnum):
    """Why a point is not visible in view b: the first reason that applies."""

    VISIBLE = 0
    OFF_TARGET = 1
    """The pixel of view a does not show the target."""
    BACK_FACING = 2
    """The surface seen in view a faces away from camera b."""
    OUTSIDE = 3
    """Outside image b, or behind the camera."""
    OCCLUDED = 4
    """Another part of the body occludes the point from camera b."""


@dataclass(frozen=True)
class CameraView:
    """A camera and its pose relative to the body."""

    camera: Camera
    X_GK: Array
    """(4, 4)"""


@dataclass(frozen=True)
class Correspondence:
    """Pixels of view a in view b; leading dimensions are those of the pixels."""

    uv_b_px: Array
    """(..., 2) distorted; NaN where the point has no image; also given where it is occluded or outside"""
    visible: Bools
    """(...)"""
    reason: NDArray[np.uint8]
    """(...) of ``Reason``"""
    p_G: Array
    """(..., 3) [m]; NaN off the target"""
    angle_rad: Array
    """(...) at the point, between the directions to the two cameras; NaN off the target"""


def view_of(plan: SequencePlan, frame: int, camera: int) -> CameraView:
    """CameraView of one camera (0: left, 1: right) at one frame. Raises InputError if there is none."""
    frames, cameras = plan.scene.frames, len(plan.cameras)
    if not 0 <= frame < frames:
        raise InputError(f"there is no frame {frame}: the scene has frames 0 to {frames - 1}")
    if not 0 <= camera < cameras:
        raise InputError(f"there is no camera {camera}: 0 is the left one, 1 the right one")
    chosen = plan.cameras[camera]
    return CameraView(chosen, inverse_pose(plan.target.X_NG[frame]) @ plan.X_NC[frame] @ chosen.X_CK)


def angle_between_views(a: CameraView, b: CameraView) -> float:
    """Angle at the body's origin between the directions to two cameras [rad]."""
    return float(_angles(np.zeros((1, 3)), a, b)[0])


def dense_correspondence(caster: RayCaster, a: CameraView, b: CameraView) -> Correspondence:
    """Correspondences (H, W, ...) of all pixels of view a; the flow is uv_b_px - a.camera.pixel_grid()."""
    return correspond(caster, a, b, a.camera.pixel_grid())


def correspond(caster: RayCaster, a: CameraView, b: CameraView, uv_a_px: Array) -> Correspondence:
    """Correspondences of distorted pixels (..., 2) of view a in view b."""
    shape = uv_a_px.shape[:-1]
    rays_K = a.camera.directions(uv_a_px.reshape(-1, 2))
    hits = caster.first_hits(a.X_GK[:3, 3], rays_K @ a.X_GK[:3, :3].T)
    count = len(rays_K)
    uv_b, p_G = np.full((count, 2), np.nan), np.full((count, 3), np.nan)
    reason = np.full(count, Reason.OFF_TARGET, np.uint8)
    angle = np.full(count, np.nan)
    p_G[hits.ray] = hits.p_G
    uv_b[hits.ray] = image_b = _image_of(b, hits.p_G)
    angle[hits.ray] = _angles(hits.p_G, a, b)
    toward = b.X_GK[:3, 3] - hits.p_G
    distance = np.linalg.norm(toward, axis=1)
    toward /= distance[:, None]
    facing = np.einsum("nk,nk->n", hits.flat_normal_G, toward) > 0
    inside, clear = _inside(b.camera, image_b), caster.clear(hits, toward, distance)
    why = (Reason.BACK_FACING, Reason.OUTSIDE, Reason.OCCLUDED)
    reason[hits.ray] = np.select([~facing, ~inside, ~clear], why, Reason.VISIBLE)
    return Correspondence(
        uv_b.reshape(*shape, 2),
        (reason == Reason.VISIBLE).reshape(shape),
        reason.reshape(shape),
        p_G.reshape(*shape, 3),
        angle.reshape(shape),
    )


def _image_of(view: CameraView, p_G: Array) -> Array:
    """Pixels (n, 2) of points (n, 3), inside the image or outside; NaN where the lens forms no image."""
    p_K = transform_points(inverse_pose(view.X_GK), p_G)
    uv = np.full((len(p_K), 2), np.nan)
    before = p_K[:, 2] > MIN_DISTANCE_M
    if not before.any():
        return uv
    uv[before] = view.camera.project(p_K[before])
    if view.camera.distorted:
        inside = np.flatnonzero(_inside(view.camera, uv))
        rays = p_K[inside] / np.linalg.norm(p_K[inside], axis=1, keepdims=True)
        folded = np.linalg.norm(view.camera.directions(uv[inside]) - rays, axis=1) > RAY_TOLERANCE
        uv[inside[folded]] = np.nan
    return uv


def _inside(camera: Camera, uv_px: Array) -> Bools:
    """True (n,) within the borders of the image; false for NaN."""
    return np.asarray(
        ((uv_px >= -0.5) & (uv_px < [camera.width_px - 0.5, camera.height_px - 0.5])).all(axis=1)
    )


def _angles(p_G: Array, a: CameraView, b: CameraView) -> Array:
    to_a, to_b = a.X_GK[:3, 3] - p_G, b.X_GK[:3, 3] - p_G
    across = np.linalg.norm(np.cross(to_a, to_b), axis=1)
    return np.asarray(np.arctan2(across, np.einsum("nk,nk->n", to_a, to_b)))


def write_correspondence(path: Path, uv_a_px: Array, found: Correspondence) -> None:
    """Write the pixels of view a (..., 2) that show the target, one row each."""
    on_target = found.reason != Reason.OFF_TARGET
    columns = {field.name: getattr(found, field.name)[on_target] for field in fields(found)}
    np.savez_compressed(path, uv_a_px=uv_a_px[on_target], **columns)
