"""The last step of the back end on stored measurements: both solvers from the same place, cost and time.

    python -m benchmarks.solvers.runs_by_solver RUN [RUN ...]

Each RUN is a folder that ``polhode run`` made: its measurements and its own configuration are read. What
comes before the last step (hypotheses, pruning, noise, pushes) is done once; then Gauss-Newton and IPOPT
solve as ``backend.estimate`` does, IPOPT with the time to build its program, and after them the default:
IPOPT, started where Gauss-Newton ends; its own iterations and seconds, the latter on the clock, stand in
brackets. "to gain" is what one more Gauss-Newton step promises where a solver stopped, over the cost. The
other seconds are those of the processor, on one thread.
"""

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from benchmarks.command import Runs, command
from benchmarks.presentation import table_head
from polhode.backend import initialize_motion
from polhode.backend.estimate import fit
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, linearization_point
from polhode.backend.solvers.solve import SolvedMotion, refine, solve
from polhode.config.backend_settings import Backend
from polhode.config.loader import load_config
from polhode.errors import InputError, RunFailure
from polhode.lie import Array
from polhode.pipeline.run_directory.archives import read_measurements, read_relative_poses
from polhode.records import ProgramEnd

SOLVERS = (partial(GaussNewton, line_search=True), MotionProgram)
"""As ``backend.solvers.solve`` makes them."""
COLUMNS = (
    "run", "frames", "observations", "Gauss-Newton: iterations", "s", "IPOPT: iterations", "s",
    "IPOPT takes times", "Gauss-Newton's cost over IPOPT's, - 1", "path apart [mm]",
    "default: solver, iterations, s (IPOPT's)", "its cost over the least, - 1",
)  # fmt: skip
SAME = 1e-6
"""Relative difference of the costs up to which they are called the same."""


@dataclass(frozen=True)
class Stopped:
    """Where a solver stopped."""

    name: str
    seconds: float
    iterations: int
    cost: float
    converged: bool
    message: str
    to_gain: float
    """What one more step promises, over the cost"""
    r_N: Array
    """(F, 3) path of the centre of mass [m]"""
    program: ProgramEnd | None
    """What IPOPT says, if it had a part"""


def main(runs: Runs) -> None:
    """One row per run, and remarks on solvers that did not converge."""
    print(table_head(COLUMNS))
    apart: list[float] = []
    for run in runs:
        try:
            data, found = solve_run(run)
        except (InputError, RunFailure, LinAlgError) as error:
            print(f"| {run.name} | {error} |" + " |" * (len(COLUMNS) - 2), flush=True)
            continue
        newton, ipopt, default = found
        apart.append(newton.cost / ipopt.cost - 1.0)
        shift_mm = 1e3 * np.abs(newton.r_N - ipopt.r_N).max()
        cells = [
            run.name,
            str(data.n_frames),
            str(len(data.frame)),
            *(cell for one in (newton, ipopt) for cell in (str(one.iterations), f"{one.seconds:.2f}")),
            f"{ipopt.seconds / newton.seconds:.1f}",
            f"{apart[-1]:+.1e}",
            f"{shift_mm:.4f}",
            f"{default.name}, {default.iterations}, {default.seconds:.2f} ({_of_ipopt(default)})",
            f"{default.cost / min(one.cost for one in found) - 1.0:.1e}",
        ]
        print(f"| {' | '.join(cells)} |")
        for one in found:
            if not one.converged or one.to_gain > SAME:
                print(f"  {run.name}, {one.name}: {one.message}; to gain {one.to_gain:.1e}", flush=True)
    higher, lower = sum(one > SAME for one in apart), sum(one < -SAME for one in apart)
    print(f"\n{len(apart)} runs; Gauss-Newton alone ends more than {SAME:.0e} above IPOPT in {higher},")
    print(f"more than that below it in {lower}.")


def solve_run(run: Path) -> tuple[MotionData, list[Stopped]]:
    """The last step of the back end by each of SOLVERS, and by the default.

    Raises InputError, RunFailure, LinAlgError.
    """
    config = load_config(run / "config.yaml", {}).backend
    tracks, relative = read_measurements(run), read_relative_poses(run)
    if relative is None:
        raise InputError(f"{run}: no relative poses are stored")
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        initial = initialize_motion(tracks, relative, config)
        start = fit(motion_data(tracks, config), tracks, initial, config, lambda: None).pruned.small
        data = start.data
        out = []
        for make in SOLVERS:
            begin = time.process_time()
            solver = make(data)
            found = refine(solver, start.iterate, config.max_iterations, config.max_seconds)
            ended = SolvedMotion(solver.name, *found)
            out.append(_stopped(data, ended, time.process_time() - begin))
        begin = time.process_time()
        ended = solve(start, config.model_copy(update={"solver": Backend().solver}))
        out.append(_stopped(data, ended, time.process_time() - begin))
    return data, out


def _of_ipopt(ended: Stopped) -> str:
    """Iterations and seconds of IPOPT, on the clock."""
    program = ended.program
    return "no part" if program is None else f"{program.iterations}, {program.seconds:.2f}"


def _stopped(data: MotionData, ended: SolvedMotion, seconds: float) -> Stopped:
    at, solution = ended.iterate, ended.solution
    outcome = (solution.cost, solution.converged, solution.message)
    r_N = at.p_NG + at.R_NG @ at.com_G
    return Stopped(
        ended.solver, seconds, ended.iterations, *outcome, to_gain(data, at), r_N, solution.program
    )


def to_gain(data: MotionData, at: Iterate) -> float:
    """Decrease that the quadratic model promises for one step, over the cost; NaN where it has none."""
    solver, fixed = GaussNewton(data), linearization_point(data, at, TIGHT_GAUGE)
    system = solver.normal_equations(fixed, at.vector())
    S, gradient, C_inv = solver.reduced(system)
    try:
        dense = 0.5 * gradient @ cho_solve(cho_factor(S, lower=True), gradient)
    except LinAlgError:
        return float("nan")
    marks = 0.5 * np.einsum("li,lij,lj->", system.h, C_inv, system.h)
    return float((dense + marks) / system.cost)


if __name__ == "__main__":
    command(main)
