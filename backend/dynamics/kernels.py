"""Residuals as short pure functions on CasADi SX, and the kernels that the program maps over the data.

Variables of a frame (12): p_NG [m], theta [rad] in R_NG = R_ref Exp(theta), v_N [m/s] of the centre of mass,
w_G [rad/s]. Constants: com_G (3) [m], xi (5) of the inertia. A landmark: p_G (3) [m].
"""

from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.problem.inertia import N_INERTIA, InertiaForm, rotation_sx
from polhode.backend.problem.wrench import ALIGNMENT_SIGMA, LN_PRIOR, N_WRENCH
from polhode.lie import Array

Output = Literal["cost", "gradient", "quadratic", "jacobian"]
"""Cost alone; with its gradient; with gradient and upper Gauss-Newton Hessian; or residual and Jacobian."""

N_STATE = 12
N_CAMERA = 6
"""Errors of the camera's stated pose: shift and turn along N. Unknowns of a frame when that pose is noisy."""
MOST_BEND = 0.6
"""Measured on a cold start and near the end: less converges slower there, more slower here."""
N_CONSTANTS = 3 + N_INERTIA
THIN_PRIOR = 3.0
"""Standard deviation of ln(tr Sigma / 3): 2 for a rod of ten times its thickness."""


def quaternion_product_sx(a: Any, b: Any) -> Any:
    """Hamilton product, scalar first."""
    vector = a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4])
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:4], b[1:4]), vector)


def quaternion_log_sx(q: Any) -> Any:
    """Rotation vector of a unit quaternion (4); the sign is made canonical first."""
    q = q * ca.if_else(q[0] < 0, -1.0, 1.0)
    norm = ca.sqrt(ca.sumsqr(q[1:4]) + 1e-20)
    return 2.0 * ca.atan2(norm, q[0]) / norm * q[1:4]


def prior_residual(com_G: Any, com_prior: Any, com_sigma_m: Any, second: Any) -> Any:
    """Weak prior (10): centre of mass near the middle of the landmarks, inertia near a sphere.

    The last one grows without end for ever thinner bodies, second moments of determinant 1.
    """
    shape = 3.0 * second / ca.trace(second) - ca.SX.eye(3)
    off = ca.sqrt(2.0) * ca.vertcat(shape[1, 0], shape[2, 0], shape[2, 1])
    thin = ca.log(ca.trace(second) / 3.0) / THIN_PRIOR
    return ca.vertcat((com_G - com_prior) / com_sigma_m, ca.diag(shape), off, thin)


def kernel_bend(s: Array, robust_scale: float) -> Array:
    """How much of the Jacobian along the residual r the curvature of the Cauchy kernel takes, s = r.r (M,).

    The kernel's exact second derivative makes the Hessian w J^T (I - 2 w r r^T / c^2) J, with w the weight.
    As w B^T B with B = J - bend r r^T J (Triggs et al., "Bundle adjustment", 2000, eq. 11) it stays positive;
    beyond MOST_BEND it is limited.
    """
    limited = np.minimum(2.0 / (robust_scale**2 + s), MOST_BEND / (s + 1e-12))
    return np.asarray(limited / (1.0 + np.sqrt(1.0 - limited * s)))


def prior_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Function (x (8) = com_G, xi; p (13) = com_prior, com_sigma, R_ref) of the same outputs."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", 13)
    second = form.second_moments_sx(x[3:8], ca.reshape(p[4:13], 3, 3))
    return quadratic_kernel("prior", prior_residual(x[0:3], p[0:3], p[3], second), x, p, output)


def wrench_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Function (x (16) = xi, unknowns of a known wrench; p (20)) of the same outputs.

    What is known beforehand, as ``wrench.wrench_residual``. p = R_ref of the inertia and of the torque's
    axes, standard deviations of the biases of force and torque.
    """
    x, p = ca.SX.sym("x", N_INERTIA + N_WRENCH), ca.SX.sym("p", 20)
    second, unknowns = form.second_moments_sx(x[0:5], ca.reshape(p[0:9], 3, 3)), x[5:16]
    R = ca.reshape(p[9:18], 3, 3) @ rotation_sx(unknowns[1:4])
    M = -R.T @ second @ R
    products = 3.0 / ALIGNMENT_SIGMA / (2.0 * ca.trace(second)) * ca.vertcat(M[2, 1], M[2, 0], M[1, 0])
    logs = ca.vertcat(unknowns[0], unknowns[7]) / LN_PRIOR
    residual = ca.vertcat(products, unknowns[4:7] / p[19], unknowns[8:11] / p[18], logs)
    return quadratic_kernel("wrench", residual, x, p, output)


def hold_kernel(output: Output = "quadratic") -> Any:
    """Function (x (6), p (12) = centre, information) of the same outputs: a pose or its error held softly."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 12)
    return quadratic_kernel("hold", ca.sqrt(p[6:12]) * (x - p[0:6]), x, p, output)


def quadratic_kernel(name: str, residual: Any, x: Any, p: Any, output: Output) -> Any:
    """0.5 r.r alone, or with its gradient and upper Gauss-Newton Hessian, or r and its Jacobian."""
    return ca.Function(name, [x, p], quadratic_outputs(residual, ca.jacobian(residual, x), output))


def quadratic_outputs(residual: Any, jacobian: Any, output: Output) -> list[Any]:
    """Outputs of ``quadratic_kernel`` from the residual and its Jacobian."""
    if output == "jacobian":
        return [residual, ca.densify(jacobian)]
    outputs = [0.5 * ca.sumsqr(residual)]
    if output != "cost":
        outputs.append(ca.densify(jacobian.T @ residual))
    if output == "quadratic":
        outputs.append(upper(ca.densify(jacobian.T @ jacobian)))
    return outputs


def upper(matrix: Any) -> Any:
    """Upper triangle by columns, as CasADi stores a symmetric block."""
    n = matrix.size1()
    return ca.vertcat(*[matrix[i, j] for j in range(n) for i in range(j + 1)])
