"""Noise levels as the window estimates them: of the pixels, and of the disturbances.

The standard deviations of the pixels follow from the residuals of the active frames (as in
``outliers_and_noise/outliers.py``). The level of the disturbances maximizes the evidence of
``outliers_and_noise/process_level.py`` on the history alone; the landmarks are eliminated there, and their
part of the evidence does not depend on the level.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from polhode.backend.outliers_and_noise.outliers import MAX_TAKEN_BY_POSES, MIN_OBSERVATIONS, scales_by_median
from polhode.backend.outliers_and_noise.process_level import (
    ACCELERATION,
    CEILING_PSD,
    FLOOR_PSD,
    INDIFFERENT,
    TORQUE,
    climb,
    walk,
)
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.history import History
from polhode.backend.window.problem import NewtonSolver, WindowProblem
from polhode.backend.window.vision import WindowObservations, poses_of, residuals
from polhode.camera import stereo_jacobian
from polhode.lie import Array

ITERATIONS = 3
DECADE = 0.5
"""Finest step of the search: finer than the data can resolve."""
STARTS = (0, -4, -8)
"""In these steps below the stated levels: too high a level can hide in wrong constants and so remain high."""
Grid = tuple[int, int]
"""Levels of acceleration and torque in steps from the stated ones."""


def estimate_levels(state: EstimatorState, history: History, stated: tuple[float, float]) -> None:
    """Set the most likely accel_psd and torque_psd, starting from those stated."""
    vision = history.vision(state.active, state.condensed(state.observations())).quadratic
    x = history.vector(state.active.constants)

    def minus_log_evidence(at: Grid) -> float:
        levels = [value * 10.0 ** (DECADE * n) for value, n in zip(stated, at, strict=True)]
        if min(levels) < FLOOR_PSD or max(levels) > CEILING_PSD:
            return np.inf
        noise = replace(state.disturbances, accel_psd=levels[0], torque_psd=levels[1])
        factors = history.factors(x, state.J_G, state.J_noise, noise)
        problem = WindowProblem(vision, history.R_ref, factors, state.weak_prior, state.prior)
        try:
            solution = NewtonSolver().solve(problem, x, ITERATIONS)
            factor = cholesky(problem.normal_equations(solution.x)[1], lower=True, check_finite=False)
        except LinAlgError:
            return np.inf
        return solution.cost + factors.half_log_det + float(np.log(np.diagonal(factor)).sum())

    best = most_likely(minus_log_evidence)
    accel_psd, torque_psd = (value * 10.0 ** (DECADE * n) for value, n in zip(stated, best, strict=True))
    state.disturbances = replace(state.disturbances, accel_psd=accel_psd, torque_psd=torque_psd)


def most_likely(minus_log_evidence: Callable[[Grid], float]) -> Grid:
    """The largest levels, up to the stated ones, that are nearly as likely as the best."""
    known: dict[Grid, float] = {}

    def cost(at: Grid) -> float:
        if at not in known:
            known[at] = minus_log_evidence(at)
        return known[at]

    best = min(((n, n) for n in STARTS), key=cost)
    for step in (2, 1):
        for axis in (TORQUE, ACCELERATION):
            best = walk(best, partial(_moved, axis=axis, step=step), cost)
    limit = cost(best) + INDIFFERENT
    for axis in (TORQUE, ACCELERATION):
        best = climb(best, partial(_raised, axis=axis), cost, limit)
    return best


def _moved(at: Grid, sign: int, axis: int, step: int) -> Grid:
    change = sign * step
    return (at[0] + change, at[1]) if axis == ACCELERATION else (at[0], at[1] + change)


def _raised(at: Grid, axis: int) -> Grid | None:
    return _moved(at, 1, axis, 1) if at[axis] < 0 else None


def estimate_noise(state: EstimatorState) -> None:
    """Rescale the standard deviations of u, v and of the disparity by the median absolute residual."""
    observations = state.observations()
    if len(observations.frame) < MIN_OBSERVATIONS:
        return
    p_G = state.landmarks.p_G[observations.slot]
    r = residuals(observations, poses_of(state.active.frames), state.rig_vector, p_G)
    free = np.maximum(1.0 - taken_by_fit(state, observations, p_G), 0.05)
    factors = scales_by_median(r, free).factors
    state.noise = state.noise * factors
    for frame in state.active.frames:
        frame.inv_sigma = frame.inv_sigma / factors


def taken_by_fit(state: EstimatorState, observations: WindowObservations, p_G: Array) -> Array:
    """Share (M, 3) of the freedom of each residual that is used by landmarks and poses."""
    frames = state.active.frames
    poses = poses_of(frames)
    A, k = poses.A[observations.frame], observations.frame
    p_R = (
        np.einsum("mij,mj->mi", A, p_G[observations.landmark])
        + (np.einsum("fij,fj->fi", poses.R_RN, poses.p_NG) + poses.t_R)[k]
    )
    D = stereo_jacobian(p_R, state.rig.focal_px, state.rig.baseline_m)
    J = observations.inv_sigma[:, :, None] * (D @ A)
    information = np.add.reduceat(np.swapaxes(J, 1, 2) @ J, observations.start[:-1], axis=0)
    taken = np.einsum("mij,mjk,mik->mi", J, np.linalg.inv(information)[observations.landmark], J)
    # the poses are fitted to u and v: six unknowns for the two numbers of each observation
    taken[:, :2] += min(3.0 * len(frames) / len(k), MAX_TAKEN_BY_POSES)
    return np.asarray(taken)
