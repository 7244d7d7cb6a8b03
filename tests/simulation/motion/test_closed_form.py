"""The torque-free truth against the closed form in Jacobi's elliptic functions.

Angular velocity: Landau and Lifshitz, "Mechanics", section 37. Precession: the incomplete elliptic integral
of the third kind, as in van Zon and Schofield, "Numerical implementation of the exact dynamics of free rigid
bodies", J. Comput. Phys. 225 (2007); here by Carlson's symmetric forms, which scipy evaluates.
"""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk, ellipkinc, elliprf, elliprj

from polhode.geometry.lie import Array, exp_so3, log_so3
from polhode.simulation.motion.integrate import advance, no_forces
from polhode.simulation.motion.target import target_motion
from tests.simulation.motion.motion_scenes import mass_of, rpm, scene_of

CASES = {
    "major axis": ([1.4, 1.0, 0.7], [1.0, 0.2, 0.3]),
    "minor axis": ([1.4, 1.0, 0.7], [0.1, -0.25, 1.1]),
    "major axis, backwards": ([1.4, 1.0, 0.7], [-1.0, 0.3, 0.2]),
    "minor axis, backwards": ([1.4, 1.0, 0.7], [0.2, 0.3, -1.2]),
    "flip above the separatrix": ([0.0241, 0.0234, 0.0201], [0.08, 1.04, 0.02]),
    "flip below the separatrix": ([0.0241, 0.0234, 0.0201], [0.02, 1.04, 0.08]),
    "oblate": ([1.7, 1.0, 1.0], [0.9, 0.3, -0.2]),
    "prolate": ([1.5, 1.5, 0.6], [-0.2, 0.3, 1.3]),
}


@pytest.mark.parametrize(("moments", "w_P"), CASES.values(), ids=CASES)
def test_attitude_agrees_with_the_elliptic_closed_form_after_a_minute(
    moments: list[float], w_P: list[float]
) -> None:
    J, w = np.array(moments), np.array(w_P)
    start_deg = [30.0, -50.0, 80.0]
    scene = scene_of(interval_s=20.0, horizon_s=60.0, spin_rpm=rpm(w), attitude_deg=start_deg)
    motion = target_motion(scene, mass_of(J), 0)
    np.testing.assert_array_equal(motion.t_s, [0.0, 20.0, 40.0, 60.0])
    for k, t_s in enumerate(motion.t_s):
        R_NP, w_P_t = closed_form(J, exp_so3(np.deg2rad(start_deg)), w, float(t_s))
        np.testing.assert_allclose(motion.w_P[k], w_P_t, atol=1e-9)
        assert np.rad2deg(np.linalg.norm(log_so3(motion.R_NP[k].T @ R_NP))) < 1e-6


def test_the_integrator_under_forces_agrees_with_it_too() -> None:
    J, w = (np.array(values) for values in CASES["flip above the separatrix"])
    y = advance(np.concatenate([np.zeros(6), [1, 0, 0, 0], J * w]), 0.0, 60.0, no_forces(J))
    R_NP, w_P = closed_form(J, np.eye(3), w, 60.0)
    np.testing.assert_allclose(y[10:13] / J, w_P, atol=1e-10)
    # First column of the rotation matrix, written out of the quaternion.
    a, b, c, d = y[6:10]
    column = [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)]
    np.testing.assert_allclose(column, R_NP[:, 0], atol=1e-9)


def closed_form(J: Array, R_NP0: Array, w_P0: Array, t_s: float) -> tuple[Array, Array]:
    """R_NP (3, 3) and w_P (3,) at a time t_s from those at zero; moments (3,) sorted, greatest first."""
    R_PA = _axes_of_circulation(J, w_P0)
    J_A, w_A0 = np.diag(R_PA.T @ np.diag(J) @ R_PA), R_PA.T @ w_P0
    h = float(np.linalg.norm(J_A * w_A0))
    w_A, turn = _rate_and_precession(J_A, w_A0, h, t_s)
    R_HA0, R_HA = _momentum_upwards(J_A * w_A0 / h), _momentum_upwards(J_A * w_A / h)
    about_h = exp_so3([0.0, 0.0, turn])
    R_NA = R_NP0 @ R_PA @ R_HA0.T @ about_h @ R_HA
    return R_NA @ R_PA.T, R_PA @ w_A


def _axes_of_circulation(J: Array, w_P: Array) -> Array:
    """R_PA: A's third axis is the principal axis that w circles, and w is on its positive side."""
    two_energy, h_squared = float(J @ w_P**2), float(np.sum((J * w_P) ** 2))
    about_major = h_squared > two_energy * J[1]
    R_PA = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]) if about_major else np.eye(3)
    return R_PA @ np.diag([1.0, -1.0, -1.0]) if (R_PA.T @ w_P)[2] < 0 else R_PA


def _rate_and_precession(J: Array, w0: Array, h: float, t_s: float) -> tuple[Array, float]:
    """Angular velocity in A after t_s, and the angle by which the third axis has turned about h."""
    J1, J2, J3 = J
    two_energy = float(J @ w0**2)
    d3, d1 = two_energy * J3 - h**2, h**2 - two_energy * J1
    amplitude = np.sqrt(np.array([d3 / (J1 * (J3 - J1)), d3 / (J2 * (J3 - J2)), d1 / (J3 * (J3 - J1))]))
    rate = np.sqrt((J3 - J2) * d1 / (J1 * J2 * J3))
    m = (J2 - J1) * d3 / ((J3 - J2) * d1)
    sign = np.sign(J3 - J2)
    phase = float(np.arctan2(sign * w0[1] / amplitude[1], w0[0] / amplitude[0]))
    sn, cn, dn, amplitude_angle = ellipj(ellipkinc(phase, m) + rate * t_s, m)
    w = amplitude * np.array([cn, sign * sn, dn])
    # phi' = h/J3 + h (2E - h^2/J3) / (h^2 - J3^2 w3^2), and w3^2 falls with sn^2.
    across = h**2 - (J3 * amplitude[2]) ** 2
    n = -m * (J3 * amplitude[2]) ** 2 / across
    swept = _third_kind(n, float(amplitude_angle), m) - _third_kind(n, phase, m)
    return w, float(h * t_s / J3 + h * (two_energy - h**2 / J3) / (across * rate) * swept)


def _third_kind(n: float, angle: float, m: float) -> float:
    """Incomplete elliptic integral of the third kind, any angle, n <= 0: Carlson's forms (DLMF 19.25.14)."""
    turns = np.round(angle / np.pi)
    rest = angle - turns * np.pi
    s, c = np.sin(rest), np.cos(rest)
    y = 1 - m * s * s
    partial = s * elliprf(c * c, y, 1.0) + n / 3 * s**3 * elliprj(c * c, y, 1.0, 1 - n * s * s)
    complete = ellipk(m) + n / 3 * elliprj(0.0, 1 - m, 1.0, 1 - n)
    return float(partial + 2 * turns * complete)


def _momentum_upwards(h_A: Array) -> Array:
    """R_HA: third axis of H along h (3,) unit, A's third axis in the plane of H's first and third."""
    axis = np.array([0.0, 0.0, 1.0])
    first = axis - h_A * (h_A @ axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(h_A, first), h_A])
