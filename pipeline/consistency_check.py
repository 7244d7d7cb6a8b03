"""Whether a second look fits as well as the first: matches made with the motion, or by a second method.

A wrong motion would draw matches that confirm it. It betrays itself: the solver comes to no end, more
observations lie far off, or all of them scatter more. A method whose features follow the light betrays itself
by another motion than the first method's.
"""

import logging

import numpy as np

from polhode.lie import log_so3
from polhode.records import Bools, MotionEstimate, StereoTracks

FAR = 4.5
"""Residuals of so many standard deviations of the estimate without prediction are far off."""
MORE_FAR = 0.03
"""Growth of the share of observations that are far off that is too much."""
MORE_NOISE = 1.08
"""Growth of the scatter of pixels that is too much: joined landmarks of TS38 scatter 4 % more and help, those
of a shaded asteroid 14 % more and harm."""

_log = logging.getLogger(__name__)
SAME_MOTION_DEG = 1.0
"""Attitudes of two methods that see one motion differ by less, in the median: by 0.2 degrees at most on the
scenes of the benchmark, by 7 and 12 where the second method's features followed the light."""


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


def revises(
    second: tuple[StereoTracks, MotionEstimate], first: tuple[StereoTracks, MotionEstimate], measured: Bools
) -> bool:
    """Whether what two methods see tells another motion than the first one's, or fits its places worse.

    measured (F,): the frames that the first method connected. The tracks of both hold the first method's
    observations; those that they share are held to both motions.
    """
    (tracks, estimate), (known, plain) = second, first
    if plain.solver.converged != estimate.solver.converged:
        return plain.solver.converged
    apart_deg = attitudes_apart_deg(estimate, plain, measured)
    noise = estimate.noise.pixel_sigma_px / max(plain.noise.pixel_sigma_px, 1e-9)
    scatter = _scatter_of_shared(tracks, estimate, known, plain)
    _log.info(
        "two methods: attitudes %.3f deg apart; scatter %.2f times the first one's, of its own places %.2f",
        *(apart_deg, noise, scatter),
    )
    return apart_deg > SAME_MOTION_DEG or max(noise, scatter) > MORE_NOISE


def attitudes_apart_deg(a: MotionEstimate, b: MotionEstimate, frames: Bools) -> float:
    """Median angle [deg] between the attitudes of two estimates over the frames (F,), after the one constant
    turn between their body frames that fits best (Kabsch 1976)."""
    R_a, R_b = a.X_NG[frames, :3, :3], b.X_NG[frames, :3, :3]
    U, _, V_T = np.linalg.svd(np.sum(np.swapaxes(R_b, 1, 2) @ R_a, axis=0))
    R_ba = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V_T)]) @ V_T
    apart = log_so3(np.swapaxes(R_b @ R_ba, 1, 2) @ R_a)
    return float(np.rad2deg(np.median(np.linalg.norm(apart, axis=1))))


def _scatter_of_shared(
    tracks: StereoTracks, estimate: MotionEstimate, known: StereoTracks, plain: MotionEstimate
) -> float:
    """Of the observations that both motions have, the median residual in the image, over that of the first; 1
    where they share none."""
    mine, theirs = _shared(tracks, known)
    if len(mine) == 0:
        return 1.0
    after, before = (
        float(np.median(np.abs(r[:, :2]))) for r in (estimate.residuals_px[mine], plain.residuals_px[theirs])
    )
    return after / max(before, 1e-9)


def _shared(a: StereoTracks, b: StereoTracks) -> tuple[list[int], list[int]]:
    """Rows of a and of b that hold the same observation: a frame's feature has one place, to the last bit."""
    place = {
        (frame, *uvd): row
        for row, (frame, uvd) in enumerate(zip(b.frame.tolist(), b.uvd_px.tolist(), strict=True))
    }
    rows = [
        (row, place.get((frame, *uvd)))
        for row, (frame, uvd) in enumerate(zip(a.frame.tolist(), a.uvd_px.tolist(), strict=True))
    ]
    both = [(mine, other) for mine, other in rows if other is not None]
    return [mine for mine, _ in both], [other for _, other in both]
