"""Does rounding decide where a cold start ends: the same measurements on several kernels and threads of BLAS.

    python -m benchmarks.monte_carlo.rounding [--seeds 8] [--workers 2] [--short]

Sequences of 60 frames with 20 % gross outliers and 35 % of the relative poses wrong, each estimated in
processes of its own with OPENBLAS_CORETYPE Nehalem, Haswell and Zen, and with BLAS on one thread and on two
(a run has one; here the limit is set to two): the kernels sum in different orders. "largest difference" is
that of an attitude between any two of these, "error" the largest attitude error of a frame, "k" the errors of
k1 and k2 over their standard deviations, the worst setting each.
"""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from subprocess import CalledProcessError
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import Seeds, Short, Workers, command, in_process
from benchmarks.monte_carlo.bound import cold_start
from benchmarks.presentation import print_table
from polhode.config.backend_settings import Backend
from polhode.lie import Array, log_so3
from polhode.simulation.monte_carlo import SyntheticScene, generate
from polhode.threads import limit_threads

CORES, THREADS = ("Nehalem", "Haswell", "Zen"), (1, 2)
FIRST_SEED = 43


def main(
    seeds: Seeds = 8,
    workers: Workers = 2,
    short: Short = False,
    seed: Annotated[int | None, arg(help="Estimate this one here and print it as JSON.")] = None,
    threads: Annotated[int, arg(help="Of BLAS, with --seed.")] = 1,
) -> None:
    """Measure every sequence with every setting and print the table."""
    if seed is not None:
        limit_threads(threads)
        print(json.dumps(_estimate(seed)))
        return
    numbers = range(FIRST_SEED, FIRST_SEED + (1 if short else seeds))
    cases = list(product(numbers, CORES, THREADS))
    with ThreadPoolExecutor(workers) as pool:
        found = dict(zip(cases, pool.map(lambda case: _in_a_process(*case), cases), strict=True))
    rows = []
    for number in numbers:
        of_seed = [found[case] for case in cases if case[0] == number]
        failed = sum("error" in each for each in of_seed)
        if failed:
            rows.append((number, f"{failed} of {len(of_seed)} settings fail", "", "", ""))
            continue
        R = np.array([each["R_NG"] for each in of_seed]).reshape(len(of_seed), -1, 3, 3)
        apart = max(_largest_deg(a, b) for a in R for b in R)
        rows.append(
            (
                number,
                f"{of_seed[0]['connected']} of {R.shape[1]}",
                f"{apart:.1e}",
                f"{max(each['error_deg'] for each in of_seed):.2f}",
                f"{max(max(each['k']) for each in of_seed):.1f}",
            )
        )
    head = ("seed", "frames connected", "largest difference [deg]", "error [deg]", "k [sigma]")
    print_table(head, rows, right_from=2)


def _in_a_process(seed: int, core: str, threads: int) -> dict[str, Any]:
    kernels = os.environ | {"OPENBLAS_CORETYPE": core}
    try:
        call = ("benchmarks.monte_carlo.rounding", "--seed", seed, "--threads", threads)
        return dict(in_process(*call, environment=kernels))
    except CalledProcessError as error:
        return {"error": str(error)}


def _estimate(seed: int) -> dict[str, Any]:
    scene = SyntheticScene(
        frames=60, landmarks=400, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9]),
        sigma_uv_px=0.3, sigma_d_px=0.3,
    )  # fmt: skip
    sequence = generate(replace(scene, outliers=0.2, wrong_pairs=0.35), seed)
    config = Backend(solver="gauss_newton", systematic_px=(0.0, 0.0, 0.0), light_px=0.0)
    initial, estimate = cold_start(sequence, config)
    error = np.array([estimate.mass.k1 - sequence.truth.k1, estimate.mass.k2 - sequence.truth.k2])
    return {
        "connected": int(initial.connected.sum()),
        "R_NG": estimate.X_NG[:, :3, :3].tolist(),
        "error_deg": _largest_deg(sequence.X_NG[:, :3, :3], estimate.X_NG[:, :3, :3]),
        "k": np.abs(error / np.sqrt(np.diag(estimate.mass.cov_k))).tolist(),
    }


def _largest_deg(R_a: Array, R_b: Array) -> float:
    """Largest angle between two sequences of attitudes (F, 3, 3), each relative to its first frame."""
    offset = np.swapaxes(R_a, 1, 2) @ R_b
    return float(np.rad2deg(np.linalg.norm(log_so3(offset[0].T @ offset), axis=1)).max())


if __name__ == "__main__":
    command(main)
