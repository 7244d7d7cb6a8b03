"""Rotations of 100 to 350 degrees between pairs: is a wrong rate stated as the only one?

    python -m lab.monte_carlo.rotations [--scenes 40] [--workers 2] [--short] [--record FILE]

Random bodies, every other one with nearly equal moments, turn about an axis near the line of sight, so that
the same side stays in view. Intervals are equal, or frames come up to 35 % of one early or late. Right:
within 5 % of the rate's length. "open": more than one hypothesis, or disturbances that make the run degraded.
Up to a revolution between pairs is stated (``backend.max_rpm``), or no limit.
"""

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import ROOT, Record, Short, Workers, command
from lab.monte_carlo.bound import cold_start
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.backend.estimate import SUSPICIOUS_RATIO
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
UNSTATED = "equal, no limit stated"
INTERVALS = {"equal": 0.0, "unequal": 0.35, UNSTATED: 0.0}
"""Share by which frames come early or late, at most"""


def main(
    scenes: Annotated[int, arg(help="Random scenes.")] = 40,
    workers: Workers = 2,
    short: Short = False,
    record: Record = ROOT / "runs/records/rotations",
) -> None:
    """Measure what the record lacks, print the table."""
    cases: list[Case] = [
        {"seed": seed, "intervals": each} for each in INTERVALS for seed in range(1 if short else scenes)
    ]
    lines = complete(record, cases, measure, workers)
    rows = []
    for intervals in INTERVALS:
        for kind in KINDS:
            some = [line for line in lines if (line["case"]["intervals"], line["kind"]) == (intervals, kind)]
            for low, high in ((100, 180), (180, 270), (270, 350)):
                of = [line for line in some if low <= line["turn_deg"] < high]
                count = Counter(line["outcome"] for line in of)
                rows.append((intervals, kind, f"{low} to {high}", *(str(count[each]) for each in OUTCOMES)))
    print_table(("intervals", "body", "turn between pairs [deg]", *OUTCOMES), rows)
    print_odds(lines)


def print_odds(lines: list[Case]) -> None:
    """Of the hypotheses with stated odds, how many hold the truth."""
    odds = np.array([pair for line in lines for pair in line["odds"]]).reshape(-1, 2)
    if not len(odds):
        return
    rows = []
    for low, high in pairwise((0.0, 0.1, 0.4, 0.6, 0.9, 1.01)):
        own = odds[(odds[:, 0] >= low) & (odds[:, 0] < high)]
        if len(own):
            rows.append(
                (
                    f"{low:g} to {min(high, 1.0):g}",
                    len(own),
                    f"{own[:, 0].mean():.2f}",
                    f"{own[:, 1].mean():.2f}",
                )
            )
    print()
    print_table(("stated odds", "hypotheses", "mean", "share that holds the truth"), rows, right_from=1)


def scene_of(seed: int, jitter: float) -> tuple[float, SyntheticScene]:
    """Turn between pairs [deg] and the scene of a seed."""
    rng = np.random.default_rng([seed, 57])
    turn_deg = float(rng.uniform(100.0, 350.0))
    scene = random_scene(seed, frames=20, landmarks=600, detection=0.6, sigma_uv_px=0.3, sigma_d_px=0.3)
    scene = replace(scene, accel_psd=1e-9, torque_psd=1e-9, station_keeping=True, jitter=jitter)
    if seed % 2:
        scene = replace(scene, J_G=np.eye(3) + np.diag(rng.normal(0.0, 0.01, 3)))
    # where the first frame has the line of sight, in the body
    axis = generate(replace(scene, frames=3), seed).X_NG[0, 2, :3] + 0.15 * rng.normal(size=3)
    w_G = np.deg2rad(turn_deg) / scene.dt_s * axis / np.linalg.norm(axis)
    return turn_deg, replace(scene, w_G=tuple(w_G.tolist()))


def measure(case: Case) -> Case:
    """What is stated of one scene."""
    turn_deg, scene = scene_of(case["seed"], INTERVALS[case["intervals"]])
    sequence = generate(scene, case["seed"])
    line = {"kind": KINDS[case["seed"] % 2], "turn_deg": turn_deg}
    try:
        max_rpm = None if case["intervals"] == UNSTATED else 60.0 / scene.dt_s
        _, estimate = cold_start(sequence, Backend(solver="gauss_newton", max_rpm=max_rpm))
    except RunFailure:
        return line | {"outcome": "no answer", "odds": []}
    true_N = sequence.truth.R_NP[-1] @ sequence.truth.w_P[-1]
    found = [each.R_NG @ each.w_G for each in estimate.hypotheses] or [estimate.R_NP[-1] @ estimate.w_P[-1]]
    rights = [bool(np.linalg.norm(w_N - true_N) < RIGHT * np.linalg.norm(true_N)) for w_N in found]
    is_open = bool(estimate.hypotheses) or (estimate.noise.times_stated or 0.0) > SUSPICIOUS_RATIO
    odds = [[each.odds, float(right)] for each, right in zip(estimate.hypotheses, rights, strict=False)]
    outcome = OUTCOMES[(1 if any(rights) else 3) if is_open else (0 if any(rights) else 4)]
    return line | {"outcome": outcome, "odds": odds}


if __name__ == "__main__":
    command(main)
