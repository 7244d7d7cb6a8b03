"""Observability rank test by Lie derivatives (Hermann and Krener 1977; thesis chapter 3), motion by motion.

    python -m lab.solvers.lie_rank

No data: ranks of symbolic matrices at one state of each motion. A system x' = f(x), y = h(x) is locally
weakly observable where the gradients of h and of its Lie derivatives along f span the whole state space.
Their null space is unobservable: for a free body whose rates are measured, the scale of its inertia.

Two misprints of the thesis: eq. 3.14 has the gradient of L^0 h in both rows, where its listing B.3 has L^0
and L^1; eq. 3.15 has minus signs, but its own reading is a common factor of Jxx, Jyy and Jzz.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from lab.command import command
from lab.presentation import print_table
from polhode.backend.dynamics.kernels import quaternion_product_sx
from polhode.geometry.lie import Array

ORDERS = (1, 2, 3, 4)
BOX, DISC, BALL = (1.5, 1.2, 0.9), (1.3, 1.3, 0.8), (1.0, 1.0, 1.0)
MOTIONS = {
    "tumble of unequal moments": ((0.4, 0.5, 0.45), BOX),
    "the same, one rate passes zero": ((0.8, 0.1, 0.0), BOX),
    "axisymmetric, precessing": ((0.4, 0.1, 0.6), DISC),
    "equal moments": ((0.4, 0.1, 0.6), BALL),
    "pure spin about the least moment": ((0.0, 0.0, 0.8), BOX),
    "flat spin: about the greatest moment": ((0.8, 0.0, 0.0), BOX),
    "at rest": ((0.0, 0.0, 0.0), BOX),
}
"""w_P [rad/s] and principal moments, any scale."""
RANK_TOLERANCE = 1e-9
"""Singular values below this share of the largest one are zero: far above rounding, far below any motion."""


@dataclass(frozen=True)
class System:
    """x' = f(x), y = h(x) as CasADi expressions."""

    x: Any
    f: Any
    h: Any
    names: tuple[str, ...]
    """of the components of x"""

    def lie_derivatives(self, order: int) -> list[Any]:
        """L^0 h = h, L^1 h = dh/dx f, ... up to the order."""
        out = [self.h]
        for _ in range(order):
            out.append(ca.jtimes(out[-1], self.x, self.f))
        return out

    def observability_matrix(self, order: int) -> Any:
        """Function x (n) -> the stacked gradients of the Lie derivatives, (m (order + 1), n)."""
        rows = [ca.jacobian(each, self.x) for each in self.lie_derivatives(order)]
        return ca.Function("observability", [self.x], [ca.densify(ca.vertcat(*rows))])


def main() -> None:
    """Print the thesis's null vector and both tables of ranks."""
    rates, poses = measured_rates(), measured_poses()
    state = np.array([0.4, 0.5, 0.45, *BOX])
    null_space = unobservable(np.asarray(rates.observability_matrix(1)(state)))
    null, rank = null_space[:, 0] / null_space[-1, 0], len(state) - null_space.shape[1]
    print("Rates along the principal axes are measured (thesis 3.8-3.15); x = (w, Jxx, Jyy, Jzz)")
    print(f"[grad L^0 h; grad L^1 h]: rank {rank} of {len(state)}, null vector {np.round(null, 6)}")
    print(f"the inertia itself over Jzz: {np.round(state[3:] / state[5], 6)}: only its scale is hidden\n")
    table(rates, {name: np.array([*w, *J]) for name, (w, J) in MOTIONS.items()})
    print("\nPoses of G are measured, centre of mass and axes are unknown: x = (r, v, q, w, com, J)\n")
    table(poses, {name: pose_state(w, J) for name, (w, J) in MOTIONS.items()})


def pose_state(w: tuple[float, float, float], moments: tuple[float, float, float]) -> np.ndarray:
    """A state (22,) of ``measured_poses`` with its principal axes along G."""
    motion = [0.1, 0.2, 0.6, 0.01, 0.02, -0.01]
    return np.array([*motion, 0.5, 0.5, -0.5, 0.5, *w, 0.01, 0.02, -0.03, *moments, 0.0, 0.0, 0.0])


def table(system: System, states: dict[str, np.ndarray]) -> None:
    """Ranks by the highest order of derivatives, and the components of the unobservable directions."""
    functions, rows = [system.observability_matrix(order) for order in ORDERS], []
    for name, state in states.items():
        found = [unobservable(np.asarray(function(state))) for function in functions]
        share = np.abs(found[-1]).max(axis=1, initial=0.0)
        hidden = [part for part, much in zip(system.names, share, strict=True) if much > 1e-6]
        ranks = [str(len(state) - each.shape[1]) for each in found]
        rows.append([name, *ranks, f"{found[-1].shape[1]}: {', '.join(hidden)}"])
    print_table(("motion", *(f"up to L^{order}" for order in ORDERS), "hidden"), rows)


def measured_rates() -> System:
    """The thesis's case (3.8-3.13): x = (w_P, Jxx, Jyy, Jzz), the rates along known axes are measured."""
    x = ca.SX.sym("x", 6)
    w, J = x[0:3], x[3:6]
    w_dot = ca.vertcat(
        (J[1] - J[2]) / J[0] * w[1] * w[2],
        (J[2] - J[0]) / J[1] * w[2] * w[0],
        (J[0] - J[1]) / J[2] * w[0] * w[1],
    )
    return System(x, ca.vertcat(w_dot, ca.SX.zeros(3)), w, ("w_x", "w_y", "w_z", "J_xx", "J_yy", "J_zz"))


def measured_poses() -> System:
    """The back end's case: the pose of G is measured; x = (r_N, v_N, q_NG, w_G, com_G, J_G), 22 numbers.

    J_G as (xx, yy, zz, xy, xz, yz): its axes and its scale are unknown too.
    """
    x = ca.SX.sym("x", 22)
    r, v, q, w, com, j = x[0:3], x[3:6], x[6:10], x[10:13], x[13:16], x[16:22]
    J = ca.vertcat(ca.horzcat(j[0], j[3], j[4]), ca.horzcat(j[3], j[1], j[5]), ca.horzcat(j[4], j[5], j[2]))
    q_dot = 0.5 * quaternion_product_sx(q, ca.vertcat(0.0, w))
    w_dot = -ca.inv(J) @ ca.cross(w, J @ w)
    f = ca.vertcat(v, ca.SX.zeros(3), q_dot, w_dot, ca.SX.zeros(9))
    names = (
        *(f"{name}_{axis}" for name in ("r", "v") for axis in "xyz"),
        *(f"q_{part}" for part in "wxyz"),
        *(f"{name}_{axis}" for name in ("w", "com") for axis in "xyz"),
        *(f"J_{pair}" for pair in ("xx", "yy", "zz", "xy", "xz", "yz")),
    )
    return System(x, f, ca.vertcat(r - _rotate(q, com), q), names)


def _rotate(q: Any, p: Any) -> Any:
    """R(q) p for a quaternion of any norm near 1, scalar first."""
    vector = q[1:4]
    return p + 2.0 * ca.cross(vector, ca.cross(vector, p) + q[0] * p)


def unobservable(matrix: Array) -> Array:
    """Null space (n, n - rank) of an observability matrix (m, n), orthonormal, by its singular values."""
    _, values, rows = np.linalg.svd(matrix)
    rank = int(np.sum(values > RANK_TOLERANCE * values[0]))
    return np.asarray(rows[rank:].T)


if __name__ == "__main__":
    command(main)
