"""Whether the residuals look like noise: in time, over the image, against the depth, and in the Sun.

Residuals of a right answer have no mean that depends on when, where or how far away a landmark was seen,
beyond their scatter. What has one: a clock or a rig that is not as stated (a mean by region, or one that
follows the disparity), landmarks that slide over the surface or stand still on it (a mean by region), frames
whose measurements contradict the dynamics (a mean by frame). What the poses or the map absorb, as a wrong
distance, leaves none.

What a feature marks is partly shade: as the Sun's direction changes in G, the edge of a shadow or the bright
side of a bump moves along the surface, towards or away from the Sun. A slide that all landmarks share in each
frame is taken for motion and leaves no residual; what does is its change over the surface.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, make_check
from polhode.run_directory.summary_schema import Check

MIN_IN_REGION, MIN_IN_FRAME = 30, 8
"""Observations of a mean that counts."""
FULL_WEIGHT = 0.1
"""Observations with less weight contradict the motion, and are counted elsewhere."""
MIN_STEP_FRAMES = 3
"""Frames on either side of a step."""


@dataclass(frozen=True)
class Residuals:
    """Of the observations that agree with the motion, in their standard deviations."""

    frame: Ints
    """(n,)"""
    landmark: Ints
    """(n,)"""
    uvd_px: Array
    """(n, 3) predicted: what was measured has the noise that its residual has"""
    whitened: Array
    """(n, 3)"""


def residual_checks(tracks: StereoTracks, estimate: MotionEstimate) -> list[Check]:
    """Means by frame and by region, a step, dependence on the disparity, and from frame to frame."""
    found = agreeing_residuals(tracks, estimate)
    by_frame = means_in_errors(found.whitened, found.frame, found.landmark, MIN_IN_FRAME)
    by_region = np.zeros((0, 3))
    if len(found.frame):
        # four regions along either side of the part of the image in which landmarks were seen
        uv, regions = found.uvd_px[:, :2], 4
        low, high = np.quantile(uv, [0.02, 0.98], axis=0)
        cell = np.clip((uv - low) / np.maximum(high - low, 1e-9) * regions, 0, regions - 1).astype(np.int64)
        number = cell[:, 0] * regions + cell[:, 1]
        by_region = means_in_errors(found.whitened, number, found.landmark, MIN_IN_REGION)

    def root_mean_square(means: Array) -> float | None:
        return float(np.sqrt(np.mean(np.square(means)))) if len(means) >= 4 else None

    return [
        make_check("residuals by frame", root_mean_square(by_frame[:, 2])),
        step_check(found),
        make_check("residuals of u, v by region", root_mean_square(by_region[:, :2])),
        make_check("residuals of disparity by region", root_mean_square(by_region[:, 2])),
        _disparity_correlation(found),
        _frame_to_frame_correlation(found),
    ]


def agreeing_residuals(tracks: StereoTracks, estimate: MotionEstimate) -> Residuals:
    """Residuals over the noise that the estimate found, in proportion to the stated standard deviations."""
    good = estimate.inlier_weight > FULL_WEIGHT
    noise = estimate.noise
    sigma = np.array([noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px])
    stated = tracks.sigma_px[good]
    own = np.maximum(sigma * stated / np.median(tracks.sigma_px, axis=0), 1e-9)
    return Residuals(
        tracks.frame[good],
        tracks.landmark[good],
        tracks.uvd_px[good] - estimate.residuals_px[good],
        estimate.residuals_px[good] / own,
    )


def means_in_errors(values: Array, group: Ints, landmark: Ints, least: int) -> Array:
    """Means (g, c) of values (n, c) by group (n,), over their standard errors; of groups with ``least``.

    Errors of one landmark (n,) may be alike: the standard error is that of clusters where it is larger than
    that of single values (Liang and Zeger, Biometrika 73, 1986).
    """
    count = np.bincount(group)
    enough = count >= least
    pair, members = np.unique(np.stack([group, landmark]), axis=1, return_inverse=True)
    of_landmark = np.stack([np.bincount(members.ravel(), column) for column in values.T], axis=1)
    n, columns = len(count), range(values.shape[1])
    sums = np.stack([np.bincount(pair[0], of_landmark[:, c], n) for c in columns], axis=1)
    clusters = np.stack([np.bincount(pair[0], of_landmark[:, c] ** 2, n) for c in columns], axis=1)
    variance = np.maximum(clusters, count[:, None])[enough]
    return np.asarray(sums[enough] / np.sqrt(variance))


def step_check(found: Residuals) -> Check:
    """Of all disparities at some frame, beside a straight line in time, which a velocity absorbs.

    Largest ratio of a step to its standard error over the frames at which it may be, by weighted least
    squares; the errors of frames are as large as the median of their squares says.
    """
    count = np.bincount(found.frame)
    frames = np.flatnonzero(count >= MIN_IN_FRAME)
    if len(frames) <= 2 * MIN_STEP_FRAMES:
        return make_check("step of residuals", None)
    root = np.sqrt(count[frames])
    mean = np.bincount(found.frame, found.whitened[:, 2])[frames] / count[frames]
    line, _ = np.linalg.qr(root[:, None] * np.stack([np.ones(len(frames)), frames], axis=1))
    step = root[:, None] * np.tri(len(frames), dtype=np.float64)[:, MIN_STEP_FRAMES:-MIN_STEP_FRAMES]
    left, step = root * mean - line @ (line.T @ (root * mean)), step - line @ (line.T @ step)
    # 0.455: the median of the square of a standard normal deviate
    scatter = max(1.0, float(np.median(left**2)) / 0.455)
    size = np.abs(step.T @ left) / np.maximum(np.linalg.norm(step, axis=0), 1e-9) / np.sqrt(scatter)
    at = int(np.argmax(size))
    return make_check("step of residuals", float(size[at]), frame=frames[at + MIN_STEP_FRAMES])


def _disparity_correlation(found: Residuals) -> Check:
    """Correlation of disparity and its residual, the means of each frame left out.

    The limit is at least five standard errors of a correlation, one over the root of the number of
    observations.
    """
    key = "residuals by disparity"
    if len(found.frame) < MIN_IN_REGION:
        return make_check(key, None)
    both = np.stack([found.uvd_px[:, 2], found.whitened[:, 2]], axis=1)
    count = np.maximum(np.bincount(found.frame), 1)
    means = np.stack([np.bincount(found.frame, column) for column in both.T], axis=1) / count[:, None]
    x, y = (both - means[found.frame]).T
    power = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    if power <= 0.0:
        return make_check(key, None)
    limit = max(CHECK_TABLE[key].limit or 0.0, 5.0 / float(np.sqrt(len(x))))
    return make_check(key, abs(float(x @ y)) / power, limit)


def _frame_to_frame_correlation(found: Residuals) -> Check:
    """Correlation of a landmark's residuals in successive frames, the larger of u, v and disparity, or 0."""
    order = np.lexsort((found.frame, found.landmark))
    a, b = order[:-1], order[1:]
    next_to = (found.landmark[a] == found.landmark[b]) & (found.frame[b] == found.frame[a] + 1)
    a, b = a[next_to], b[next_to]
    if len(a) < MIN_IN_REGION:
        return make_check("residuals from frame to frame", None)
    sizes = []
    for columns in ((0, 1), (2,)):
        x, y = (found.whitened[rows][:, columns] for rows in (a, b))
        sizes.append(float(np.sum(x * y) / max(np.sqrt(np.sum(x**2) * np.sum(y**2)), 1e-12)))
    return make_check("residuals from frame to frame", max(*sizes, 0.0))


def sun_check(tracks: StereoTracks, estimate: MotionEstimate, sun_N: Array | None) -> Check:
    """Significance of the slide with the Sun; sun_N (3,): unit vector towards the Sun, None: not known.

    One number, the slide per change of the tangential part of the Sun's direction, is fitted to the residuals
    of u and v. The covariance counts each landmark once. The surface's normal is taken to point from the
    centre of mass to the landmark.
    """
    good = np.flatnonzero(estimate.inlier_weight > FULL_WEIGHT)
    landmark = tracks.landmark[good]
    count = np.bincount(landmark, minlength=tracks.n_landmarks)
    if sun_N is None or np.sum(count > 1) < 30:
        return make_check("sun", None)
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
        return make_check("sun", None)
    slide_m = xy.sum() / xx.sum()
    by_landmark = np.bincount(landmark, xy - slide_m * xx)
    sigma_m = float(np.sqrt(np.sum(by_landmark**2))) / xx.sum()
    return make_check("sun", abs(slide_m) / max(sigma_m, 1e-12), slide_mm=1e3 * abs(slide_m))
