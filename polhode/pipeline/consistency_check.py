"""Whether a later solution fits as well as an earlier one: after rematching, or with a second feature method.

A wrong motion would guide the matching towards matches that confirm it. Three signs betray it: the solver
does not converge, more observations are outliers, or all of them scatter more. A method whose features follow
the illumination instead of the surface is betrayed by a motion that differs from the first method's.
"""

import logging

import numpy as np

from polhode.geometry.lie import Bools, log_so3
from polhode.geometry.rigid_fit import mean_rotation
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks

OUTLIER_SIGMAS = 4.5
"""An observation is an outlier if its residual exceeds so many standard deviations of the earlier
estimate."""
MAX_NOISE_GROWTH = 1.08
"""Largest accepted growth of the pixel scatter: merged landmarks of TS38 scatter 4 % more and help, those of
a shaded asteroid 14 % more and harm."""
SAME_MOTION_DEG = 1.0
"""Attitudes from two methods that see the same motion differ by less, in the median: by at most 0.2 degrees
on the scenes of the benchmark, by 7 and 12 where the second method's features followed the light."""

_log = logging.getLogger(__name__)


def fits_worse(later: MotionEstimate, earlier: MotionEstimate) -> bool:
    """Whether the estimate from guided associations fits worse than the one from unguided ones.

    Outliers of both are judged by the earlier estimate's pixel noise: with less scatter, more observations
    would count as outliers.
    """
    if earlier.solver.converged and not later.solver.converged:
        return True
    noise = later.noise.pixel_sigma_px / max(earlier.noise.pixel_sigma_px, 1e-9)
    growth = outlier_share(later, earlier) - outlier_share(earlier, earlier)
    return growth > 0.03 or noise > MAX_NOISE_GROWTH


def outlier_share(estimate: MotionEstimate, reference: MotionEstimate) -> float:
    """Share of the observations with residuals that the noise of ``reference`` cannot explain."""
    noise = reference.noise
    sigma = np.maximum([noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px], 1e-9)
    return float(np.mean(np.any(np.abs(estimate.residuals_px) > OUTLIER_SIGMAS * sigma, axis=1)))


def contradicts_first_method(
    both: tuple[StereoTracks, MotionEstimate], first: tuple[StereoTracks, MotionEstimate], connected: Bools
) -> bool:
    """Whether the solution from two methods differs in motion from the first one's or fits its points worse.

    connected (F,): the frames that the first method connected. The tracks of both solutions contain the first
    method's observations; the residuals of those that they share are compared.
    """
    (tracks, estimate), (first_tracks, first_estimate) = both, first
    if first_estimate.solver.converged != estimate.solver.converged:
        return first_estimate.solver.converged
    difference_deg = attitude_difference_deg(estimate, first_estimate, connected)
    noise = estimate.noise.pixel_sigma_px / max(first_estimate.noise.pixel_sigma_px, 1e-9)
    scatter = _scatter_of_shared(tracks, estimate, first_tracks, first_estimate)
    _log.info(
        "two feature methods: attitudes differ by %.3f deg; scatter is %.2f times the first method's, of its "
        "own points %.2f times",
        *(difference_deg, noise, scatter),
    )
    return difference_deg > SAME_MOTION_DEG or max(noise, scatter) > MAX_NOISE_GROWTH


def attitude_difference_deg(a: MotionEstimate, b: MotionEstimate, frames: Bools) -> float:
    """Median angle [deg] between the attitudes of two estimates over the frames (F,), after the best-fitting
    constant rotation between their body frames."""
    R_a, R_b = a.X_NG[frames, :3, :3], b.X_NG[frames, :3, :3]
    R_ba = mean_rotation(np.swapaxes(R_b, 1, 2) @ R_a)
    difference = log_so3(np.swapaxes(R_b @ R_ba, 1, 2) @ R_a)
    return float(np.rad2deg(np.median(np.linalg.norm(difference, axis=1))))


def _scatter_of_shared(
    tracks: StereoTracks, estimate: MotionEstimate, first_tracks: StereoTracks, first: MotionEstimate
) -> float:
    """Median image residual of the shared observations, relative to the first solution's; 1 if none is
    shared. Their coordinates are equal to the last bit."""
    keys, first_keys = (
        list(zip(each.frame.tolist(), map(tuple, each.uvd_px.tolist()), strict=True))
        for each in (tracks, first_tracks)
    )
    row_of = {key: row for row, key in enumerate(first_keys)}
    rows = [row for row, key in enumerate(keys) if key in row_of]
    if not rows:
        return 1.0
    after = float(np.median(np.abs(estimate.residuals_px[rows][:, :2])))
    before = float(np.median(np.abs(first.residuals_px[[row_of[keys[row]] for row in rows]][:, :2])))
    return after / max(before, 1e-9)
