"""Noise levels as the window estimates them: of the pixels, and of the disturbances.

The standard deviations of the pixels follow from the residuals of the active frames (as in
``outliers_and_noise/noise_and_outliers.py``). The level of the disturbances maximizes the evidence of
``outliers_and_noise/process_level.py`` on the history alone; the landmarks are eliminated there, and their
part of the evidence does not depend on the level.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from polhode.backend.outliers_and_noise.noise_and_outliers import (
    MAX_SHARE_OF_POSES,
    MIN_OBSERVATIONS,
    scales_by_median,
)
from polhode.backend.outliers_and_noise.process_level import (
    ACCELERATION,
    CEILING_PSD,
    FLOOR_PSD,
    INSIGNIFICANT_EVIDENCE,
    TORQUE,
    raise_level,
    walk,
)
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.frame import FramePoses, WindowObservations, residuals
from polhode.backend.window.history import History
from polhode.backend.window.problem import DisturbanceLevels, solve_newton
from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array

Grid = tuple[int, int]
"""Levels of acceleration and torque in half decades from the stated ones: finer than the data can resolve."""


def estimate_levels(state: EstimatorState, history: History, stated: tuple[float, float]) -> None:
    """Set the most likely accel_psd and torque_psd, starting from those stated."""
    vision = history.vision(state.active, state.condensed()).quadratic
    x = history.vector(state.active.constants)

    def levels(at: Grid) -> DisturbanceLevels:
        return DisturbanceLevels(*(value * 10.0 ** (0.5 * n) for value, n in zip(stated, at, strict=True)))

    def minus_log_evidence(at: Grid) -> float:
        noise = levels(at)
        if min(noise) < FLOOR_PSD or max(noise) > CEILING_PSD:
            return np.inf
        steps = history.steps_at(x, state.J_G, state.J_noise, noise)
        problem = state.problem(vision, history.R_ref, steps)
        try:
            solution = solve_newton(problem, x, 3)
            factor = cholesky(problem.normal_equations(solution.x)[1], lower=True, check_finite=False)
        except LinAlgError:
            return np.inf
        return solution.cost + steps.half_log_det + float(np.log(np.diagonal(factor)).sum())

    state.disturbances = levels(most_likely(minus_log_evidence))


def most_likely(minus_log_evidence: Callable[[Grid], float]) -> Grid:
    """The largest levels, up to the stated ones, that are nearly as likely as the best."""
    known: dict[Grid, float] = {}

    def cost(at: Grid) -> float:
        if at not in known:
            known[at] = minus_log_evidence(at)
        return known[at]

    def moved(at: Grid, axis: int, change: int) -> Grid:
        return (at[0] + change, at[1]) if axis == ACCELERATION else (at[0], at[1] + change)

    # too high a level can hide in wrong constants and so remain high: lower ones are tried first
    best = min(((n, n) for n in (0, -4, -8)), key=cost)
    for step in (2, 1):
        for axis in (TORQUE, ACCELERATION):

            def neighbour(at: Grid, sign: int, axis: int = axis, step: int = step) -> Grid:
                return moved(at, axis, sign * step)

            best = walk(best, neighbour, cost)
    limit = cost(best) + INSIGNIFICANT_EVIDENCE
    for axis in (TORQUE, ACCELERATION):

        def raised(at: Grid, axis: int = axis) -> Grid | None:
            return moved(at, axis, 1) if at[axis] < 0 else None

        best = raise_level(best, raised, cost, limit)
    return best


def estimate_noise(state: EstimatorState) -> None:
    """Rescale the standard deviations of u, v and of the disparity by the median absolute residual."""
    observations = state.observations()
    if len(observations.frame) < MIN_OBSERVATIONS:
        return
    p_G = state.landmarks.p_G[observations.slot]
    r = residuals(observations, FramePoses(state.active.frames), state.model.rig, p_G)
    free = np.maximum(1.0 - freedom_of_fit(state, observations, p_G), 0.05)
    factors = scales_by_median(r, free).factors
    state.noise = state.noise * factors
    for frame in state.active.frames:
        frame.inv_sigma = frame.inv_sigma / factors


def freedom_of_fit(state: EstimatorState, observations: WindowObservations, p_G: Array) -> Array:
    """Share (M, 3) of the freedom of each residual that is used by landmarks and poses."""
    frames = state.active.frames
    poses = FramePoses(frames)
    A, k = poses.A[observations.frame], observations.frame
    p_R = (
        np.einsum("mij,mj->mi", A, p_G[observations.landmark])
        + (np.einsum("fij,fj->fi", poses.R_RN, poses.p_NG) + poses.t_R)[k]
    )
    D = stereo_jacobian(p_R, state.rig.focal_px, state.rig.baseline_m)
    J = observations.inv_sigma[:, :, None] * (D @ A)
    information = np.add.reduceat(np.swapaxes(J, 1, 2) @ J, observations.start[:-1], axis=0)
    used = np.einsum("mij,mjk,mik->mi", J, np.linalg.inv(information)[observations.landmark], J)
    # the poses are fitted to u and v: six unknowns for the two numbers of each observation
    used[:, :2] += min(3.0 * len(frames) / len(k), MAX_SHARE_OF_POSES)
    return np.asarray(used)
