"""By how much a patch is turned against another patch of the same surface point, by the true motion."""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array


def turn_between(
    affine_a: Array, affine_b: Array, p_a: Array, normal_a: Array, R_ba: Array, p_b: Array, rig: RectifiedRig
) -> Array:
    """Angle (n,) [rad] in patch b of what lies along x in patch a; maps (n, 2, 2) as ``frontend.patches``.

    p_a, normal_a (n, 3) in camera a, p_b (n, 3) in camera b; R_ba (n, 3, 3) turns a's axes into b's.
    """
    direction_a = _on_surface(affine_a[:, :, 0], p_a, normal_a, rig)
    direction_b = np.einsum("nij,nj->ni", R_ba, direction_a)
    pixels = np.einsum("nij,nj->ni", _projection(p_b, rig), direction_b)
    x, y = np.linalg.solve(affine_b, pixels[..., None])[..., 0].T
    return np.asarray(np.arctan2(y, x))


def _on_surface(step_px: Array, p_K: Array, normal_K: Array, rig: RectifiedRig) -> Array:
    """Vectors (n, 3) in the tangent planes whose images are the steps (n, 2)."""
    n = len(step_px)
    # Scaled like the projection, so that the system is well conditioned.
    system = np.concatenate([_projection(p_K, rig), normal_K[:, None] * rig.focal_px], axis=1)
    wanted = np.concatenate([step_px, np.zeros((n, 1))], axis=1)
    return np.asarray(np.linalg.solve(system, wanted[..., None])[..., 0])


def _projection(p_K: Array, rig: RectifiedRig) -> Array:
    """d (u, v) / d p (n, 2, 3) [px/m]."""
    x, y, z = p_K.T
    zero, f = np.zeros_like(z), rig.focal_px
    return np.stack([f / z, zero, -f * x / z**2, zero, f / z, -f * y / z**2], axis=-1).reshape(-1, 2, 3)
