"""Whether what the motion predicted fits the images as well as what was found without it.

A wrong motion would draw matches that confirm it. It betrays itself: the solver comes to no end, more
observations contradict it, or all of them scatter more.
"""

import numpy as np

from polhode.records import MotionEstimate

MORE_OUTLIERS = 0.03
"""Growth of the share of observations without weight that is too much."""
MORE_NOISE = 1.08
"""Growth of the scatter of pixels that is too much: joined landmarks of TS38 scatter 4 % more and help, those
of a shaded asteroid 14 % more and harm."""


def contradicts(predicted: MotionEstimate, blind: MotionEstimate) -> bool:
    """Whether the estimate from associations made with the motion fits worse than the one from blind ones."""
    if blind.solver.converged and not predicted.solver.converged:
        return True
    outliers = [float(np.mean(estimate.inlier_weight == 0.0)) for estimate in (predicted, blind)]
    noise = predicted.noise.pixel_sigma_px / max(blind.noise.pixel_sigma_px, 1e-9)
    return outliers[0] > outliers[1] + MORE_OUTLIERS or noise > MORE_NOISE
