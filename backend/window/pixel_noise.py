"""The noise of the pixels, from the residuals that the window holds."""

import numpy as np

from polhode.backend.noise.measurement_noise import LEAST_OBSERVATIONS, LIMITS, MAD_TO_SIGMA
from polhode.backend.window.estimator_state import Belief
from polhode.backend.window.vision import Sight, poses_of, residuals
from polhode.lie import Array

MOST_TAKEN_BY_POSES = 0.3


def estimate_noise(belief: Belief) -> None:
    """Rescale the standard deviations of u, v and of the disparity by the median absolute residual."""
    sight = belief.sight()
    if len(sight.frame) < LEAST_OBSERVATIONS:
        return
    p_G = belief.landmarks.p_G[sight.slot]
    r = residuals(sight, poses_of(belief.active.frames), belief.rig_vector, p_G)
    free = np.maximum(1.0 - taken_by_fit(belief, sight, p_G), 0.05)
    whitened = np.abs(r) / np.sqrt(free)
    uv, disparity = np.clip(
        MAD_TO_SIGMA * np.array([np.median(whitened[:, :2]), np.median(whitened[:, 2])]), *LIMITS
    )
    factors = np.array([uv, uv, disparity])
    belief.noise = belief.noise * factors
    for frame in belief.active.frames:
        frame.inv_sigma = frame.inv_sigma / factors


def taken_by_fit(belief: Belief, sight: Sight, p_G: Array) -> Array:
    """Share (M, 3) of each residual's freedom that landmarks and poses take."""
    frames = belief.active.frames
    poses = poses_of(frames)
    A, k = poses.A[sight.frame], sight.frame
    p_R = (
        np.einsum("mij,mj->mi", A, p_G[sight.landmark])
        + (np.einsum("fij,fj->fi", poses.R_RN, poses.p_NG) + poses.t_R)[k]
    )
    f, b = belief.rig.focal_px, belief.rig.baseline_m
    x, y, z = p_R.T
    D = np.zeros((len(k), 3, 3))
    D[:, 0, 0] = D[:, 1, 1] = f / z
    D[:, 0, 2], D[:, 1, 2], D[:, 2, 2] = -f * x / z**2, -f * y / z**2, -f * b / z**2
    J = sight.inv_sigma[:, :, None] * (D @ A)
    information = np.add.reduceat(np.swapaxes(J, 1, 2) @ J, sight.start[:-1], axis=0)
    taken = np.einsum("mij,mjk,mik->mi", J, np.linalg.inv(information)[sight.landmark], J)
    # the poses are fitted to u and v: six numbers for the two of each observation
    taken[:, :2] += min(3.0 * len(frames) / len(k), MOST_TAKEN_BY_POSES)
    return np.asarray(taken)
