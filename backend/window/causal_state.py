"""The causal state after each frame, with its covariance and what of it is determined."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky

from polhode.backend.problem.inertia import InertiaForm, inertia_derivative
from polhode.backend.problem.iterate import COM, N_CONSTANTS, N_STATE, POSITION, RATE, VELOCITY, XI, Iterate
from polhode.backend.uncertainty.covariance import (
    body_jacobians,
    state_jacobians,
    with_constants,
    with_infinite,
)
from polhode.backend.uncertainty.identifiability import analyse, undetermined_states
from polhode.backend.uncertainty.principal_axes import axes_derivative, free_axis_covariance
from polhode.backend.window.frame import Frame
from polhode.geometry.lie import Array, Bools, make_pose
from polhode.geometry.rigid_body import nearest_half_turn

N_JOINT = N_STATE + N_CONSTANTS
APART_SIGMAS = 5.0
"""Difference of two moments from which their axes are claimed: the inertia about which the first frames are
linearized may be several sigmas off."""


@dataclass(frozen=True)
class OnlineState:
    """The causal estimate at one frame; ``MotionEstimate`` explains the quantities."""

    timestamp_ns: int
    r_N: Array
    v_N: Array
    R_NP: Array
    w_P: Array
    covariance: Array
    """(12, 12) r, v, theta, w; inf on the diagonal where undetermined"""
    X_NG: Array
    k: Array
    """(2,) k1, k2"""
    cov_k: Array
    """(2, 2)"""
    com_G: Array
    cov_com_G: Array
    """(3, 3)"""
    R_GP: Array
    cov_R_GP: Array
    """(3, 3) of the axes, along P [rad^2]"""
    xi: Array
    """(5,) inertia in the solver's parameters"""
    cov_J: Array
    """(5, 5)"""
    determined: Bools
    """(4,) k1, k2, com, axes"""
    frame: int = 0
    """Number of the frame G, which begins again when the motion is lost"""


@dataclass(frozen=True)
class LastInformation:
    """Information (20, 20) on the last state and the constants, everything else eliminated."""

    joint: Array
    weak_prior: Array
    """(8, 8) part of it that is the weak prior on com_G and xi"""


@dataclass(frozen=True)
class BodyState:
    """The body itself at the latest frame: nothing is expressed in the principal axes, all is finite."""

    r_N: Array
    v_N: Array
    R_NG: Array
    w_G: Array
    com_G: Array
    J_G: Array
    """(3, 3) in the scale of the parameters"""
    J_jacobian: Array
    """(5, 3, 3) derivative of J_G by the five parameters"""
    covariance: Array
    """(20, 20): r_N, v_N, theta in R_NG Exp(theta), w_G, the five parameters, com_G"""
    accel_psd: float
    torque_psd: float
    """Levels of the disturbances by which the window weights the dynamics"""
    past_s: Array
    """(H,) instants < 0 of the other frames that are kept, descending"""
    past_R_NG: Array
    """(H, 3, 3) attitudes there"""


def body_state(
    at: Iterate,
    form: InertiaForm,
    information: LastInformation,
    levels: tuple[float, float],
    past: tuple[Array, Array],
) -> BodyState:
    """The last state (``iterate_of_frame``) jointly with the constants; levels and past as above."""
    covariance = with_constants(body_jacobians(at)[0], np.asarray(np.linalg.inv(information.joint)))
    R_NG, J_jacobian = at.R_NG[0], inertia_derivative(form, at.xi, at.R_inertia)
    return BodyState(
        r_N=at.p_NG[0] + R_NG @ at.com_G,
        v_N=at.v_N[0].copy(),
        R_NG=R_NG.copy(),
        w_G=at.w_G[0].copy(),
        com_G=at.com_G.copy(),
        J_G=at.J_G(form),
        J_jacobian=J_jacobian,
        covariance=0.5 * (covariance + covariance.T),
        accel_psd=levels[0],
        torque_psd=levels[1],
        past_s=past[0],
        past_R_NG=past[1],
    )


def last_information(H: Array, weak_prior: Array) -> LastInformation:
    """From the Hessian of the window's program, whose last 20 entries they are."""
    try:
        L = cholesky(H, lower=True, check_finite=False)
    except LinAlgError:
        # the axes of equal moments have no information: a share is added, negligible beside that on others
        L = cholesky(H + 1e-7 * np.diag(np.diagonal(H)), lower=True, check_finite=False)
    L = L[-N_JOINT:, -N_JOINT:]
    return LastInformation(L @ L.T, weak_prior)


def iterate_of_frame(frame: Frame, constants: Array, R_inertia: Array) -> Iterate:
    """The true state of one frame and the constants (8,), without landmarks."""
    x = frame.x[None]
    states = x[:, POSITION], frame.R_NG[None], x[:, VELOCITY], x[:, RATE]
    return Iterate(*states, constants[COM], constants[XI], R_inertia, np.zeros((0, 3)))


def online_state(
    timestamp_ns: int,
    at: Iterate,
    X_NG_seen: Array,
    form: InertiaForm,
    information: LastInformation,
    recent_w_G: Array,
    half_turn: Array,
) -> OnlineState:
    """Express the last state (``iterate_of_frame``) in principal axes, with its covariance.

    recent_w_G (n, 3) are the rates on which the description of undetermined quantities is based. half_turn
    (3, 3), the axes R_GP of the previous frame, chooses among the four equivalent orientations.
    """
    derivative = axes_derivative(form, at)
    joint = information.joint
    bare = joint.copy()
    bare[N_STATE:, N_STATE:] -= information.weak_prior
    state = cho_factor(joint[:N_STATE, :N_STATE], lower=True, check_finite=False)
    response = -cho_solve(state, joint[:N_STATE, N_STATE:], check_finite=False)
    constants_information = bare[N_STATE:, N_STATE:] + joint[N_STATE:, :N_STATE] @ response
    w_P = recent_w_G @ derivative.R_GP
    both = 0.5 * (constants_information + constants_information.T)
    determined = analyse(both, derivative, w_P, APART_SIGMAS)
    T = state_jacobians(at, derivative)[0]
    dense = np.asarray(np.linalg.inv(joint))
    covariance = T @ dense @ T.T
    lost = undetermined_states(determined, T[None], response, w_P[-1:])[0]
    turn = nearest_half_turn(derivative.R_GP, half_turn)
    R_GP = derivative.R_GP @ turn
    flip = np.concatenate([np.ones(6), np.diag(turn), np.diag(turn)])
    known = determined.record
    # along the curved valley of one undetermined ratio, the other one changes too
    ratios = known.k1 and known.k2
    of_body = dense[N_STATE:, N_STATE:]
    cov_com, cov_J = of_body[COM, COM], of_body[XI, XI]
    com_lost: Bools = np.abs(derivative.R_GP[:, ~known.com_P]).max(axis=1, initial=0.0) > 0.1
    cov_axes = free_axis_covariance(derivative.axes @ cov_J @ derivative.axes.T, ~known.axes_P)
    moments = derivative.moments
    return OnlineState(
        timestamp_ns,
        at.p_NG[0] + at.R_NG[0] @ at.com_G,
        at.v_N[0].copy(),
        at.R_NG[0] @ R_GP,
        R_GP.T @ at.w_G[0],
        with_infinite(covariance, lost) * np.outer(flip, flip),
        X_NG_seen,
        np.log(moments[:2] / moments[1:]),
        with_infinite(derivative.ratios @ cov_J @ derivative.ratios.T, np.repeat(not ratios, 2)),
        at.com_G.copy(),
        with_infinite(cov_com, com_lost),
        R_GP,
        with_infinite(cov_axes, ~known.axes_P) * np.outer(np.diag(turn), np.diag(turn)),
        at.xi.copy(),
        with_infinite(cov_J, determined.lost_constants[XI]),
        np.array([ratios, ratios, known.com, known.axes]),
    )


def unknown_state(
    timestamp_ns: int, X_NR: Array, frame: Frame | None = None, com_G: Array | None = None
) -> OnlineState:
    """Before the motion is known: the latest pose of the target, or one metre in front of the camera."""
    X_NG = X_NR @ make_pose(np.eye(3), [0.0, 0.0, 1.0]) if frame is None else frame.X_NG_seen
    com = np.zeros(3) if com_G is None else com_G.copy()
    r_N, zero = X_NG[:3, :3] @ com + X_NG[:3, 3], np.zeros(3)
    unknown = {n: np.diag(np.full(n, np.inf)) for n in (2, 3, 5, 12)}
    return OnlineState(
        *(timestamp_ns, r_N, zero, X_NG[:3, :3], zero, unknown[12], X_NG, np.zeros(2), unknown[2], com),
        *(unknown[3], np.eye(3), unknown[3], np.zeros(5), unknown[5], np.zeros(4, bool)),
    )
