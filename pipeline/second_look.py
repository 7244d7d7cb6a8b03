"""Whether what the motion predicted fits the images as well as what was found without it.

A wrong motion would draw matches that confirm it. It betrays itself: the solver comes to no end, more
observations lie far off, or all of them scatter more.
"""

import numpy as np

from polhode.records import MotionEstimate

FAR = 4.5
"""Residuals of so many standard deviations of the estimate without prediction are far off."""
MORE_FAR = 0.03
"""Growth of the share of observations that are far off that is too much."""
MORE_NOISE = 1.08
"""Growth of the scatter of pixels that is too much: joined landmarks of TS38 scatter 4 % more and help, those
of a shaded asteroid 14 % more and harm."""


def contradicts(predicted: MotionEstimate, blind: MotionEstimate) -> bool:
    """Whether the estimate from associations made with the motion fits worse than the one from blind ones.

    Both are held to the same pixels: what scatters less calls more of its observations outliers.
    """
    if blind.solver.converged and not predicted.solver.converged:
        return True
    noise = predicted.noise.pixel_sigma_px / max(blind.noise.pixel_sigma_px, 1e-9)
    return far_off(predicted, blind) > far_off(blind, blind) + MORE_FAR or noise > MORE_NOISE


def far_off(estimate: MotionEstimate, measure: MotionEstimate) -> float:
    """Share of the observations further off than the noise of ``measure`` can explain."""
    noise = measure.noise
    sigma = np.maximum([noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px], 1e-9)
    return float(np.mean(np.any(np.abs(estimate.residuals_px) > FAR * sigma, axis=1)))
