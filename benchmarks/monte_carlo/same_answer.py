"""Do both solvers and both forms of the inertia end in the same answer? Cold starts at the thesis's size.

    python -m benchmarks.monte_carlo.same_answer [--seeds 1] [--workers 2] [--short] [--record FILE]

The sequences of ``benchmarks/monte_carlo/accuracy.py`` (six motions, 1 px and 0.3 px), process noise given,
each four times: by Gauss-Newton and by IPOPT, with ``backend.inertia`` ``second_moments`` and
``ratios_axes``. "one problem": the whole data with the stated noise, from the truth; relative difference of
the final cost from that of Gauss-Newton with ``second_moments``. "cold start": all that a run does, with its
own noise of the pixels and observations left out; observations left out otherwise, and the largest difference
of a state, k1 or k2 over its standard deviation.
"""

from dataclasses import replace

import numpy as np

from benchmarks.command import RECORDS, Record, Seeds, Short, Workers, command
from benchmarks.monte_carlo.accuracy import MOTIONS, NOISES_PX
from benchmarks.monte_carlo.bound import cold_start, true_iterate
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.lie import Array, log_so3
from polhode.records import MotionEstimate
from polhode.rigid_body import nearest_half_turn
from polhode.simulation.monte_carlo import generate

RECORD = RECORDS / "same_answer"
N_MOTIONS = 6
SOLVERS, FORMS = ("gauss_newton", "ipopt"), ("second_moments", "ratios_axes")
WANTED = 1e-6
"""Relative difference of the costs."""


def main(
    seeds: Seeds = 1,
    workers: Workers = 2,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the table."""
    cases: list[Case] = [
        {"motion": motion, "noise_px": noise, "seed": seed}
        for seed in range(1 if short else seeds)
        for motion in list(MOTIONS)[: 1 if short else N_MOTIONS]
        for noise in NOISES_PX[: 1 if short else None]
    ]
    print_costs(complete(record, cases, measure, workers))


def measure(case: Case) -> Case:
    """One sequence four times: costs, and differences from the first."""
    noise = case["noise_px"]
    scene = replace(MOTIONS[case["motion"]], sigma_uv_px=noise, sigma_d_px=noise)
    sequence = generate(scene, 7000 + case["seed"])
    found: dict[str, MotionEstimate] = {}
    costs: dict[str, float] = {}
    for solver in SOLVERS:
        for form in FORMS:
            given = {"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd}
            config = Backend.model_validate(
                {"solver": solver, "inertia": form, "process_noise": "given", **given}
            )
            name = f"{solver}, {form}"
            data = motion_data(sequence.tracks, config)
            program = MotionProgram(data) if solver == "ipopt" else GaussNewton(data)
            costs[name] = refine(program, true_iterate(sequence, config), 50)[1].cost
            _, found[name] = cold_start(sequence, config)
    first = next(iter(found.values()))
    return {
        name: {
            "cost": costs[name],
            "iterations": estimate.solver.iterations,
            "converged": estimate.solver.converged,
            "left_out_otherwise": int(np.sum((estimate.inlier_weight > 0.0) != (first.inlier_weight > 0.0))),
            "sigmas_apart": largest_difference(first, estimate),
        }
        for name, estimate in found.items()
    }


def largest_difference(first: MotionEstimate, other: MotionEstimate) -> float:
    """Of the states of all frames and of k1, k2, over the standard deviations of the first.

    Both have their axes in the order of the moments; of the four half-turns the nearest is taken.
    """
    turn = nearest_half_turn(other.R_NP[0], first.R_NP[0])
    states: Array = np.concatenate(
        [
            other.r_N - first.r_N,
            other.v_N - first.v_N,
            log_so3(np.swapaxes(first.R_NP, 1, 2) @ other.R_NP @ turn),
            other.w_P @ turn - first.w_P,
        ],
        axis=1,
    )
    sigma = np.sqrt(np.diagonal(first.covariance, axis1=1, axis2=2))
    a, b = first.mass, other.mass
    of_ratios = np.array([b.k1 - a.k1, b.k2 - a.k2]) / np.sqrt(np.diagonal(a.cov_k))
    return float(np.max(np.abs([*(states / sigma).ravel(), *of_ratios])))


def print_costs(lines: list[Case]) -> None:
    """One row for each solver and form: the worst over all sequences."""
    names = [f"{solver}, {form}" for solver in SOLVERS for form in FORMS]
    rows: list[list[object]] = []
    worst = 0.0
    for name in names:
        some = [line[name] for line in lines]
        difference = max(abs(line[name]["cost"] / line[names[0]]["cost"] - 1.0) for line in lines)
        worst = max(worst, difference)
        otherwise = [one["left_out_otherwise"] for one in some if one["left_out_otherwise"]]
        rows.append([
            name, len(some), f"{difference:.1e}", sum(one["converged"] for one in some),
            f"{np.mean([one['iterations'] for one in some]):.1f}",
            f"{sum(otherwise)} in {len(otherwise)} sequences",
            f"{max(one['sigmas_apart'] for one in some):.1e}",
        ])  # fmt: skip
    head = (
        "solver, inertia | sequences | one problem: cost difference | cold start: converged | iterations "
        "| observations left out differently | difference in sigmas"
    )
    print_table(head, rows)
    print(f"\nOn one problem the costs differ by at most {worst:.1e}, goal at most {WANTED:.0e}.")


if __name__ == "__main__":
    command(main)
