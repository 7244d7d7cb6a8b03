"""Whether landmarks slide over the surface as the Sun moves around the body.

What a feature marks is partly shade: as the Sun's direction changes in G, the edge of a shadow or the bright
side of a bump moves along the surface, towards or away from the Sun. One number, the slide per change of the
tangential part of the Sun's direction, is fitted to the residuals of u and v. The covariance counts each
landmark once. The surface's normal is taken to point from the centre of mass to the landmark.

A slide that all landmarks share in each frame is taken for motion and leaves no residual; what does is its
change over the surface.
"""

import numpy as np

from polhode.camera import stereo_jacobian
from polhode.lie import Array, inverse_pose
from polhode.pipeline.answer_checks.residual_check import FULL_WEIGHT
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import MotionEstimate, StereoTracks

MAX_SIGMAS = 5.0
"""Undisturbed runs have up to 3.9."""
MIN_LANDMARKS = 30
"""Seen at least twice"""

SUN_CHECK = "landmarks that slide with the Sun"
"""Its name"""


def sun_check(tracks: StereoTracks, estimate: MotionEstimate, sun_N: Array | None) -> Check:
    """Significance of the slide; sun_N (3,): unit vector towards the Sun, None: not known."""
    check = Check(name=SUN_CHECK, limit=MAX_SIGMAS, unit="sigma")
    good = np.flatnonzero(estimate.inlier_weight > FULL_WEIGHT)
    landmark = tracks.landmark[good]
    count = np.bincount(landmark, minlength=tracks.n_landmarks)
    if sun_N is None or np.sum(count > 1) < MIN_LANDMARKS:
        return check
    frame, rig = tracks.frame[good], tracks.rig
    residual = estimate.residuals_px[good]
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    p_R = rig.triangulate(tracks.uvd_px[good] - residual)
    R_RG = X_RG[frame, :3, :3]
    p_G = np.einsum("nji,nj->ni", R_RG, p_R - X_RG[frame, :3, 3])
    normal = p_G - estimate.mass.com_G
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    sun_G = (sun_N @ estimate.X_NG[:, :3, :3])[frame]
    along = sun_G - np.sum(sun_G * normal, axis=1, keepdims=True) * normal
    # the landmark itself takes the mean
    sums = np.stack([np.bincount(landmark, part, tracks.n_landmarks) for part in along.T], axis=1)
    along -= (sums / np.maximum(count, 1)[:, None])[landmark]
    J = stereo_jacobian(p_R, rig.focal_px, rig.baseline_m)[:, :2]
    x = np.einsum("nij,njk,nk->ni", J, R_RG, along)
    xx, xy = np.sum(x**2, axis=1), np.sum(x * residual[:, :2], axis=1)
    if not xx.sum() > 0.0:
        return check
    slide_m = xy.sum() / xx.sum()
    by_landmark = np.bincount(landmark, xy - slide_m * xx)
    sigma_m = float(np.sqrt(np.sum(by_landmark**2))) / xx.sum()
    size = abs(slide_m) / max(sigma_m, 1e-12)
    return check.judged(
        size,
        f"landmarks slide over the surface by {1e3 * abs(slide_m):.2g} mm as the Sun's direction changes by "
        f"a radian ({size:.1f} sigma): shades were taken for marks of the surface, and the motion follows "
        "them in part",
    )
