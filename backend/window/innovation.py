"""Whether a new frame continues the motion: its pose, as its observations have it, against the prediction.

Both are compared before the dynamics connect them, so that what they have in common, such as errors of the
map, cancels: state before, new pose and constants have a joint covariance Sigma without the step between. Of
a step of some length the whitened residual of the pose, six numbers, has the covariance ``D Sigma D^T + I``
(Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 5.4).

A wrong stamp moves the prediction along the motion, one direction of six; a push may move it anywhere. So the
first leaves a residual within its covariance at one length of the step, the second, as a rule, at none.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from polhode.backend.dynamics.residuals import Steps, add_steps
from polhode.backend.problem.iterate import N_CONSTANTS, N_POSE, N_STATE, RATE
from polhode.backend.window.add_frame import MIN_COMMON_LANDMARKS, MIN_FRAMES_FOR_DYNAMICS
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.problem import Quadratic, add_block, eliminate, step_jacobians, whitened_steps
from polhode.backend.window.solve import window_quadratic
from polhode.geometry.lie import Array

LONGEST_S = 15.0
"""Length of a step up to which others than by the stamps are searched for."""
SEARCH_RAD, MOST_TRIED = 0.15, 400
"""Rotation between the lengths that are tried, over which the residual is nearly linear; number of them."""
_POSE_ROWS = np.r_[0:3, 6:9]
"""Position and attitude in the residual of a step; its whitening keeps them apart from the velocities."""
_COLUMNS = np.r_[0 : N_STATE + N_POSE, 2 * N_STATE : 2 * N_STATE + N_CONSTANTS]
"""State before, pose after, constants among the variables of a step."""


class StepFit(NamedTuple):
    """How well a new pose fits a step of some length."""

    length_s: float
    squared: float
    """Innovation over its covariance, squared: chi-squared with six degrees of freedom"""
    longer_s: float
    """By how much a longer step would fit better, to first order"""
    sigma_s: float
    """Its standard deviation"""
    off: Array
    """(2,) of the position [m] and of the attitude [rad]"""


@dataclass(frozen=True)
class NewPose:
    """The state before and the pose of the newest frame, not yet connected by dynamics."""

    state: EstimatorState
    x: Array
    """(32,) state before, state of the new frame (its velocities mean nothing), constants"""
    covariance: Array
    """(26, 26) of the state before, the new pose, the constants"""

    def fits(self, lengths_s: Array) -> list[StepFit]:
        """Of steps of other lengths (n,), above 0."""
        state, w_G = self.state, np.repeat(self.x[None, RATE], len(lengths_s), axis=0)
        steps = whitened_steps(w_G, state.J_G, state.J_noise, lengths_s, state.disturbances)
        return [self._fit(steps.part(slice(n, n + 1))) for n in range(len(lengths_s))]

    def _fit(self, step: Steps) -> StepFit:
        state, length_s = self.state, float(step.dt_s[0])
        R_ref, h = np.stack([frame.R_ref for frame in state.active.recent[-2:]]), 1e-4 * length_s
        r, D = step_jacobians(self.x, R_ref, step, state.prior.form, state.R_inertia)
        longer = replace(step, dt_s=step.dt_s + h)
        slope = step_jacobians(self.x, R_ref, longer, state.prior.form, state.R_inertia)[0] - r
        r, slope, D = r[0, _POSE_ROWS], slope[0, _POSE_ROWS] / h, D[0][_POSE_ROWS][:, _COLUMNS]
        by = np.linalg.solve(D @ self.covariance @ D.T + np.eye(N_POSE), np.stack([r, slope], axis=1))
        off = r[:3] / step.W_t[0, 0, 0], np.linalg.solve(step.W_r[0, :3, :3], r[3:])
        known = float(slope @ by[:, 1])
        longer_s = -float(slope @ by[:, 0]) / known
        return StepFit(length_s, float(r @ by[:, 0]), longer_s, known**-0.5, np.linalg.norm(off, axis=1))

    def best(self, length_s: float) -> list[StepFit]:
        """The local minima of the squared innovation over the length of the step.

        length_s: by the stamps.
        """
        longest = max(1.2 * length_s, LONGEST_S)
        spacing = max(SEARCH_RAD / max(float(np.linalg.norm(self.x[RATE])), 1e-3), longest / MOST_TRIED)
        tried = self.fits(spacing * np.append(0.1, np.arange(1, longest / spacing)))
        squared = np.array([np.inf, *(fit.squared for fit in tried), np.inf])
        found = dict[int, StepFit]()
        for n in np.flatnonzero((squared[1:-1] <= squared[:-2]) & (squared[1:-1] <= squared[2:])):
            fit = tried[n]
            for _ in range(5):
                fit = self.fits(np.array([max(fit.length_s + fit.longer_s, 0.2 * fit.length_s)]))[0]
            if fit.length_s <= longest:
                # starts that lead to the same length are one
                found.setdefault(round(fit.length_s / spacing), fit)
        return list(found.values())


def new_pose(state: EstimatorState) -> NewPose | None:
    """Of the newest frame of the window, whose step is not yet part of it; None: too little is known.

    Raises LinAlgError: what is known is singular.
    """
    active, history = state.active, state.history
    n_frames = len(active.frames if history is None else history.frames)
    n_common = int(np.sum(state.landmarks.views[active.recent[-1].slot] >= 2))
    if n_frames <= MIN_FRAMES_FOR_DYNAMICS or n_common < MIN_COMMON_LANDMARKS:
        return None
    condensed = state.condensed()
    if history is None:
        left = window_quadratic(active, condensed)
        R_ref, steps = active.R_ref, active.steps
        vision = Quadratic(left.H, left.g, active.vector()[active.n_seen :])
    else:
        vision, R_ref = history.vision(active, condensed).quadratic, history.R_ref
        steps = history.steps_at(vision.x0, state.J_G, state.J_noise, state.disturbances).part(slice(-1))
    H, g, x, end = vision.H, vision.g, vision.x0, N_STATE * len(R_ref)
    old, before = np.r_[0 : end - N_STATE, end : end + N_CONSTANTS], end - 2 * N_STATE
    r, D = step_jacobians(x[old], R_ref[:-1], steps, state.prior.form, state.R_inertia)
    of_steps, slope = np.zeros((len(old), len(old))), np.zeros(len(old))
    add_steps(of_steps, slope, r, D, N_STATE)
    add_block(H, old, of_steps)
    g[old] += slope
    _, gradient, hessian = state.prior(x[-N_CONSTANTS:], state.weak_prior)
    H[-N_CONSTANTS:, -N_CONSTANTS:] += hessian
    g[-N_CONSTANTS:] += gradient
    kept = np.r_[before : end - N_POSE, end : end + N_CONSTANTS]
    joint = eliminate(H, g, np.arange(before), kept)
    covariance, x = np.asarray(np.linalg.inv(joint.H)), x[before:].copy()
    x[_COLUMNS] -= covariance @ joint.g
    return NewPose(state, x, covariance)
