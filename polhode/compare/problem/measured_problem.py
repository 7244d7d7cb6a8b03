"""The frozen problem, the same for every solver: measurements, the fixed part of their cost, a cold start.

Observations, noise levels and process noise at the body's rate are those that polhode's back end chooses from
the same measurements, before the first solver starts. The unknowns are relative to the cold start, whose
attitudes are the reference and whose first pose defines G.
"""

from dataclasses import dataclass, replace
from itertools import permutations, product
from time import perf_counter

import numpy as np

from polhode.backend import initialize_motion
from polhode.backend.estimate import fit
from polhode.backend.initialization.multistart import initial_guesses
from polhode.backend.problem.inertia import FORMS, unit_determinant
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import LinearizationPoint, linearization_point
from polhode.backend.solvers.solve import MAX_PASSES, refine
from polhode.backend.uncertainty.principal_axes import axes_derivative
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError, RunFailure

GAUGE = 0.01
"""Standard deviation of G at the first frame [rad, body radii]: it costs nothing at the solution. With ten
times as much, solvers move slowly along the curved valley in which G is free; with a tenth, starts fail."""
OF_STATE, OF_CONSTANTS, OF_LANDMARK = (2e-3, 0.02, 2e-3, 0.02), (3e-3, 0.2), 2e-3
"""Standard deviations of a perturbed start: p_NG [m], theta [rad], v_N [m/s], w_G [rad/s]; com_G [m], xi;
p_G [m]."""
NEAR = 0.1
"""Share of these standard deviations for starts near the solution."""


@dataclass(frozen=True)
class MeasuredProblem:
    """Input of a solver's process."""

    name: str
    """Of the measurements"""
    data: MotionData
    fixed: LinearizationPoint
    cold: Array
    """(n,) the cold start, around ``fixed.reference``"""
    solution: Array
    """(n,) by Gauss-Newton from the back end's own estimate: for starts near it, unknown to the solvers"""
    truth: Truth | None
    prepared_s: float
    """Time to freeze the problem"""

    @property
    def size(self) -> dict[str, int]:
        """Numbers of frames, landmarks, observations, unknowns."""
        numbers = self.data.n_frames, self.data.n_landmarks, len(self.data.frame), len(self.cold)
        return dict(zip(("frames", "landmarks", "observations", "unknowns"), numbers, strict=True))

    def iterate(self, x: Array) -> Iterate:
        """The unknowns by name."""
        return self.fixed.reference.moved_to(x)

    def vector(self, at: Iterate) -> Array:
        """The common unknowns (n,) of an iterate, whose G is moved to the fixed first pose."""
        return coordinates(aligned(at, self.iterate(self.cold), self.data), self.fixed, self.data)

    def start(self, kind: str, seed: int) -> Array:
        """The start (n,): cold, perturbed, or near the solution."""
        if kind == "near":
            return self.perturbed(self.solution, seed, NEAR)
        return self.cold if kind == "cold" else self.perturbed(self.cold, seed)

    def perturbed(self, x: Array, seed: int, size: float = 1.0) -> Array:
        """``x`` (n,) with random errors of the above standard deviations times size."""
        at, rng = self.iterate(x), np.random.default_rng([seed, 91])
        out, n = x.copy(), at.n_states
        states = out[:n].reshape(-1, at.n_state)
        for k, sigma in enumerate(OF_STATE):
            states[:, 3 * k : 3 * k + 3] += size * sigma * rng.normal(size=(len(states), 3))
        out[n : n + 8] += size * np.repeat(OF_CONSTANTS, [3, 5]) * rng.normal(size=8)
        out[at.n_dense :] += size * OF_LANDMARK * rng.normal(size=len(out) - at.n_dense)
        return out


def aligned(at: Iterate, target: Iterate, data: MotionData) -> Iterate:
    """The same motion with G, and in it body and landmarks, moved to ``target``'s first pose."""
    R = at.R_NG[0].T @ target.R_NG[0]
    t = at.R_NG[0].T @ (target.p_NG[0] - at.p_NG[0])
    second = R.T @ at.second_moments(data.form) @ R
    xi, R_inertia = data.form.coordinates(second)
    return replace(
        at,
        p_NG=at.p_NG + at.R_NG @ t,
        R_NG=at.R_NG @ R,
        w_G=at.w_G @ R,
        com_G=R.T @ (at.com_G - t),
        xi=xi,
        R_inertia=R_inertia,
        p_G=(at.p_G - t) @ R,
        R_torque=None if at.R_torque is None else R.T @ at.R_torque,
    )


def coordinates(at: Iterate, fixed: LinearizationPoint, data: MotionData) -> Array:
    """An iterate in the same G as a vector (n,) about the fixed reference."""
    reference = fixed.reference
    x = at.vector()
    states = x[: at.n_states].reshape(-1, at.n_state)
    states[:, 3:6] = log_so3(np.swapaxes(reference.R_NG, 1, 2) @ at.R_NG)
    n = at.n_states
    if not np.allclose(at.R_inertia, reference.R_inertia):
        x[n + 3 : n + 8] = inertia_around(at.second_moments(data.form), data, reference)
    return x


def inertia_around(second: Array, data: MotionData, reference: Iterate) -> Array:
    """Coordinates (5,) of second moments around the reference rotation of the inertia."""
    if data.form.name == "second_moments":
        return data.form.coordinates(second)[0]
    values, axes = np.linalg.eigh(unit_determinant(second))
    # of all orders and half-turns of the axes, the one nearest to the reference
    best, out = np.inf, np.zeros(5)
    for order, signs in product(map(list, permutations(range(3))), HALF_TURNS):
        R = axes[:, order] * signs
        R = R * np.array([1.0, 1.0, np.linalg.det(R)])
        eta, d = log_so3(reference.R_inertia.T @ R), values[order]
        if np.linalg.norm(eta) < best:
            best = float(np.linalg.norm(eta))
            out = np.concatenate([[np.log(d[0] / d[2]), np.log(d[1] / d[2])], eta])
    return out


def freeze(
    name: str,
    tracks: StereoTracks,
    relative: RelativePoses | None,
    config: Backend,
    truth: Truth | None = None,
) -> MeasuredProblem:
    """The problem as polhode's back end poses it, with a cold start.

    Raises InputError without relative poses to start from; RunFailure when no motion is found.
    """
    if relative is None or not len(relative.i):
        raise InputError(f"{name}: the measurements contain no relative poses to start from; run it again")
    begin = perf_counter()
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            initial = initialize_motion(tracks, relative, config)
            data = motion_data(tracks, config)
            found = fit(data, tracks, initial, config, lambda: None).pruned
            start = initial_guesses(tracks, initial, data)[0].iterate
            kept = found.kept
            end, _, _ = refine(GaussNewton(kept.data), found.small.iterate, 200)
    except np.linalg.LinAlgError as error:
        raise RunFailure(f"{name}: no consistent motion: its equations have no solution") from error
    # unknowns of a known wrench have no cold start of their own
    start = replace(kept.restrict(start).iterate, wrench=end.wrench, R_torque=end.R_torque)
    if not np.isfinite(start.vector()).all():
        raise RunFailure(f"{name}: the first poses give no finite start")
    # whitening at the rates of the solution; references, gauge and prior at the start
    at_end = linearization_point(kept.data, aligned(end, start, kept.data), GAUGE)
    xi, R_inertia = kept.data.form.coordinates(np.eye(3))
    fixed = replace(
        at_end,
        reference=replace(start, xi=xi, R_inertia=R_inertia),
        A=kept.data.R_RN @ start.R_NG,
        prior=np.concatenate([at_end.prior[:4], R_inertia.T.ravel()]),
    )
    if truth is not None and len(truth.timestamps_ns) != tracks.n_frames:
        raise InputError(f"{name}: truth and measurements have different frames")
    x = coordinates(aligned(end, start, kept.data), fixed, kept.data)
    for _ in range(MAX_PASSES):
        x = GaussNewton(kept.data).solve(fixed, x, 200).x
    return MeasuredProblem(name, kept.data, fixed, start.vector(), x, truth, perf_counter() - begin)


def with_form(problem: MeasuredProblem, form_name: str, at: Iterate) -> MeasuredProblem:
    """The same problem in another form of the inertia, with the reference rotation of ``at``."""
    form = FORMS[form_name]
    old, data = problem.data.form, replace(problem.data, form=form)
    reference = problem.fixed.reference
    xi, R_inertia = form.coordinates(at.second_moments(old))
    fixed = replace(
        problem.fixed,
        reference=replace(reference, xi=xi, R_inertia=R_inertia),
        prior=np.concatenate([problem.fixed.prior[:4], R_inertia.T.ravel()]),
    )
    x = problem.cold.copy()
    n = reference.n_states
    x[n + 3 : n + 8] = xi
    return replace(problem, data=data, fixed=fixed, cold=x)


def ratios(at: Iterate, data: MotionData) -> tuple[float, float]:
    """k1, k2 of an iterate."""
    moments = axes_derivative(data.form, at).moments
    return float(np.log(moments[0] / moments[1])), float(np.log(moments[1] / moments[2]))
