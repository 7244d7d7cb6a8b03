"""Follows a body whose inertia and centre of mass are themselves estimates, by poses of its own mesh.

State: what the end of a run knows (``planning.prediction.FinalState``), and errors of its mesh. Errors (27,):
r, v of the centre of mass in N, theta in R_NG Exp(theta), w in G, the five parameters of the inertia, com_G,
the bias (6,) of a measured pose in the sense of ``pose_error``, and how far the whole mesh lies outside of
the true surface [m]. Edges of the mesh are displaced, each in its own way, and a view has the error of those
that it shows: the bias is a Gauss-Markov process in the angle by which the view turns. A surface that is too
large everywhere displaces all poses for good, away from the camera: this is one constant.

Derivatives of the motion are central differences.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from polhode.geometry.lie import Array, exp_so3, hat, inverse_pose, log_so3, make_pose
from polhode.planning.edges.observability_metric import pose_error
from polhode.planning.prediction import FinalEstimate

R, V, THETA, W, XI, COM, BIAS, OUTWARD = (
    slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 17), slice(17, 20), slice(20, 26),
    slice(26, 27),
)  # fmt: skip
SIZE = 27
STEP_RAD = 0.1
"""Of the body, in one step of the integration"""
_NUDGE = 1e-5


@dataclass(frozen=True)
class BodyState:
    """The body at one instant."""

    r_N: Array
    """(3,) centre of mass [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NG: Array
    """(3, 3)"""
    w_G: Array
    """(3,) [rad/s]"""
    J_G: Array
    """(3, 3) of the parameters at the end of the run"""
    J_jacobian: Array
    """(5, 3, 3)"""
    xi: Array
    """(5,) change of the parameters since then"""
    com_G: Array
    """(3,) [m]"""
    bias: Array
    """(6,) of measured poses [m, rad]"""
    outward: Array
    """(1,) of the mesh's surface from the true one [m]"""
    covariance: Array
    """(27, 27)"""

    def plus(self, error: Array) -> "BodyState":
        """The state that is off by error (27,), with the same covariance."""
        return replace(
            self,
            r_N=self.r_N + error[R],
            v_N=self.v_N + error[V],
            R_NG=self.R_NG @ exp_so3(error[THETA]),
            w_G=self.w_G + error[W],
            xi=self.xi + error[XI],
            com_G=self.com_G + error[COM],
            bias=self.bias + error[BIAS],
            outward=self.outward + error[OUTWARD],
        )

    @property
    def inertia(self) -> Array:
        """(3, 3) with the present parameters."""
        return np.asarray(self.J_G + np.einsum("k,kij->ij", self.xi, self.J_jacobian))

    @property
    def X_NG(self) -> Array:
        """(4, 4)"""
        return make_pose(self.R_NG, self.r_N - self.R_NG @ self.com_G)


def first_state(estimate: FinalEstimate, bias_covariance: Array, outward_sigma_m: float) -> BodyState:
    """What a run knows at its end, with a bias of covariance (6, 6)."""
    last = estimate.last
    covariance = np.zeros((SIZE, SIZE))
    covariance[:20, :20], covariance[BIAS, BIAS] = last.covariance, bias_covariance
    covariance[OUTWARD, OUTWARD] = outward_sigma_m**2
    return BodyState(
        last.r_N, last.v_N, last.R_NG, last.w_G, last.J_G, last.J_jacobian, np.zeros(5), estimate.com_G,
        np.zeros(6), np.zeros(1), covariance,
    )  # fmt: skip


def turned(R_NG: Array, w_G: Array, J_G: Array, dt_s: float) -> tuple[Array, Array]:
    """Attitude and rate after free rotation, of n bodies at once: (n, 3, 3), (n, 3), (n, 3, 3)."""
    steps = max(1, int(np.ceil(dt_s * float(np.linalg.norm(w_G, axis=1).max()) / STEP_RAD)))
    h, inverse = dt_s / steps, np.linalg.inv(J_G)

    def slope(w: Array) -> Array:
        momentum = np.einsum("nij,nj->ni", J_G, w)
        return np.asarray(np.einsum("nij,nj->ni", inverse, np.cross(momentum, w)))

    for _ in range(steps):
        one = slope(w_G)
        two = slope(w_G + 0.5 * h * one)
        three = slope(w_G + 0.5 * h * two)
        four = slope(w_G + h * three)
        after = w_G + h / 6.0 * (one + 2.0 * two + 2.0 * three + four)
        middle = 0.5 * (w_G + after) + h / 8.0 * (one - slope(after))
        # Magnus expansion to the fourth order
        turn = h / 6.0 * (w_G + 4.0 * middle + after) + h * h / 12.0 * np.cross(w_G, after)
        R_NG, w_G = R_NG @ exp_so3(turn), after
    return R_NG, w_G


def predict(state: BodyState, estimate: FinalEstimate, dt_s: float, bias: Array, kept: float) -> BodyState:
    """After dt_s > 0; of the bias the share ``kept`` stays, towards the stationary covariance (6, 6)."""
    columns = [THETA, W, XI]
    nudges = np.concatenate([np.eye(SIZE)[each] for each in columns])
    both = [state, *(state.plus(sign * _NUDGE * each) for sign in (1.0, -1.0) for each in nudges)]
    R_NG, w_G = turned(
        np.stack([each.R_NG for each in both]),
        np.stack([each.w_G for each in both]),
        np.stack([each.inertia for each in both]),
        dt_s,
    )
    count, F = len(nudges), np.eye(SIZE)
    F[R, V] = dt_s * np.eye(3)
    theta = log_so3(np.swapaxes(R_NG[1 + count :], 1, 2) @ R_NG[1 : 1 + count]) / (2.0 * _NUDGE)
    w = (w_G[1 : 1 + count] - w_G[1 + count :]) / (2.0 * _NUDGE)
    at = np.concatenate([np.arange(SIZE)[each] for each in columns])
    F[THETA, at], F[W, at] = theta.T, w.T
    F[BIAS, BIAS] = kept * np.eye(6)
    noise = np.zeros((SIZE, SIZE))
    J = state.inertia
    middle = np.linalg.eigvalsh(J)[1]
    shake = estimate.torque_psd * middle**2 * np.linalg.inv(J @ J.T)
    for at_place, at_rate, density in ((R, V, estimate.accel_psd * np.eye(3)), (THETA, W, shake)):
        noise[at_place, at_place] = dt_s**3 / 3.0 * density
        noise[at_place, at_rate] = noise[at_rate, at_place] = dt_s**2 / 2.0 * density
        noise[at_rate, at_rate] = dt_s * density
    noise[BIAS, BIAS] = (1.0 - kept**2) * bias
    return replace(
        state,
        r_N=state.r_N + dt_s * state.v_N,
        R_NG=R_NG[0],
        w_G=w_G[0],
        bias=kept * state.bias,
        covariance=F @ state.covariance @ F.T + noise,
    )


def pose_jacobian(state: BodyState, X_NR: Array, o_G: Array) -> Array:
    """Derivative (6, 27) of the pose in the camera, in the sense of ``pose_error``, by the state's error."""
    R_RN, H = X_NR[:3, :3].T, np.zeros((6, SIZE))
    R_RG = R_RN @ state.R_NG
    H[:3, R], H[:3, COM] = R_RN, -R_RG
    H[:3, THETA], H[3:, THETA] = -R_RG @ hat(o_G - state.com_G), R_RG
    return H


def measured_jacobian(state: BodyState, X_NR: Array, o_G: Array, outward: Array) -> Array:
    """Derivative (6, 27) of a measured pose, with the errors of the mesh."""
    H = pose_jacobian(state, X_NR, o_G)
    H[:, BIAS], H[:, OUTWARD] = np.eye(6), outward[:, None]
    return H


@dataclass(frozen=True)
class Updated:
    """A state after a measurement."""

    state: BodyState
    nis: float
    """squared innovation over its covariance; 6 on average"""
    taken: bool
    """False: refused by the gate"""


@dataclass(frozen=True)
class MeasuredPose:
    """A pose of the mesh that a tracker found in an image."""

    X_RG: Array
    """(4, 4)"""
    noise: Array
    """(6, 6) covariance of what is new in this image"""
    outward: Array
    """(6,) error of the pose for a mesh that is too large by a metre on all sides"""
    beyond: Array
    """(6,) step from the pose to that which the edges would give without the tracker's prior"""


def update(
    state: BodyState, X_NR: Array, measured: MeasuredPose, o_G: Array, gate: float | None = None
) -> Updated:
    """After a measured pose; with a gate, none whose innovation is beyond that quantile."""
    H = measured_jacobian(state, X_NR, o_G, measured.outward)
    expected = state.bias + measured.outward * state.outward
    off = pose_error(measured.X_RG, inverse_pose(X_NR) @ state.X_NG, o_G) + measured.beyond
    innovation = off - expected
    S = cho_factor(H @ state.covariance @ H.T + measured.noise)
    nis = float(innovation @ cho_solve(S, innovation))
    if gate is not None and nis > float(chi2.ppf(gate, 6)):
        return Updated(state, nis, False)
    K = cho_solve(S, H @ state.covariance).T
    rest = np.eye(SIZE) - K @ H
    P = rest @ state.covariance @ rest.T + K @ measured.noise @ K.T
    return Updated(replace(state.plus(K @ innovation), covariance=0.5 * (P + P.T)), nis, True)


def arrival_covariance(state: BodyState, X_NR: Array, o_G: Array) -> Array:
    """(12, 12) of the pose in the camera (``pose_error``), of v in N and w in G."""
    H = np.zeros((12, SIZE))
    H[:6] = pose_jacobian(state, X_NR, o_G)
    H[6:9, V] = H[9:12, W] = np.eye(3)
    return np.asarray(H @ state.covariance @ H.T)
