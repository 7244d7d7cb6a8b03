"""Angular momentum and spin axis at the last pair, from the joint covariance of state and inertia.

The covariance is that of the body itself in the solver's parameters, which is finite also where the motion
does not determine the inertia. So a quantity that does not depend on what is undetermined keeps its sigma:
in a spin without nutation the angular momentum is along the spin axis, whatever the moments are.
"""

import numpy as np

from polhode.geometry.lie import Array, hat
from polhode.records.estimate import MassProperties, MotionEstimate
from polhode.run_directory.archives import undetermined_as_inf
from polhode.run_directory.summary_schema import Direction, Rotation

MAX_DIRECTION_RAD = float(np.deg2rad(5.0))
"""Largest standard deviation of a direction that counts as determined, as of the principal axes."""
MAX_LN_SIZE = 0.06
"""Largest relative one that the inertia may give the size of the momentum, as of k1 and k2."""
MAX_LN_ABSOLUTE = 0.3
"""Largest relative one of the momentum in N m s, as of the inertia's scale."""
THETA, RATE, XI = slice(6, 9), slice(9, 12), slice(12, 17)
"""Where they stand in ``covariance_last_body``."""


def last_rotation(estimate: MotionEstimate) -> Rotation | None:
    """Of the last state; None: the estimate has no covariance of the body itself."""
    covariance, mass = estimate.covariance_last_body, estimate.mass
    if covariance is None or mass.J_by_xi is None:
        return None
    w_P, R_NG = estimate.w_P[-1], estimate.R_NP[-1] @ mass.R_GP.T
    w_G = mass.R_GP @ w_P
    h_G = mass.J_G @ w_G
    of_momentum, of_size = momentum_jacobian(R_NG, w_G, mass.J_G, mass.J_by_xi)
    of_spin, _ = momentum_jacobian(R_NG, w_G, np.eye(3), np.zeros((5, 3, 3)))
    size = float(np.linalg.norm(h_G))
    beyond = size**2 * _beyond_first_order(mass.J_G, mass.J_by_xi, covariance[XI, XI])
    by_inertia = np.sqrt(of_size[XI] @ covariance[XI, XI] @ of_size[XI] + beyond)
    sigma = np.sqrt(of_size @ covariance @ of_size + beyond)
    across, of_rate = _across(w_P), undetermined_as_inf(estimate.covariance[-1][9:, 9:])
    of_spin_P = across @ of_rate @ across.T if np.isfinite(of_rate).all() else of_rate
    known, scale = not estimate.hypotheses, mass.inertia_scale_kg_m2
    absolute = _sigma_ln_absolute(mass, of_size / max(size, 1e-300), covariance)
    return Rotation(
        momentum_N=_direction(R_NG @ h_G, of_momentum @ covariance @ of_momentum.T, known),
        momentum_rad_s=size,
        sigma_momentum_rad_s=float(sigma) if known and by_inertia < MAX_LN_SIZE * size else None,
        momentum_N_m_s=None if scale is None else scale * size,
        sigma_momentum_N_m_s=(
            None if scale is None or not known or absolute > MAX_LN_ABSOLUTE else scale * size * absolute
        ),
        spin_N=_direction(R_NG @ w_G, of_spin @ covariance @ of_spin.T, known),
        spin_P=_direction(w_P, of_spin_P, known),
    )


def momentum_jacobian(R_NG: Array, w_G: Array, J_G: Array, J_by_xi: Array) -> tuple[Array, Array]:
    """Derivatives (3, 20) of the direction of R_NG J_G w_G, and (20,) of its size, in the last state.

    That is r_N, v_N, theta in R_NG Exp(theta), w_G, xi and com_G; J_by_xi (5, 3, 3).
    """
    h_G = J_G @ w_G
    change = np.zeros((3, 20))
    change[:, RATE], change[:, XI] = J_G, (J_by_xi @ w_G).T
    of_direction = _across(h_G) @ change
    of_direction[:, THETA] = -hat(_unit(h_G))
    return R_NG @ of_direction, _unit(h_G) @ change


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))


def _across(vector: Array) -> Array:
    """Derivative (3, 3) of the direction of a vector (3,)."""
    unit = _unit(vector)
    return np.asarray((np.eye(3) - np.outer(unit, unit)) / max(float(np.linalg.norm(vector)), 1e-300))


def _direction(vector: Array, covariance: Array, known: bool) -> Direction:
    unit, sigma = _unit(vector), np.inf
    if known and np.isfinite(covariance).all():
        sigma = float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
    if sigma > MAX_DIRECTION_RAD:
        return Direction(unit=unit, cov=[[None] * 3] * 3, sigma_deg=None)
    return Direction(unit=unit, cov=covariance.tolist(), sigma_deg=float(np.rad2deg(sigma)))


def _beyond_first_order(J_G: Array, J_by_xi: Array, cov_xi: Array) -> float:
    """What the first order neglects of the variance of the logarithm of the size.

    Where two moments are nearly equal their eigenvalues repel each other: the middle moment is taken exactly,
    at pairs of opposite deviations whose second moments are those of cov_xi (5, 5).
    """
    values, vectors = np.linalg.eigh(cov_xi)
    root = np.sqrt(len(cov_xi) * np.maximum(values, 0.0)) * vectors
    change = np.einsum("nk,kij->nij", np.concatenate([root.T, -root.T]), J_by_xi)
    middle = np.maximum(np.linalg.eigvalsh(J_G + change)[:, 1], 1e-6)
    # J_by_xi is that of the inertia over its middle moment, to first order: what remains is the second
    return float(np.mean(np.log(middle) ** 2))


def _sigma_ln_absolute(mass: MassProperties, of_ln: Array, covariance: Array) -> float:
    """Relative sigma of the size in N m s, by the scale that known torques give the inertia; inf: none."""
    scale, sigma = mass.inertia_scale_kg_m2, mass.sigma_inertia_scale_kg_m2
    if scale is None or sigma is None or mass.cov_ln_scale is None or not np.isfinite(sigma):
        return np.inf
    variance = float((sigma / scale) ** 2 + of_ln @ (2.0 * mass.cov_ln_scale + covariance @ of_ln))
    return float(np.sqrt(max(variance, 0.0)))
