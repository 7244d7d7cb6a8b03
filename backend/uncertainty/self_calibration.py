"""What the data say of the calibration's errors, everything else fitted to them again.

To first order the residuals are r = E z + e, with the effects E of errors z that have a unit normal prior.
With states and landmarks eliminated, the score is s = A z + n with the information A = E^T W E', E' what the
fit leaves of the effects. The noise n has covariance A where the errors of the observations are independent;
what they have in common is added (B), as for the states (``covariance.py``), so that dependent errors do not
count as many independent ones. The posterior then has the information I + A B^-1 A and the mean
(I + A B^-1 A)^-1 A B^-1 s. In its eigenvectors the errors are independent before and after: those that the
data determine are estimated, the others stay considered.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.calibration_response import seen_points
from polhode.backend.uncertainty.covariance import DependentErrors
from polhode.geometry.lie import Array
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.estimate import CalibrationScore, EstimatedError

MAX_SHARE = 0.5
"""Of the prior's standard deviation: an error with a smaller posterior one is estimated. The gain of the
others is less than half of what they contribute, and the residuals' correlation is known no better."""
UNMODELLED_SHARE = 5e-4 / 0.12
"""Of the focal length, by each pixel that features slide with the light (``backend.light_px``): they pretend
as much on bodies that turn by less than one revolution, 5e-4 with 0.12 px"""
NAMED = 0.5
"""Correlation from which on a parameter is named with an estimated error."""


def stretches(fit: MotionFit) -> Array:
    """Effects (M, 3, 2) on the whitened observations: of a focal length that is longer by its own size, and
    of disparities that are a pixel larger."""
    p_R, (focal_px, _, _, baseline_m, _) = seen_points(fit)[2], fit.data.rig
    longer = focal_px * np.column_stack([p_R[:, :2], np.full(len(p_R), baseline_m)]) / p_R[:, 2:]
    offset = np.broadcast_to(np.array([0.0, 0.0, 1.0]), longer.shape)
    return np.asarray(fit.data.inv_sigma[:, :, None] * np.stack([longer, offset], axis=2))


def unmodelled_errors(
    data: MotionData, longer: Array, offset_px: tuple[float, float, float], light_px: float
) -> Array:
    """Effects (M, 3, 10) of errors that are not the calibration's: of matching, and what light pretends.

    What matching shifts in all frames by offset_px may as well grow across the image, as much again within
    the scatter of the features. ``longer`` from ``stretches``.
    """
    off = data.uvd_px[:, :2] - data.uvd_px[:, :2].mean(axis=0)
    across = np.column_stack([np.ones(len(off)), off / np.maximum(off.std(axis=0), 1e-9)])
    offsets = (data.inv_sigma * offset_px)[:, :, None, None] * np.eye(3)[:, :, None] * across[:, None, None]
    pretended = UNMODELLED_SHARE * light_px * longer[:, :, :1]
    return np.concatenate([offsets.reshape(len(off), 3, 9), pretended], axis=2)


def score_of(
    fit: MotionFit,
    pull: Array,
    information: Array,
    effects: tuple[Array, Array],
    errors: DependentErrors | None,
    common: Array,
) -> CalibrationScore:
    """The score of n errors at a solution.

    pull (M, 3): whitened residuals, measured minus predicted, times a weight, so that their slope and their
    variance are the ``information`` (M,). effects: (M, 3, n) on the whitened observations, and what the fit
    leaves of them. common (M, 3, k): effects of one sigma of errors that all observations share, besides
    those of ``errors``.
    """
    whole, left = effects
    A = np.einsum("m,mai,maj->ij", information, whole, left, optimize=True)
    A = 0.5 * (A + A.T)
    if errors is not None:
        common = np.concatenate([common, errors.common], axis=2)
    shared = np.einsum("m,mai,mak->ik", information, left, common, optimize=True)
    noise = A + shared @ shared.T
    if errors is not None:
        noise += _excess(fit, np.sqrt(information)[:, None, None] * left, errors)
    return CalibrationScore(A, np.einsum("mai,ma->i", whole, pull, optimize=True), noise)


def _excess(fit: MotionFit, left: Array, errors: DependentErrors) -> Array:
    """Covariance (n, n) of the score beyond that of independent errors; left (M, 3, n)."""
    frame, start = fit.data.frame, fit.data.start
    out = np.einsum("mai,ma,maj->ij", left, errors.variance - 1.0, left, optimize=True)
    if not errors.drift.any():
        return np.asarray(out)
    for first, end in pairwise(start.tolist()):
        seen = frame[first:end]
        own = np.swapaxes(left[first:end], 0, 1)
        out += np.sum(np.swapaxes(own, 1, 2) @ errors.drift[:, seen[:, None], seen] @ own, axis=0)
    return np.asarray(out)


@dataclass(frozen=True)
class DeterminedErrors:
    """Errors of the calibration that the data determine."""

    mean: Array
    """(c,) of the unit errors"""
    factor: Array
    """(c, c) with factor factor^T their covariance, the undetermined ones as before"""
    errors: tuple[EstimatedError, ...]


def determined_errors(found: CalibrationScore, effects: CalibrationEffects) -> DeterminedErrors | None:
    """Those whose standard deviation the data reduce below MAX_SHARE of the prior's; None: there are none.

    The clock of the right camera stays considered: what it does depends on the motion. It is noise to the
    others.
    """
    A, s, B = found.of_prior()
    later = effects.right_later_s
    others = np.eye(len(A))
    if later.any():
        clock = later / np.linalg.norm(later)
        others -= np.outer(clock, clock)
        B = B + np.outer(A @ clock, A @ clock)
    A = others @ A @ others
    gain = A @ np.linalg.pinv(others @ B @ others, rcond=1e-10, hermitian=True)
    values, vectors = np.linalg.eigh(gain @ A)
    sigma = 1.0 / np.sqrt(1.0 + np.maximum(values, 0.0))
    known = sigma < MAX_SHARE
    if not known.any():
        return None
    at = vectors.T @ (gain @ s) * sigma**2
    factor = vectors * np.where(known, sigma, 1.0)
    errors = [_described(effects, vectors[:, n], at[n], sigma[n]) for n in np.flatnonzero(known)]
    return DeterminedErrors(vectors[:, known] @ at[known], factor, tuple(errors[::-1]))


def _described(effects: CalibrationEffects, along: Array, value: float, sigma: float) -> EstimatedError:
    moves = effects.factor @ along
    alike = moves / np.maximum(np.linalg.norm(effects.factor, axis=1), 1e-300)
    named = [n for n in np.argsort(-np.abs(alike), kind="stable") if abs(alike[n]) > NAMED]
    # the sign of an eigenvector is free
    turn = -1.0 if named and moves[named[0]] < 0.0 else 1.0
    return EstimatedError(
        parameters={effects.names[n]: float(value * moves[n]) for n in named},
        value=turn * float(value),
        sigma=float(sigma),
    )
