"""Rotations of 100 to 350 degrees between pairs at equal intervals: is a wrong rate stated as the only one?

    python -m lab.monte_carlo.rotations [--scenes 40] [--workers 2] [--short] [--record FILE]

Random bodies, every other one with nearly equal moments, turn about an axis near the line of sight, so that
the same side stays in view. Right: within 5 % of the rate's length. "open": more than one hypothesis, or the
rate is not determined.
"""

from collections import Counter
from dataclasses import replace
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import ROOT, Record, Short, Workers, command
from lab.monte_carlo.bound import cold_start
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.config.backend_settings import Backend
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import SyntheticScene, generate, random_scene

OUTCOMES = (
    "stated and right",
    "open, the truth among them",
    "no answer",
    "open, without it",
    "stated and wrong",
)
RIGHT = 0.05
KINDS = ("any body", "nearly equal moments")


def main(
    scenes: Annotated[int, arg(help="Random scenes.")] = 40,
    workers: Workers = 2,
    short: Short = False,
    record: Record = ROOT / "runs/records/rotations",
) -> None:
    """Measure what the record lacks, print the table."""
    lines = complete(record, [{"seed": seed} for seed in range(2 if short else scenes)], measure, workers)
    head = ("body", "turn between pairs [deg]", *OUTCOMES)
    rows = []
    for kind in KINDS:
        for low, high in ((100, 180), (180, 270), (270, 350)):
            of = [line for line in lines if line["kind"] == kind and low <= line["turn_deg"] < high]
            count = Counter(line["outcome"] for line in of)
            rows.append((kind, f"{low} to {high}", *(str(count[outcome]) for outcome in OUTCOMES)))
    print_table(head, rows)


def scene_of(seed: int) -> tuple[float, SyntheticScene]:
    """Turn between pairs [deg] and the scene of a seed."""
    rng = np.random.default_rng([seed, 57])
    turn_deg = float(rng.uniform(100.0, 350.0))
    scene = random_scene(seed, frames=20, landmarks=200, detection=0.6, sigma_uv_px=0.3, sigma_d_px=0.3)
    scene = replace(scene, accel_psd=1e-9, torque_psd=1e-9, station_keeping=True)
    if seed % 2:
        scene = replace(scene, J_G=np.eye(3) + np.diag(rng.normal(0.0, 0.01, 3)))
    # where the first frame has the line of sight, in the body
    axis = generate(replace(scene, frames=3), seed).X_NG[0, 2, :3] + 0.15 * rng.normal(size=3)
    w_G = np.deg2rad(turn_deg) / scene.dt_s * axis / np.linalg.norm(axis)
    return turn_deg, replace(scene, w_G=tuple(w_G.tolist()))


def measure(case: Case) -> Case:
    """What is stated of one scene."""
    turn_deg, scene = scene_of(case["seed"])
    sequence = generate(scene, case["seed"])
    line = {"kind": KINDS[case["seed"] % 2], "turn_deg": turn_deg}
    try:
        _, estimate = cold_start(sequence, Backend(solver="gauss_newton"))
    except RunFailure:
        return line | {"outcome": "no answer"}
    true_N = sequence.truth.R_NP[-1] @ sequence.truth.w_P[-1]
    found = [each.R_NG @ each.w_G for each in estimate.hypotheses] or [estimate.R_NP[-1] @ estimate.w_P[-1]]
    right = min(np.linalg.norm(w_N - true_N) for w_N in found) < RIGHT * np.linalg.norm(true_N)
    is_open = bool(estimate.hypotheses) or not np.isfinite(estimate.covariance[-1][9:, 9:]).all()
    return line | {"outcome": OUTCOMES[(1 if right else 3) if is_open else (0 if right else 4)]}


if __name__ == "__main__":
    command(main)
