"""Whether the residuals look like noise: in time, over the image, and against the depth.

Residuals of a right answer have no mean that depends on when, where or how far away a landmark was seen,
beyond their scatter. What has one: a clock or a rig that is not as stated (a mean by region, or one that
follows the disparity), landmarks that slide over the surface or stand still on it (a mean by region), frames
whose measurements contradict the dynamics (a mean by frame). What the poses or the map absorb, as a wrong
distance, leaves none.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Ints, MotionEstimate, StereoTracks

REGIONS = 4
"""Along either side of the part of the image in which landmarks were seen."""
MIN_IN_REGION, MIN_IN_FRAME, MIN_MEANS = 30, 8, 4
"""Observations of a mean that counts, and number of such means."""
FULL_WEIGHT = 0.1
"""Observations with less weight contradict the motion, and are counted elsewhere."""
MAX_BY_FRAME, MAX_BY_REGION, MAX_BY_REGION_D, MAX_SLOPE, MAX_STEP = 2.5, 2.0, 3.0, 0.12, 4.0
"""Above these the answer is doubted (docs/checks.md)."""
MIN_BESIDE_STEP = 3
"""Frames on either side of a step."""
NORMAL_MEDIAN = 0.455
"""Of the square of a standard normal deviate."""
CLEAR_SLOPE = 5.0
"""Standard errors of a correlation, one over the root of the number of observations"""


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
    return [
        _by_frame(found),
        step_check(found),
        *_by_region(found),
        _by_disparity(found),
        _from_frame_to_frame(found),
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


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _by_frame(found: Residuals) -> Check:
    check = Check(name="mean residual of the disparity, by frame", limit=MAX_BY_FRAME, unit="sigma")
    means = means_in_errors(found.whitened, found.frame, found.landmark, MIN_IN_FRAME)
    if len(means) < MIN_MEANS:
        return check
    size = _root_mean_square(means[:, 2])
    return check.judged(
        size,
        f"the disparities of whole frames differ from the motion by {size:.1f} times what their noise "
        "allows: a step of the calibration, or a motion that is not the one assumed, may be the cause",
    )


def step_check(found: Residuals) -> Check:
    """Of all disparities at some frame, beside a straight line in time, which a velocity absorbs.

    Largest ratio of a step to its standard error over the frames at which it may be, by weighted least
    squares; the errors of frames are as large as the median of their squares says.
    """
    check = Check(name="step of the residuals of the disparity", limit=MAX_STEP, unit="sigma")
    count = np.bincount(found.frame)
    frames = np.flatnonzero(count >= MIN_IN_FRAME)
    if len(frames) <= 2 * MIN_BESIDE_STEP:
        return check
    root = np.sqrt(count[frames])
    mean = np.bincount(found.frame, found.whitened[:, 2])[frames] / count[frames]
    line, _ = np.linalg.qr(root[:, None] * np.stack([np.ones(len(frames)), frames], axis=1))
    step = root[:, None] * np.tri(len(frames), dtype=np.float64)[:, MIN_BESIDE_STEP:-MIN_BESIDE_STEP]
    left, step = root * mean - line @ (line.T @ (root * mean)), step - line @ (line.T @ step)
    scatter = max(1.0, float(np.median(left**2)) / NORMAL_MEDIAN)
    size = np.abs(step.T @ left) / np.maximum(np.linalg.norm(step, axis=0), 1e-9) / np.sqrt(scatter)
    at = int(np.argmax(size))
    return check.judged(
        float(size[at]),
        f"about frame {frames[at + MIN_BESIDE_STEP]} the disparities step away from the motion by "
        f"{size[at]:.1f} standard errors: a camera may have been knocked, or the target pushed",
    )


def _by_region(found: Residuals) -> list[Check]:
    place = Check(name="mean residual of u, v, by region of the image", limit=MAX_BY_REGION, unit="sigma")
    depth = Check(
        name="mean residual of the disparity, by region of the image", limit=MAX_BY_REGION_D, unit="sigma"
    )
    if not len(found.frame):
        return [place, depth]
    uv = found.uvd_px[:, :2]
    low, high = np.quantile(uv, [0.02, 0.98], axis=0)
    cell = np.clip((uv - low) / np.maximum(high - low, 1e-9) * REGIONS, 0, REGIONS - 1).astype(np.int64)
    means = means_in_errors(found.whitened, cell[:, 0] * REGIONS + cell[:, 1], found.landmark, MIN_IN_REGION)
    if len(means) < MIN_MEANS:
        return [place, depth]
    sizes = _root_mean_square(means[:, :2]), _root_mean_square(means[:, 2])
    words = (
        "residuals of {} depend on the region of the image, by {:.1f} times what their noise allows: the "
        "calibration or the cameras' synchronisation may be wrong, or features slide over the surface"
    )
    return [
        place.judged(sizes[0], words.format("u and v", sizes[0])),
        depth.judged(sizes[1], words.format("the disparity", sizes[1])),
    ]


def _by_disparity(found: Residuals) -> Check:
    """Correlation of disparity and its residual, the means of each frame left out."""
    check = Check(name="residuals of the disparity that follow the disparity", limit=MAX_SLOPE)
    if len(found.frame) < MIN_IN_REGION:
        return check
    both = np.stack([found.uvd_px[:, 2], found.whitened[:, 2]], axis=1)
    count = np.maximum(np.bincount(found.frame), 1)
    means = np.stack([np.bincount(found.frame, column) for column in both.T], axis=1) / count[:, None]
    x, y = (both - means[found.frame]).T
    power = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    if power <= 0.0:
        return check
    size = abs(float(x @ y)) / power
    return check.judged(
        size,
        f"residuals of the disparity follow the disparity (correlation {size:.2f}): near and far parts of "
        "the target move differently than one rigid body seen by this rig; check the calibration and the "
        "cameras' synchronisation",
        max(MAX_SLOPE, CLEAR_SLOPE / float(np.sqrt(len(x)))),
    )


def _from_frame_to_frame(found: Residuals) -> Check:
    """Correlation of a landmark's residuals in successive frames, the larger of u, v and disparity, or 0.

    Information: the covariance takes account of it, and right and wrong runs hardly differ by it.
    """
    check = Check(name="residuals of a landmark in successive frames: correlation", limit=None)
    order = np.lexsort((found.frame, found.landmark))
    a, b = order[:-1], order[1:]
    next_to = (found.landmark[a] == found.landmark[b]) & (found.frame[b] == found.frame[a] + 1)
    a, b = a[next_to], b[next_to]
    if len(a) < MIN_IN_REGION:
        return check
    sizes = []
    for columns in ((0, 1), (2,)):
        x, y = (found.whitened[rows][:, columns] for rows in (a, b))
        sizes.append(float(np.sum(x * y) / max(np.sqrt(np.sum(x**2) * np.sum(y**2)), 1e-12)))
    return check.judged(max(*sizes, 0.0), "")
