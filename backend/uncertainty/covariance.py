"""Covariance of all estimates, from the Gauss-Newton information at the solution.

The information is singular, because G and its landmarks may move together: G is fixed at its true first pose.
Quantities that do not depend on this choice (r_N, v_N, the attitude of the principal axes, w_P) get their
absolute covariance: the camera's frame is known, and with G fixed the landmarks carry the uncertainty of the
first pose.

Where errors of observations depend on one another (``DependentErrors``), the inverse of the information is
not the covariance of the solution, which takes them as independent: with S the covariance of the gradient it
is inv(H) S inv(H) (the "sandwich": Huber 1967; White, Econometrica 48, 1980).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotri

from polhode.backend.dynamics.residuals import FrameStates, state_derivatives
from polhode.backend.problem.iterate import (
    ERR_R,
    ERR_THETA,
    ERR_V,
    ERR_W,
    N_CONSTANTS,
    N_STATE,
    POSE,
    POSITION,
    RATE,
    ROTATION,
    VELOCITY,
    Iterate,
)
from polhode.backend.problem.wrench import LN_MASS, LN_SCALE
from polhode.backend.solvers.gauss_newton import GaussNewton, NormalEquations
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.schur import correlated_scores, landmark_covariances, mirror
from polhode.backend.uncertainty.calibration_response import LinearObservations
from polhode.backend.uncertainty.principal_axes import AxesDerivative
from polhode.geometry.lie import Array, Bools, exp_so3, hat, right_jacobian_so3

N_GAUGE = 6


@dataclass(frozen=True)
class DependentErrors:
    """Covariance of the whitened errors of the observations, which the solution takes as independent."""

    variance: Array
    """(M, 3) of what is independent between frames"""
    drift: Array
    """(3, F, F) of u, v and disparity of one landmark in two frames, besides"""
    common: Array
    """(M, 3, c) effects of one sigma of c errors that all observations share, besides"""


@dataclass(frozen=True)
class Marginals:
    """Joint covariance of states and constants, those of the landmarks, information of the constants."""

    dense: Array
    """(s F + 8, s F + 8); zero for the first pose, where the camera's is exact"""
    landmarks: Array
    """(L, 3, 3) [m^2]"""
    constants_information: Array
    """(8, 8) of com_G and xi, everything else eliminated, without prior"""
    wrench_information: Array | None
    """(2, 2) of the logarithms of the inertia's scale and of the mass, everything else eliminated"""
    response: Array
    """(s F, 8) change of the states per change of com_G and xi, everything else fitted again"""
    by_calibration: Array
    """(s F + 8, c) change of states and constants by one sigma of each of c errors of the calibration, whose
    covariance ``dense`` and ``landmarks`` contain"""
    refitted: Array = field(default_factory=lambda: np.zeros((0, 3, 0)))
    """(M, 3, p + c) what the fit leaves of the effects of probes, and of these errors"""


def marginals(
    fit: MotionFit,
    weight: Array,
    errors: DependentErrors | None = None,
    calibration: Array | None = None,
    probes: Array | None = None,
) -> Marginals:
    """Invert the information at a solution; weight (M,) is the information contributed by each observation.

    ``errors``, and the effects ``calibration`` (M, 3, c) of one sigma of errors of the calibration on the
    whitened observations: the solution does not know of them, its covariance does. What the motion determines
    is judged without the calibration. ``probes`` (M, 3, p): effects of which what the fit leaves is sought.
    """
    solver, fixed, x = GaussNewton(fit.data), fit.linearized(), fit.iterate.vector()
    bare = solver.normal_equations(fixed, x, weight, prior=False)
    S, _, C_inv = solver.reduced(bare)
    mirror(S)
    n, n_states, first = len(S), fixed.reference.n_states, N_GAUGE
    follow = _first_pose_follows(fit.iterate, fit.data.camera_N)
    # put the first pose's dependence on the camera's errors into the information
    of_camera = slice(N_STATE, N_STATE + follow.shape[1])
    S[of_camera] += follow.T @ S[:N_GAUGE]
    S[:, of_camera] += S[:, :N_GAUGE] @ follow
    of_states = np.asfortranarray(S[first:n_states, first:n_states])
    factor = cho_factor(of_states, lower=True, overwrite_a=True, check_finite=False)
    response = np.zeros((n_states, n - n_states))
    response[first:] = -cho_solve(factor, S[first:n_states, n_states:], check_finite=False)
    information = S[n_states:, n_states:] + S[n_states:, first:n_states] @ response[first:]
    information = 0.5 * (information + information.T)
    prior = solver.prior_information(fixed, x)
    constants = np.linalg.inv(information + prior)
    dense = np.zeros((n, n))
    dense[first:n_states, first:n_states] = dpotri(factor[0], lower=1, overwrite_c=1)[0]
    mirror(dense[first:n_states, first:n_states])
    dense[first:n_states, first:n_states] += (response[first:] @ constants) @ response[first:].T
    dense[:n_states, n_states:] = response @ constants
    dense[n_states:, :n_states] = dense[:n_states, n_states:].T
    dense[n_states:, n_states:] = constants
    response[:first] = follow @ response[of_camera]
    dense[:first] = follow @ dense[of_camera]
    dense[:, :first] = dense[:, of_camera] @ follow.T
    d, own, of_states = fit.data, C_inv, dense[:, :n_states]
    if errors is not None:
        excess, own = _excess(errors, fit, weight, bare, C_inv)
        dense = dense + of_states @ excess @ of_states.T
        dense = 0.5 * (dense + dense.T)
        excess_of_constants = response.T @ excess @ response
        information = _discounted(information, excess_of_constants, prior)
    marks = landmark_covariances(dense, d.frame, d.start, bare.E, C_inv, own, bare.n_state)
    moved, left = np.zeros((n, 0)), [np.zeros((len(d.frame), 3, 0))]
    if probes is not None:
        left.append(_moved_by_calibration(fit, weight, probes, of_states, C_inv)[2])
    if calibration is not None and calibration.shape[2]:
        moved, of_marks, own_left = _moved_by_calibration(fit, weight, calibration, of_states, C_inv)
        dense, marks = dense + moved @ moved.T, marks + of_marks @ np.swapaxes(of_marks, 1, 2)
        left.append(own_left)
    found = _marginals_of_constants(dense, marks, information, prior, response, moved)
    return replace(found, refitted=np.concatenate(left, axis=2))


def _moved_by_calibration(
    fit: MotionFit, weight: Array, effect: Array, to_all: Array, C_inv: Array
) -> tuple[Array, Array, Array]:
    """Changes (n, c) of states and constants, (L, 3, c) of landmarks, and what is left (M, 3, c) of the
    effects; to_all (n, s F): inverse information."""
    d, at = fit.data, fit.iterate
    seen = LinearObservations(*observation_jacobians(fit), weight, effect, d.frame, d.landmark)
    gradient = np.zeros((at.n_frames, at.n_state, effect.shape[2]))
    gradient[:, POSE] = seen.gradient(seen.landmark_moves(C_inv), at.n_frames)
    moved = -to_all @ gradient.reshape(at.n_states, -1)
    poses = moved[: at.n_states].reshape(at.n_frames, at.n_state, -1)[:, POSE]
    marks = seen.landmark_moves(C_inv, poses)
    return moved, marks, seen.refitted(poses, marks)


def _excess(
    errors: DependentErrors, fit: MotionFit, weight: Array, bare: NormalEquations, C_inv: Array
) -> tuple[Array, Array]:
    """Covariance (s F, s F) of the gradient beyond the information; landmarks' covariances, poses given."""
    d, n_states = fit.data, fit.iterate.n_states
    to_pose, to_landmark = observation_jacobians(fit)
    root = np.sqrt(weight)[:, None, None]
    excess = np.zeros((n_states, n_states))
    own = correlated_scores(
        *(excess, d.frame, d.start, errors.variance, errors.drift),
        *(root * to_pose, root * to_landmark, bare.E, C_inv, bare.n_state),
    )
    mirror(excess)
    # what they share changes the landmarks, the poses given, and the gradient of the poses
    effect = weight[:, None, None] * errors.common
    moved = np.zeros((d.n_landmarks, 3, effect.shape[2]))
    np.add.at(moved, d.landmark, np.swapaxes(to_landmark, 1, 2) @ effect)
    moved = C_inv @ moved
    effect -= weight[:, None, None] * (to_landmark @ moved[d.landmark])
    gradient = np.zeros((fit.iterate.n_frames, bare.n_state, effect.shape[2]))
    np.add.at(gradient[:, :N_GAUGE], d.frame, np.swapaxes(to_pose, 1, 2) @ effect)
    of_states = gradient.reshape(n_states, -1)
    return excess + of_states @ of_states.T, own + moved @ np.swapaxes(moved, 1, 2)


def _discounted(information: Array, excess: Array, prior: Array) -> Array:
    """Information whose inverse is the sandwich covariance; ``prior`` keeps what is undetermined regular."""
    spread = information + excess
    scale = 1.0 / np.sqrt(np.diag(spread) + np.diag(prior) + 1e-300)
    regular = spread * np.outer(scale, scale) + 1e-12 * np.eye(len(spread))
    half = scale[:, None] * information
    out = half.T @ np.linalg.solve(regular, half)
    return np.asarray(0.5 * (out + out.T))


def observation_jacobians(fit: MotionFit) -> tuple[Array, Array]:
    """Derivatives of the whitened residuals in the pose (M, 3, 6) and in the landmark (M, 3, 3)."""
    d, at = fit.data, fit.iterate
    A, k = d.R_RN @ at.R_NG, d.frame
    to_point = -d.point_jacobians(A, at.p_NG, at.p_G)
    to_landmark = to_point @ A[k]
    turned = -to_landmark @ hat(at.p_G[d.landmark])
    return np.concatenate([to_point @ d.R_RN[k], turned], axis=2), to_landmark


def _marginals_of_constants(
    dense: Array, marks: Array, information: Array, prior: Array, response: Array, moved: Array
) -> Marginals:
    """Information on com_G and xi, and on mass and scale, each with all other constants eliminated."""
    if len(information) == N_CONSTANTS:
        return Marginals(dense, marks, information, None, response, moved)
    at = np.arange(len(information))
    body, rest = at[:N_CONSTANTS], at[N_CONSTANTS:]
    # with the weak prior of the others: what the wrench does not excite must not make the matrix singular
    follow = -np.linalg.solve((information + prior)[np.ix_(rest, rest)], information[np.ix_(rest, body)])
    of_body = information[np.ix_(body, body)] + information[np.ix_(body, rest)] @ follow
    logs = N_CONSTANTS + np.array([LN_SCALE, LN_MASS])
    others = np.setdiff1d(at, logs)
    follow_logs = np.linalg.solve(
        (information + prior)[np.ix_(others, others)], information[np.ix_(others, logs)]
    )
    of_logs = information[np.ix_(logs, logs)] - information[np.ix_(logs, others)] @ follow_logs
    response = response[:, body] + response[:, rest] @ follow
    return Marginals(dense, marks, 0.5 * (of_body + of_body.T), of_logs, response, moved)


def _first_pose_follows(iterate: Iterate, camera_N: Array) -> Array:
    """Derivative of the first pose (6) in the errors (0 or 6) of the camera's pose, the true one fixed."""
    if iterate.camera is None:
        return np.zeros((N_GAUGE, 0))
    alpha = iterate.camera[0, ROTATION]
    turn, left = exp_so3(alpha), right_jacobian_so3(-alpha)
    arm = turn @ (iterate.p_NG[0] - camera_N[0])
    out = np.zeros((N_GAUGE, N_GAUGE))
    out[POSITION, POSITION], out[POSITION, ROTATION] = -turn.T, turn.T @ hat(arm) @ left
    out[ROTATION, ROTATION] = -(turn @ iterate.R_NG[0]).T @ left
    return out


def body_jacobians(iterate: Iterate, camera_N: Array | None = None) -> Array:
    """Derivative (F, 12, s + 8) of r_N, v_N, theta in R_NG Exp(theta), w_G of each frame, true poses.

    In the s unknowns of the frame and in (com_G, xi). camera_N (F, 3), see MotionData, is needed when s = 18.
    The principal axes are not involved, so the covariance of these states stays finite where the axes are
    undetermined; the prior bounds it.
    """
    n, s = iterate.n_frames, iterate.n_state
    states = FrameStates.of(iterate, np.zeros((n, 3)) if camera_N is None else camera_N)
    out = np.zeros((n, 12, s + N_CONSTANTS))
    out[:, ERR_R, :s], out[:, ERR_THETA, :s] = state_derivatives(states)
    out[:, ERR_R, s : s + 3] = states.true_attitudes()
    out[:, ERR_V, VELOCITY] = out[:, ERR_W, RATE] = np.eye(3)
    return out


def state_jacobians(iterate: Iterate, derivative: AxesDerivative, camera_N: Array | None = None) -> Array:
    """As above (F, 12, s + 8), for r_N, v_N, theta_P, w_P: attitude and rate of the principal axes."""
    out, R_GP, s = body_jacobians(iterate, camera_N), derivative.R_GP, iterate.n_state
    # R_NG Exp(theta_G) R_GP Exp(theta_GP), and w_P = (R_GP Exp(theta_GP))^T w_G
    out[:, ERR_THETA], out[:, ERR_W] = R_GP.T @ out[:, ERR_THETA], R_GP.T @ out[:, ERR_W]
    out[:, ERR_THETA, s + 3 :] += derivative.axes
    out[:, ERR_W, s + 3 :] += hat(iterate.w_G @ R_GP) @ derivative.axes
    return out


def mark_jacobians(iterate: Iterate, R_GP: Array, camera_N: Array | None = None) -> Array:
    """As above (F, 12, s + 8), for marks on the body where the centre of mass and the axes are estimated.

    An error of the centre of mass does not move such a mark, but it changes the velocity that the mark has.
    R_GP (3, 3): the estimated axes, along which attitude and rate are.
    """
    out, s = body_jacobians(iterate, camera_N), iterate.n_state
    by_centre = out[:, ERR_R, s : s + 3].copy()
    out[:, ERR_R, s : s + 3] = 0.0
    out[:, ERR_V, s : s + 3] = -by_centre @ hat(iterate.w_G)
    out[:, ERR_THETA], out[:, ERR_W] = R_GP.T @ out[:, ERR_THETA], R_GP.T @ out[:, ERR_W]
    return out


def state_covariances(iterate: Iterate, m: Marginals, jacobians: Array) -> tuple[Array, Array]:
    """Covariances (F, 12, 12) of the states, and the last one jointly with xi and com_G (20, 20).

    jacobians (F, 12, s + 8) of the states in their own unknowns and the constants.
    """
    s, n = iterate.n_state, iterate.n_states
    out = np.zeros((iterate.n_frames, 12, 12))
    for k, T in enumerate(jacobians):
        at = np.r_[s * k : s * k + s, n : n + N_CONSTANTS]
        out[k] = T @ m.dense[np.ix_(at, at)] @ T.T
    return out, with_constants(T, m.dense[np.ix_(at, at)])


def with_constants(T: Array, joint: Array) -> Array:
    """(20, 20) of a state T (12, s + 8), then xi and com_G; joint (s + 8, s + 8) of its unknowns."""
    T = and_constants(T)
    return np.asarray(T @ joint @ T.T)


def and_constants(T: Array) -> Array:
    """Derivative (20, s + 8) of a state T (12, s + 8), then of xi and com_G."""
    s = T.shape[1] - N_CONSTANTS
    return np.vstack([T, np.eye(s + N_CONSTANTS)[np.r_[s + 3 : s + 8, s : s + 3]]])


def pose_covariances(iterate: Iterate, m: Marginals) -> Array:
    """Covariances (F, 6, 6) of X_NG, shift [m] and turn [rad] along G's axes: X_NG (Exp(turn) p_G + shift).

    A shift that all poses share moves the frame G and is not an error of the poses: it is removed, with the
    same weight for each frame. So are errors of the calibration, which the depth that is put there shares.
    """
    dense = m.dense - m.by_calibration @ m.by_calibration.T
    n, s = iterate.n_frames, iterate.n_state
    turned = np.zeros((n, 6, 6))
    turned[:, POSITION, POSITION], turned[:, ROTATION, ROTATION] = np.swapaxes(iterate.R_NG, 1, 2), np.eye(3)
    to_mean = np.zeros((len(dense), 6))
    for k, T in enumerate(turned):
        to_mean[s * k : s * k + 6] = T.T / n
    against_mean = dense @ to_mean
    mean = to_mean.T @ against_mean
    out = np.empty((n, 6, 6))
    for k, T in enumerate(turned):
        at = slice(s * k, s * k + 6)
        shared = T @ against_mean[at]
        out[k] = T @ dense[at, at] @ T.T - shared - shared.T + mean
    return out


def with_infinite(covariance: Array, lost: Bools) -> Array:
    """The covariance (n, n) with the components ``lost`` (n,) unknown: rows and columns 0, variances inf."""
    out = covariance.copy()
    out[lost, :] = 0.0
    out[:, lost] = 0.0
    out[lost, lost] = np.inf
    return out
