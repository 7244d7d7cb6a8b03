"""The dynamics between consecutive states of the window, as whitened factors (``dynamics.residuals``)."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.dynamics.propagation import series_steps
from polhode.backend.dynamics.residuals import FrameStates, Steps, dynamics_jacobians, dynamics_residuals
from polhode.backend.dynamics.so3_exp import rotation_matrices
from polhode.backend.problem.inertia import InertiaForm, inertia_derivative, inertia_from_second_moments
from polhode.backend.problem.iterate import N_CONSTANTS, N_STATE
from polhode.lie import Array
from polhode.records import Ints


@dataclass(frozen=True)
class DynamicsFactors:
    """n steps between n + 1 states, with what is fixed during a solve."""

    steps: Steps
    half_log_det: float
    """Normalization of the process noise, as in ``LinearizationPoint``; of all steps made at once"""

    def __len__(self) -> int:
        return len(self.steps.dt_s)

    def part(self, chosen: slice) -> "DynamicsFactors":
        """Some of the steps."""
        s = self.steps
        return DynamicsFactors(Steps(s.dt_s[chosen], s.series[chosen], s.W_t[chosen], s.W_r[chosen]), 0.0)

    def and_then(self, other: "DynamicsFactors") -> "DynamicsFactors":
        """These steps, then the others."""
        a, b = self.steps, other.steps
        joined = Steps(
            np.concatenate([a.dt_s, b.dt_s]),
            np.concatenate([a.series, b.series]),
            np.concatenate([a.W_t, b.W_t]),
            np.concatenate([a.W_r, b.W_r]),
        )
        return DynamicsFactors(joined, self.half_log_det + other.half_log_det)


NO_FACTORS = DynamicsFactors(
    Steps(np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2, 2)), np.zeros((0, 6, 6))), 0.0
)


@dataclass(frozen=True)
class DisturbanceLevels:
    """Power spectral densities of the disturbing acceleration and torque."""

    accel_psd: float
    torque_psd: float


def make_factors(
    w_G: Array, J_G: Array, J_noise: Array, dt_s: Array, noise: DisturbanceLevels
) -> DynamicsFactors:
    """n steps with the rates (n, 3) at their starts; the disturbing torque acts on J_noise (3, 3)."""
    if len(dt_s) == 0:
        return NO_FACTORS
    W_t, W_r, half_log = whitening(w_G, J_noise, dt_s, noise.accel_psd, noise.torque_psd)
    return DynamicsFactors(Steps(dt_s, series_steps(w_G, J_G, dt_s, noise.torque_psd), W_t, W_r), half_log)


def _states(x: Array, R_ref: Array) -> FrameStates:
    of_frames = x[:-N_CONSTANTS].reshape(-1, N_STATE)
    return FrameStates(
        of_frames, R_ref @ rotation_matrices(of_frames[:, 3:6]), np.zeros((len(R_ref), 3)), x[-8:-5]
    )


def _inertia(x: Array, form: InertiaForm, R_inertia: Array) -> Array:
    return inertia_from_second_moments(form.second_moments(x[-5:], R_inertia))


def factor_residuals(
    x: Array, R_ref: Array, factors: DynamicsFactors, form: InertiaForm, R_inertia: Array
) -> Array:
    """Whitened residuals (n, 12) of the steps between n + 1 states, x (12 (n + 1) + 8,) around R_ref."""
    return dynamics_residuals(_states(x, R_ref), factors.steps, _inertia(x, form, R_inertia))


def factor_jacobians(
    x: Array, R_ref: Array, factors: DynamicsFactors, form: InertiaForm, R_inertia: Array
) -> tuple[Array, Array]:
    """Whitened residuals (n, 12) and Jacobians (n, 12, 32) in state before, state after, com_G, xi."""
    J_G, dJ = _inertia(x, form, R_inertia), inertia_derivative(form, x[-5:], R_inertia)
    return dynamics_jacobians(_states(x, R_ref), factors.steps, J_G, dJ)


def add_factors(H: Array, g: Array, r: Array, D: Array, at: Ints) -> None:
    """Add D^T D and D^T r of each step to H and g in place; step e joins the states at at[e], at[e] + 12."""
    if len(r) == 0:
        return
    blocks, forces = np.swapaxes(D, 1, 2) @ D, (np.swapaxes(D, 1, 2) @ r[:, :, None])[:, :, 0]
    c = len(g) - N_CONSTANTS
    for e, start in enumerate(at):
        both = slice(start, start + 2 * N_STATE)
        H[both, both] += blocks[e, :24, :24]
        H[both, c:] += blocks[e, :24, 24:]
        H[c:, both] += blocks[e, 24:, :24]
        g[both] += forces[e, :24]
    H[c:, c:] += blocks[:, 24:, 24:].sum(axis=0)
    g[c:] += forces[:, 24:].sum(axis=0)
