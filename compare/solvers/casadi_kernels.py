"""Kernels of the common cost as CasADi expressions: stereo terms too, and exact second derivatives."""

import subprocess
from pathlib import Path
from shutil import which
from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import StepLayout, dynamics_kernel, prior_kernel, upper
from polhode.backend.problem.inertia import InertiaForm, rotation_sx
from polhode.backend.problem.iterate import N_CONSTANTS
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.robust_kernel import MAX_CURVATURE
from polhode.lie import Array

Hessian = Literal["gauss_newton", "exact"]
N_STEREO = 32
"""Parameters of a measurement: A_ref (9), R_RN (9), by columns, t_R, uvd, 1 / sigma (3 each), rig (5)."""
COMPILERS = ("cc", "gcc", "clang")


def stereo_kernels(scale: float, hessian: Hessian) -> dict[str, Any]:
    """Functions (x (9) = p_NG, theta, p_G; q (32)) of the cost; with gradient; with upper Hessian too."""
    x, q = ca.SX.sym("x", 9), ca.SX.sym("q", N_STEREO)
    A = ca.reshape(q[0:9], 3, 3) @ rotation_sx(x[3:6])
    p = A @ x[6:9] + ca.reshape(q[9:18], 3, 3) @ x[0:3] + q[18:21]
    f, cx, cy, baseline, offset = (q[27 + i] for i in range(5))
    seen = ca.vertcat(f * p[0] / p[2] + cx, f * p[1] / p[2] + cy, f * baseline / p[2] + offset)
    r = (q[21:24] - seen) * q[24:27]
    s = ca.sumsqr(r)
    cost = 0.5 * scale**2 * ca.log1p(s / scale**2)
    gradient = ca.gradient(cost, x)
    if hessian == "exact":
        second, _ = ca.hessian(cost, x)
    else:
        # as kernels.kernel_bend: the kernel's curvature as far as the block stays positive
        J, weight = ca.jacobian(r, x), 1.0 / (1.0 + s / scale**2)
        limited = ca.fmin(2.0 / (scale**2 + s), MAX_CURVATURE / (s + 1e-12))
        bend = limited / (1.0 + ca.sqrt(1.0 - limited * s))
        B = J - bend * r @ (r.T @ J)
        second = weight * B.T @ B
    outputs = [cost, ca.densify(gradient), upper(ca.densify(second))]
    return {
        name: ca.Function(f"stereo_{name}", [x, q], outputs[:n])
        for name, n in (("cost", 1), ("gradient", 2), ("quadratic", 3))
    }


def compile_kernels(kernels: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same functions from generated C, compiled by the machine's compiler; RuntimeError without one."""
    compiler = next((name for name in COMPILERS if which(name)), None)
    if compiler is None:
        raise RuntimeError(f"no C compiler found ({', '.join(COMPILERS)})")
    generator = ca.CodeGenerator("stereo.c")
    for kernel in kernels.values():
        generator.add(kernel)
    source, library = Path(generator.generate(f"{folder}/")), folder / "stereo.so"
    command = [compiler, "-O3", "-fPIC", "-shared", str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{compiler} failed: {done.stderr.splitlines()[0] if done.stderr else ''}")
    return {name: ca.external(kernel.name(), str(library)) for name, kernel in kernels.items()}


def stereo_parameters(data: MotionData, held: LinearizationPoint) -> Array:
    """(32, M) one column a measurement."""
    d, k = data, data.frame
    by_columns = [np.swapaxes(R, 1, 2).reshape(-1, 9)[k] for R in (held.A, d.R_RN)]
    rig = np.broadcast_to(d.rig, (len(k), 5))
    return np.ascontiguousarray(np.hstack([*by_columns, d.t_R[k], d.uvd_px, d.inv_sigma, rig]).T)


def exact_step_kernel(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """The dynamics of a step: cost, gradient, upper exact Hessian; arguments as ``dynamics_kernel``."""
    kernel = dynamics_kernel(form, n_series, "gradient", layout).expand()
    arguments = [ca.SX.sym(f"a{i}", kernel.size1_in(i), kernel.size2_in(i)) for i in range(kernel.n_in())]
    cost, gradient = kernel.call(arguments)
    second = ca.densify(ca.jacobian(gradient, arguments[0]))
    return ca.Function("exact_step", arguments, [cost, gradient, upper(second)])


def bent_step_kernel(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """Upper Hessian of the residuals of a step, each times its multiplier (last argument, 12)."""
    kernel = dynamics_kernel(form, n_series, "jacobian", layout).expand()
    arguments = [ca.SX.sym(f"a{i}", kernel.size1_in(i), kernel.size2_in(i)) for i in range(kernel.n_in())]
    multiplier = ca.SX.sym("multiplier", 12)
    _, jacobian = kernel.call(arguments)
    second = ca.densify(ca.jacobian(jacobian.T @ multiplier, arguments[0]))
    return ca.Function("bent_step", [*arguments, multiplier], [upper(second)])


def exact_prior_kernel(form: InertiaForm) -> Any:
    """The weak prior: cost, gradient, upper exact Hessian; arguments as ``prior_kernel``."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", 13)
    cost, gradient = prior_kernel(form, "gradient")(x, p)
    return ca.Function("exact_prior", [x, p], [cost, gradient, upper(ca.densify(ca.jacobian(gradient, x)))])
