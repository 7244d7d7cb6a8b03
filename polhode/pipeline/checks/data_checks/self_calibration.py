"""How many of its sigmas off the data put the calibration.

A wrong focal length stretches everything along the line of sight; a wrong angle between the cameras moves
near parts less along it than far ones. Neither shows in one pair, but a body that tumbles is stretched in
another direction in each frame, and no rigid body looks like that. What the residuals say of each, the other
left as it is, is part of the solution (``backend/uncertainty/self_calibration.py``).
"""

import numpy as np

from polhode.geometry.lie import Array
from polhode.records.estimate import CalibrationScore, MotionEstimate
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary_schema import Check

MIN_OBSERVATIONS = 100


def focal_check(estimate: MotionEstimate, has_ranges: bool) -> Check:
    """Of a wrong focal length or a wrong disparity at infinity, whichever is more likely.

    A wrong one stretches what range images measure as well, but not along the line of sight.
    """
    name, score = "focal length of ranges" if has_ranges else "focal length", estimate.calibration_score
    if score is None or np.sum(estimate.inlier_weight > 0.0) < MIN_OBSERVATIONS:
        return make_check(name, None)
    (focal, disparity_px), sigma, prior = best_stretches(score)
    off = np.abs([focal, disparity_px]) / np.hypot(sigma, prior)
    return make_check(
        name,
        float(off.min()),
        percent=100.0 * abs(focal),
        longer="longer" if focal > 0 else "shorter",
        sigma=100.0 * sigma[0],
        disparity_px=disparity_px,
    )


def best_stretches(score: CalibrationScore) -> tuple[Array, Array, Array]:
    """Focal length (relative) and disparity [px] that fit better, their sigmas and the prior's; (2,) each."""
    of_own = np.maximum(np.diag(score.information)[:2], 1e-300)
    sigma = np.sqrt(np.diag(score.noise)[:2]) / of_own
    prior = np.linalg.norm(score.information[:2, 2:], axis=1) / of_own
    return score.score[:2] / of_own, sigma, prior
