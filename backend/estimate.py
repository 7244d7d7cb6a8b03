"""Measurements and a first guess to motion, mass properties and covariance: full smoothing."""

from dataclasses import dataclass, replace

import numpy as np

from backend.attach import attach_wrench
from backend.gauss_newton import GaussNewton, Solution
from backend.hypotheses import inertia_hypotheses
from backend.initialize import frame_rates, robust_landmarks
from backend.iterate import Iterate
from backend.kernels import N_CAMERA
from backend.problem import TIGHT_GAUGE, MotionData, hold, motion_data
from backend.process_level import estimate_process_noise
from backend.program import MotionProgram
from backend.prune import settle
from backend.result import assemble
from polhode.config.backend import Backend
from polhode.errors import RunFailure
from polhode.lie import Array
from polhode.progress import Advance, Progress
from polhode.records import InitialMotion, MotionEstimate, StereoTracks

HYPOTHESIS_PASSES = (3, 3, 3, 2)
"""Iterations of the solves of one hypothesis; references and whitening are renewed between them."""
SAME_BASIN = 0.03
"""Two inertias (second moments of determinant 1) closer than this will end in the same minimum."""
MAX_PASSES = 4
PASS_TOLERANCE = 1e-7
"""Relative change of the cost between passes that ends them."""


def estimate_motion(
    tracks: StereoTracks, initial: InitialMotion, config: Backend, progress: Progress
) -> MotionEstimate:
    """Full smoothing over the sequence from several guesses of the inertia (``program.MotionProgram``).

    Raises RunFailure when no guess leads to a motion that most observations agree with.
    """
    data = motion_data(tracks, config)
    start, guesses = first_iterate(tracks, initial, data)
    with progress.stage("motion and inertia", len(guesses) + 4) as advance:
        trials = try_hypotheses(data, start, guesses, advance)
        best = min(trials, key=lambda name: trials[name].cost)
        data, kept, iterate, scales = settle(data, trials[best].iterate)
        advance()
        attached = attach_wrench(kept.data, kept.restrict(iterate)) if _pushed(data) else None
        if attached is not None:
            iterate = kept.expand(attached.iterate, iterate)
        if config.process_noise == "estimated":
            level = estimate_process_noise(kept.data, kept.restrict(iterate))
            iterate = kept.expand(level.iterate, iterate)
            data, kept = (
                replace(data, accel_psd=level.data.accel_psd, torque_psd=level.data.torque_psd),
                replace(kept, data=level.data),
            )
        advance()
        solver: GaussNewton | MotionProgram
        solver = MotionProgram(kept.data) if config.solver == "ipopt" else GaussNewton(kept.data)
        small, solution, iterations = refine(solver, kept.data, kept.restrict(iterate), config.max_iterations)
        advance()
        estimate = assemble(tracks, data, kept, kept.expand(small, iterate), scales, initial)
        advance()
    runner_up = {name: trial.cost - trials[best].cost for name, trial in trials.items() if name != best}
    runner_up |= attached.runner_up if attached is not None else {}
    outcome = replace(
        estimate.solver,
        name=solver.name,
        iterations=iterations,
        cost=solution.cost,
        converged=solution.converged,
        message=f"{solution.message}; best hypothesis: {best}",
        runner_up=runner_up,
    )
    warnings = [*estimate.warnings]
    if not solution.converged:
        warnings.append(f"the solver stopped before convergence: {solution.message}")
    return replace(estimate, solver=outcome, warnings=tuple(warnings))


def _pushed(data: MotionData) -> bool:
    return data.impulses is not None and bool(data.impulses.acting.any())


@dataclass(frozen=True)
class Trial:
    """Where one hypothesis led; the cost includes the normalisation of the process noise."""

    iterate: Iterate
    cost: float


def first_iterate(
    tracks: StereoTracks, initial: InitialMotion, data: MotionData
) -> tuple[Iterate, dict[str, Array]]:
    """Unknowns from the first guess of the poses, and the guesses of the inertia by name."""
    X_NG = tracks.X_NR @ initial.X_RG
    R_NG, p_NG = X_NG[:, :3, :3], X_NG[:, :3, 3]
    p_G, _ = robust_landmarks(tracks, initial.X_RG, initial.connected)
    com_G = np.median(p_G, axis=0)
    w_G = frame_rates(tracks.time_s, X_NG, initial.connected)
    use = np.flatnonzero(initial.connected)
    velocity = np.polyfit(tracks.time_s[use], (p_NG + R_NG @ com_G)[use], 1)[0]
    guesses = inertia_hypotheses(R_NG[use], w_G[use])
    xi, R_inertia = data.form.coordinates(np.eye(3))
    v_N = np.tile(velocity, (len(p_NG), 1))
    camera = np.zeros((len(p_NG), N_CAMERA)) if data.camera_is_noisy else None
    return Iterate(p_NG, R_NG, v_N, w_G, com_G, xi, R_inertia, p_G, camera), guesses


def try_hypotheses(
    data: MotionData, start: Iterate, guesses: dict[str, Array], advance: Advance
) -> dict[str, Trial]:
    """A brief solve from each guess that does not diverge; RunFailure when all do."""
    trials: dict[str, Trial] = {}
    at = start
    for name, second in guesses.items():
        trial = try_hypothesis(data, at, second, list(trials.values()))
        advance()
        if trial is None:
            continue
        trials[name] = trial
        # the poses and landmarks found first serve the others too
        at = min(trials.values(), key=lambda t: t.cost).iterate
    if not trials:
        raise RunFailure("no consistent motion: every hypothesis of the inertia diverged")
    return trials


def try_hypothesis(data: MotionData, start: Iterate, second: Array, found: list[Trial]) -> Trial | None:
    """A brief solve from one guess of the inertia; None when it diverges."""
    xi, R_inertia = data.form.coordinates(second)
    iterate, solver, cost = replace(start, xi=xi, R_inertia=R_inertia), GaussNewton(data), np.inf
    for iterations in HYPOTHESIS_PASSES:
        try:
            iterate = renew_inertia(data, iterate)
            held = hold(data, iterate)
            solution = solver.solve(held, iterate.vector(), iterations)
        except np.linalg.LinAlgError:
            return None
        iterate, cost = iterate.moved_to(solution.x), solution.cost + held.half_log_det
        for other in found:
            # the same basin: its cost is known already
            if np.abs(iterate.J_G(data.form) - other.iterate.J_G(data.form)).max() < SAME_BASIN:
                return other
    return Trial(iterate, float(cost)) if np.isfinite(cost) else None


def refine(
    solver: GaussNewton | MotionProgram, data: MotionData, iterate: Iterate, max_iterations: int
) -> tuple[Iterate, Solution, int]:
    """Solve, renew references and whitening, until the cost rests."""
    before, total = np.inf, 0
    for _ in range(MAX_PASSES):
        iterate = renew_inertia(data, iterate)
        solution = solver.solve(hold(data, iterate, TIGHT_GAUGE), iterate.vector(), max_iterations)
        iterate, total = iterate.moved_to(solution.x), total + solution.iterations
        if abs(before - solution.cost) <= PASS_TOLERANCE * max(solution.cost, 1.0):
            break
        before = solution.cost
    return iterate, solution, total


def renew_inertia(data: MotionData, iterate: Iterate) -> Iterate:
    """The same inertia with its reference rotation moved to it."""
    xi, R_inertia = data.form.coordinates(iterate.second_moments(data.form))
    return replace(iterate, xi=xi, R_inertia=R_inertia)
