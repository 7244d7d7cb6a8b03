"""The same cost over other unknowns: a sparse Levenberg-Marquardt method in z, where x = x(z).

``rotation_vector``: x itself, for comparison. ``mrp``: attitudes as modified Rodrigues parameters (thesis
4.5). ``body``: features relative to the centre of mass and the path of the centre of mass, instead of a
geometric frame; section 4.6 of the thesis avoids it, as every change of com_G then moves all features.
Others change the inertia: ``changed_inertia.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, diags, identity, vstack
from scipy.sparse.linalg import splu

from polhode.compare.problem.blocks import Blocks, root_of_kernel, stacked
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.changed_inertia import KINDS, AghiliDynamics, ChangedInertia
from polhode.lie import Array, hat, right_jacobian_so3

TOLERANCE, MAX_ITERATIONS = 1e-9, 300
RENEWED = 15
"""Iterations after which the references of z are renewed."""
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-4, 1e-10, 1e10
"""Relative to the Hessian's diagonal."""


@dataclass
class ChangedUnknowns:
    """One choice of z."""

    unknowns: str = "rotation_vector"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Until the relative decrease of an accepted step is below TOLERANCE."""
        blocks = Blocks(problem.data, problem.fixed)
        change = changes(self.unknowns, problem)
        to_x, to_z, rows = change.to_x, change.to_z, change.rows
        z, damping, cost, iterations = to_z(x), FIRST_DAMPING, np.inf, 0
        for iterations in range(1, MAX_ITERATIONS + 1):
            with monitor.part("evaluation"):
                x, of_z = to_x(z)
                stereo, dynamics, *others = blocks.all(x)
                own, of_own = rows(z)
                if change.dynamics is None:
                    others.append(dynamics)
                else:
                    more, of_more = stacked([change.dynamics.block(z)], len(z))
                    own, of_own = np.concatenate([own, more]), vstack([of_own, of_more])
                kept = [root_of_kernel(stereo, problem.data.robust_scale), *others]
                residual, jacobian = stacked(kept, blocks.n_x)
                residual = np.concatenate([residual, own])
                jacobian = vstack([jacobian @ of_z, of_own], format="csr")
                cost = 0.5 * float(residual @ residual)
            monitor.record(cost, x)
            H, g = (jacobian.T @ jacobian).tocsc(), jacobian.T @ residual
            while True:
                monitor.check()
                step = splu(H + damping * diags(H.diagonal() + 1e-12, format="csc")).solve(-g)
                with monitor.part("evaluation"):
                    after = self._cost(blocks, change, z + step)
                if np.isfinite(after) and after <= cost:
                    break
                damping *= 10.0
                if damping > MAX_DAMPING:
                    return AdapterResult(x, True, iterations, "no further decrease" + change.message(z))
            decrease, cost, z = cost - after, after, z + step
            damping = max(damping / 10.0, MIN_DAMPING)
            if iterations % RENEWED == 0:
                # renews the reference of the axes; the other unknowns stay the same
                z = to_z(to_x(z)[0])
            if decrease <= TOLERANCE * cost:
                return AdapterResult(to_x(z)[0], True, iterations, "converged" + change.message(z))
        return AdapterResult(to_x(z)[0], False, iterations, "limit of iterations" + change.message(z))

    @staticmethod
    def _cost(blocks: Blocks, change: "Change", z: Array) -> float:
        """The common cost and the additional terms; infinite where z is not that of a possible body."""
        x, _ = change.to_x(z)
        if not np.isfinite(x).all():
            return np.inf
        extra = 0.0 if change.dynamics is None else change.dynamics.extra_cost(x, z)
        return blocks.cost(x) + extra + 0.5 * float(np.sum(change.rows(z)[0] ** 2))


@dataclass(frozen=True)
class Change:
    """One choice of z."""

    to_x: Callable[[Array], tuple[Array, Any]]
    """x, and dx/dz (sparse)"""
    to_z: Callable[[Array], Array]
    rows: Callable[[Array], tuple[Array, Any]]
    """Additional residuals of z, and their Jacobian (sparse)"""
    message: Callable[[Array], str] = lambda z: ""
    """Part of the message at the end"""
    dynamics: AghiliDynamics | None = None
    """Replaces the common dynamics; None: the common ones"""


def changes(unknowns: str, problem: MeasuredProblem) -> Change:
    """The choice of a name."""
    if unknowns in KINDS:
        inertia = ChangedInertia(unknowns, problem)
        own = AghiliDynamics(problem, inertia) if unknowns == "aghili_free" else None
        return Change(inertia.to_x, inertia.to_z, inertia.rows, inertia.message, own)
    none = np.zeros(0), csc_matrix((0, len(problem.cold)))
    if unknowns == "mrp":
        return Change(*_of_mrp(problem), lambda z: none)
    if unknowns == "body":
        return Change(*_of_body(problem), lambda z: none)
    same = identity(len(problem.cold), format="csr")
    return Change(lambda z: (z, same), lambda x: x, lambda z: none)


def _of_mrp(problem: MeasuredProblem) -> tuple[Any, Any]:
    at = problem.fixed.reference
    slots = (at.n_state * np.arange(at.n_frames)[:, None] + np.arange(3, 6)).ravel()

    def to_x(z: Array) -> tuple[Array, Any]:
        a = z[slots].reshape(-1, 3)
        size = np.linalg.norm(a, axis=1)
        safe = np.maximum(size, 1e-12)
        # theta = 4 atan(|a|) a / |a|
        along = np.where(size < 1e-6, 4.0, 4.0 * np.arctan(safe) / safe)
        slope = np.where(size < 1e-6, 0.0, (4.0 / (1.0 + safe**2) - along) / safe**2)
        own = along[:, None, None] * np.eye(3) + slope[:, None, None] * a[:, :, None] * a[:, None, :]
        x = z.copy()
        x[slots] = (along[:, None] * a).ravel()
        change = identity(len(z), format="lil")
        rows = np.repeat(slots.reshape(-1, 3), 3, axis=1)
        columns = np.tile(slots.reshape(-1, 3), (1, 3))
        change = change.tocsr() + _block(rows, columns, own - np.eye(3), len(z))
        return x, change

    def to_z(x: Array) -> Array:
        theta = x[slots].reshape(-1, 3)
        size = np.linalg.norm(theta, axis=1, keepdims=True)
        ratio = np.where(size < 1e-6, 0.25, np.tan(size / 4.0) / np.maximum(size, 1e-12))
        z = x.copy()
        z[slots] = (ratio * theta).ravel()
        return z

    return to_x, to_z


def _of_body(problem: MeasuredProblem) -> tuple[Any, Any]:
    """z contains r_N = p_NG + R_NG com_G instead of p_NG, and p_G - com_G instead of p_G."""
    at = problem.fixed.reference
    s, F, com = at.n_state, at.n_frames, slice(at.n_states, at.n_states + 3)
    positions = s * np.arange(F)[:, None] + np.arange(3)

    def moved(vector: Array, sign: float) -> Array:
        R = problem.iterate(vector).R_NG
        out = vector.copy()
        out[positions] += sign * (R @ vector[com])
        landmarks = out[at.n_dense :].reshape(-1, 3)
        landmarks -= sign * vector[com]
        return out

    def to_x(z: Array) -> tuple[Array, Any]:
        x, n = moved(z, -1.0), len(z)
        R = problem.iterate(z).R_NG
        theta = z[: at.n_states].reshape(-1, s)[:, 3:6]
        of_turn = R @ hat(z[com]) @ right_jacobian_so3(theta)
        constants = np.broadcast_to(np.arange(com.start, com.stop), (F, 3))
        change = identity(n, format="csr")
        for columns, block in ((positions + 3, of_turn), (constants, -R)):
            rows = np.repeat(positions, 3, axis=1)
            change = change + _block(rows, np.tile(columns, (1, 3)), block, n)
        landmarks = np.arange(at.n_dense, n)
        which = com.start + (landmarks - at.n_dense) % 3
        return x, change + csc_matrix((np.ones(len(landmarks)), (landmarks, which)), shape=(n, n)).tocsr()

    return to_x, (lambda x: moved(x, 1.0))


def _block(rows: Array, columns: Array, values: Array, n: int) -> Any:
    """Sparse (n, n) with blocks (m, 3, 3), row by row, at rows and columns (m, 9)."""
    return csc_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)).tocsr()
