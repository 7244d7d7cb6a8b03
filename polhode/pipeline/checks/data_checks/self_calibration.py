"""Which focal length, or which offset of all disparities, would fit the tumbling target best.

A wrong focal length stretches everything along the line of sight; a wrong angle between the cameras moves
near parts less along it than far ones. Neither shows in one pair, but a body that tumbles is stretched in
another direction in each frame, and no rigid body looks like that. The first-order correction of each, the
other left as it is, is solved for together with all poses and landmarks; the dynamics are left out.

The landmarks are eliminated first (Schur complement). A weak prior bounds the poses' six common directions,
which only move the map.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array, Ints, hat, inverse_pose
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import frame_step, make_check
from polhode.run_directory.summary_schema import Check

SIGMA_SCATTER = 2.2
"""Of the focal lengths that fit best over undisturbed bodies, in their sigmas, which know of no errors that
observations have in common (rms of 17 sequences)"""
UNMODELLED = 5e-4
"""Of the focal length: features that follow the light pretend as much on bodies that turn by less than one
revolution"""
LANDMARKS_AT_ONCE = 500
"""Are eliminated together: bounds the memory."""
PRIOR = 1e-6
"""Of each unknown's diagonal"""


@dataclass(frozen=True)
class Correction:
    """What to add to the calibration, each if the other is right."""

    focal: float
    """Relative to the focal length of both cameras"""
    sigma_focal: float
    disparity_px: float
    """To the disparity at infinity"""
    sigma_disparity_px: float


def best_correction(tracks: StereoTracks, estimate: MotionEstimate) -> Correction | None:
    """From the measurements that agree with the estimate, at least a hundred; None: there are fewer."""
    step = frame_step(tracks.n_frames)
    used = np.flatnonzero((estimate.inlier_weight > 0.0) & (tracks.frame % step == 0))
    if len(used) < 100:
        return None
    frames, frame = np.unique(tracks.frame[used], return_inverse=True)
    landmark = np.unique(tracks.landmark[used], return_inverse=True)[1]
    X_RG = (inverse_pose(tracks.X_NR) @ estimate.X_NG)[frames]
    predicted = tracks.uvd_px[used] - estimate.residuals_px[used]
    p_R = tracks.rig.triangulate(predicted)
    scale = np.array([estimate.noise.pixel_sigma_px] * 2 + [estimate.noise.disparity_sigma_px])
    root = np.sqrt(estimate.inlier_weight[used])[:, None] / np.maximum(scale, 1e-6)
    rig = tracks.rig
    J_p = root[:, :, None] * stereo_jacobian(p_R, rig.focal_px, rig.baseline_m)
    # pose: p_R + t + a x p_R
    J_pose = np.concatenate([J_p, -J_p @ hat(p_R)], axis=2)
    J_landmark = J_p @ X_RG[frame, :3, :3]
    along = predicted - np.array([rig.cx_px, rig.cy_px, rig.disparity_offset_px])
    offset = np.broadcast_to(np.array([0.0, 0.0, 1.0]), along.shape)
    J_rig = root[:, :, None] * np.stack([along, offset], axis=2)
    residual = root * estimate.residuals_px[used]
    return _solve_correction(frame, landmark, J_pose, J_landmark, J_rig, residual)


def focal_check(found: Correction | None, tracks: StereoTracks) -> Check:
    """How many of its sigmas off the data put the calibration, as a wrong focal length or a wrong disparity
    at infinity, whichever is more likely.

    A wrong one stretches what range images measure as well, but not along the line of sight.
    """
    has_ranges = tracks.calibration is not None and tracks.calibration.has_ranges
    name = "focal length of ranges" if has_ranges else "focal length"
    if found is None:
        return make_check(name, None)
    prior_px = prior_of_disparities(tracks)
    to_focal = 1.0 / float(np.median(tracks.uvd_px[:, 2] - tracks.rig.disparity_offset_px))
    sigma = [
        np.linalg.norm([prior_px * to_focal, UNMODELLED, SIGMA_SCATTER * found.sigma_focal]),
        np.linalg.norm([prior_px, UNMODELLED / to_focal, SIGMA_SCATTER * found.sigma_disparity_px]),
    ]
    off = np.abs([found.focal, found.disparity_px]) / sigma
    return make_check(
        name,
        float(off.min()),
        percent=100.0 * abs(found.focal),
        longer="longer" if found.focal > 0 else "shorter",
        sigma=100.0 * found.sigma_focal,
        disparity_px=found.disparity_px,
    )


def prior_of_disparities(tracks: StereoTracks) -> float:
    """Standard deviation [px] of what errors of the calibration change in the disparities of all together.

    The share of the disparity by which it is wrong is the share by which the depth of a body is stretched
    more than its width, as by a wrong focal length.
    """
    if tracks.calibration is None or not len(tracks.frame):
        return 0.0
    sample = np.linspace(0, len(tracks.frame) - 1, 500).astype(np.int64)
    effect = tracks.calibration.at(tracks.rig, tracks.rig.triangulate(tracks.uvd_px[sample]))
    return float(np.linalg.norm(np.median(effect[:, 2], axis=0)))


def _solve_correction(
    frame: Ints, landmark: Ints, J_pose: Array, J_landmark: Array, J_rig: Array, residual: Array
) -> Correction:
    """The correction from n whitened observations: frame, landmark (n,); J (n, 3, ...)."""
    F, L, k = int(frame.max()) + 1, int(landmark.max()) + 1, J_rig.shape[2]
    n = 6 * F + k
    B = np.zeros((L, 3, 3))
    np.add.at(B, landmark, np.einsum("nai,naj->nij", J_landmark, J_landmark))
    B += (PRIOR * np.trace(B, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
    g_l = np.zeros((L, 3))
    np.add.at(g_l, landmark, np.einsum("nai,na->ni", J_landmark, residual))
    A, g = np.zeros((n, n)), np.zeros(n)
    rows = 6 * frame[:, None] + np.arange(6)
    blocks = np.zeros((F, 6, 6))
    np.add.at(blocks, frame, np.einsum("nai,naj->nij", J_pose, J_pose))
    for j in range(F):
        A[6 * j : 6 * j + 6, 6 * j : 6 * j + 6] = blocks[j]
    between = np.zeros((F, 6, k))
    np.add.at(between, frame, np.einsum("nai,naj->nij", J_pose, J_rig))
    A[: 6 * F, 6 * F :] = between.reshape(6 * F, k)
    A[6 * F :, : 6 * F] = A[: 6 * F, 6 * F :].T
    A[6 * F :, 6 * F :] = np.einsum("nai,naj->ij", J_rig, J_rig)
    np.add.at(g, rows.ravel(), np.einsum("nai,na->ni", J_pose, residual).ravel())
    g[6 * F :] = np.einsum("nai,na->i", J_rig, residual)
    of_pose = np.einsum("nai,naj->nij", J_landmark, J_pose)
    of_rig = np.einsum("nai,naj->nij", J_landmark, J_rig)
    B_inv = np.linalg.inv(B)
    for first in range(0, L, LANDMARKS_AT_ONCE):
        part = slice(first, first + LANDMARKS_AT_ONCE)
        here = np.flatnonzero((landmark >= first) & (landmark < part.stop))
        cross = np.zeros((len(B_inv[part]), 3, n))
        index = landmark[here, None, None] - first, np.arange(3)[:, None]
        np.add.at(cross, (*index, rows[here][:, None, :]), of_pose[here])
        np.add.at(cross, (*index, 6 * F + np.arange(k)), of_rig[here])
        weighted = np.einsum("lij,ljn->lin", B_inv[part], cross).reshape(-1, n)
        A -= cross.reshape(-1, n).T @ weighted
        g -= weighted.T @ g_l[part].reshape(-1)
    freedom = max(residual.size - 3 * L - 6 * F, 1)
    chi2 = max(float(np.sum(residual**2)) / freedom, 1.0)
    found = []
    for j in range(k):
        kept = [*range(6 * F), 6 * F + j]
        own = A[np.ix_(kept, kept)]
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(own), 1e-300))
        inverse = np.linalg.inv(own * scale[:, None] * scale + PRIOR * np.eye(len(kept)))
        step = float(inverse[-1] @ (g[kept] * scale)) * scale[-1]
        found += [step, float(np.sqrt(chi2 * inverse[-1, -1])) * scale[-1]]
    return Correction(*found)
