"""Correspondences between two views, of any frames and cameras, by ray casting.

Rays go through the pixels of view a to the body in G, and from there to camera b.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Bools, inverse_pose, transform_points
from polhode.simulation.dataset.plan import SequencePlan
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.stereo_camera import Camera


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
    """(...) on the target, facing camera b, inside image b, and not occluded"""
    p_G: Array
    """(..., 3) [m]; NaN off the target"""
    angle_rad: Array
    """(...) at the point, between the directions to the two cameras; NaN off the target"""


def view_of(plan: SequencePlan, frame: int, camera: int) -> CameraView:
    """CameraView of one camera (0: left, 1: right) at one frame."""
    chosen = plan.cameras[camera]
    return CameraView(chosen, inverse_pose(plan.target.X_NG[frame]) @ plan.X_NC[frame] @ chosen.X_CK)


def correspond(caster: RayCaster, a: CameraView, b: CameraView, uv_a_px: Array) -> Correspondence:
    """Correspondences of distorted pixels (..., 2) of view a in view b.

    Of all pixels: ``a.camera.pixel_grid()``; the optical flow is then uv_b_px minus them.
    """
    shape = uv_a_px.shape[:-1]
    rays_K = a.camera.directions(uv_a_px.reshape(-1, 2))
    hits = caster.first_hits(a.X_GK[:3, 3], rays_K @ a.X_GK[:3, :3].T)
    count = len(rays_K)
    uv_b, p_G = np.full((count, 2), np.nan), np.full((count, 3), np.nan)
    visible, angle = np.zeros(count, np.bool_), np.full(count, np.nan)
    p_G[hits.ray] = hits.p_G
    uv_b[hits.ray] = image_b = _image_of(b, hits.p_G)
    to_a, to_b = a.X_GK[:3, 3] - hits.p_G, b.X_GK[:3, 3] - hits.p_G
    across = np.linalg.norm(np.cross(to_a, to_b), axis=1)
    angle[hits.ray] = np.arctan2(across, np.einsum("nk,nk->n", to_a, to_b))
    distance = np.linalg.norm(to_b, axis=1)
    # That the face is turned to camera b is part of a clear way to it.
    clear = caster.clear(hits, to_b / distance[:, None], distance)
    visible[hits.ray] = _inside(b.camera, image_b) & clear
    return Correspondence(
        uv_b.reshape(*shape, 2), visible.reshape(shape), p_G.reshape(*shape, 3), angle.reshape(shape)
    )


def _image_of(view: CameraView, p_G: Array) -> Array:
    """Pixels (n, 2) of points (n, 3), inside the image or outside; NaN where the lens forms no image."""
    p_K = transform_points(inverse_pose(view.X_GK), p_G)
    uv = np.full((len(p_K), 2), np.nan)
    before = p_K[:, 2] > 1e-6
    if not before.any():
        return uv
    uv[before] = view.camera.project(p_K[before])
    if view.camera.distorted:
        # A distorting lens folds far points back into the image: their pixel has another ray.
        inside = np.flatnonzero(_inside(view.camera, uv))
        rays = p_K[inside] / np.linalg.norm(p_K[inside], axis=1, keepdims=True)
        folded = np.linalg.norm(view.camera.directions(uv[inside]) - rays, axis=1) > 1e-6
        uv[inside[folded]] = np.nan
    return uv


def _inside(camera: Camera, uv_px: Array) -> Bools:
    """True (n,) within the borders of the image; false for NaN."""
    size = [camera.width_px - 0.5, camera.height_px - 0.5]
    return np.asarray(((uv_px >= -0.5) & (uv_px < size)).all(axis=1))
