"""Known forces and torques, and unknown disturbances: how well they are estimated, Monte Carlo.

    python -m lab.monte_carlo.disturbances [--seeds 20] [--workers 1] [--short] [--record FILE]

60 frames of 0.5 s, 300 landmarks, pixel noise 1 px, process noise 1e-8, both estimated. NEES: mean normalised
squared error, 1 is expected; coverage: share of the states' components within three standard deviations.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from lab.command import RECORDS, Record, Seeds, Short, Workers, command
from lab.monte_carlo.bound import cold_start
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.estimate import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, Vector, generate

RECORD = RECORDS / "pushes"
MOMENTS = np.array([3.0e-2, 2.4e-2, 1.8e-2])
FREE = SyntheticScene(
    frames=60, landmarks=300, detection=0.4, w_G=(0.3, 0.5, 0.35), J_G=np.diag(MOMENTS),
    accel_psd=1e-8, torque_psd=1e-8,
)  # fmt: skip
KNOWN = (
    (4.0, 5.0, (0.0, 0.0, 2e-2), (2e-3, 0.0, -1e-3)),
    (17.0, 3.0, (0.0, -1e-2, -2e-2), (0.0, 1.6e-3, 2e-3)),
)
UNKNOWN: dict[str, tuple[tuple[float, float, Vector, Vector], ...]] = {
    "no disturbance": (),
    "3 s, 9 mm/s and 23 deg/s": ((12.0, 3.0, (0.0, -1e-2, 1e-2), (0.0, 1.6e-3, 2e-3)),),
    "an impact of 0.25 s, 6 mm/s and 17 deg/s": ((12.0, 0.25, (0.0, -8e-2, 8e-2), (0.0, 1e-2, -2e-2)),),
    "4 s, 2 mm/s and 3 deg/s": ((12.0, 4.0, (0.0, -1e-3, 2e-3), (0.0, 1.6e-4, 2e-4)),),
}


def main(
    seeds: Seeds = 20,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    draws = range(1 if short else seeds)
    known: list[Case] = [{"push": "known", "search": "found", "seed": seed} for seed in draws]
    unknown: list[Case] = [
        {"push": push, "search": search, "seed": seed}
        for push in list(UNKNOWN)[: 2 if short else None]
        for search in (("found",) if short else ("none", "found"))
        for seed in draws
    ]
    print_known(complete(record, known, measure, workers))
    print_unknown(complete(record, unknown, measure, workers))


def measure(case: Case) -> Case:
    """One sequence: what the estimate says over what is true."""
    known = case["push"] == "known"
    pushes = KNOWN if known else UNKNOWN[case["push"]]
    sequence = generate(replace(FREE, pushes=pushes), 400 + case["seed"])
    if not known:
        sequence = replace(sequence, tracks=replace(sequence.tracks, wrench=None))
    config = Backend(solver="gauss_newton", unknown_wrench=case["search"], light_px=0.0)
    _, estimate = cold_start(sequence, config)
    errors, h = state_errors(sequence, estimate)
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    mass = estimate.mass
    k = np.array([mass.k1 - sequence.truth.k1, mass.k2 - sequence.truth.k2])
    squares = [e @ np.linalg.solve(C, e) / 12.0 for e, C in zip(errors, estimate.covariance, strict=True)]
    out: dict[str, Any] = {
        "nees": float(np.mean(squares)),
        "inside": float(np.mean(np.abs(errors) < 3.0 * sigma)),
        "k": (k / np.sqrt(np.diag(mass.cov_k))).tolist(),
        "error_k": k.tolist(),
        "found": [] if estimate.disturbances is None else whole_pushes(estimate, pushes, h),
    }
    if known:
        assert mass.mass_kg is not None and mass.sigma_mass_kg is not None
        assert mass.inertia_scale_kg_m2 is not None and mass.sigma_inertia_scale_kg_m2 is not None
        values = ((mass.mass_kg, mass.sigma_mass_kg, FREE.mass_kg),
                  (mass.inertia_scale_kg_m2, mass.sigma_inertia_scale_kg_m2, MOMENTS[1]))  # fmt: skip
        out["kilograms"] = [[(value - true) / sigma, sigma / true] for value, sigma, true in values]
    return out


def state_errors(sequence: SyntheticSequence, estimate: MotionEstimate) -> tuple[Array, Array]:
    """Errors (F, 12) in the order of the covariance, and the half-turn (3,) of the axes that fits best."""
    truth = sequence.truth
    turns = [log_so3(np.swapaxes(estimate.R_NP, 1, 2) @ truth.R_NP @ np.diag(h)) for h in HALF_TURNS]
    best = int(np.argmin([np.linalg.norm(turn) for turn in turns]))
    h = HALF_TURNS[best]
    errors = [truth.r_N - estimate.r_N, truth.v_N - estimate.v_N, turns[best], truth.w_P * h - estimate.w_P]
    return np.hstack(errors), np.asarray(h)


def whole_pushes(
    estimate: MotionEstimate, pushes: tuple[tuple[float, float, Vector, Vector], ...], h: Array
) -> list[list[float]]:
    """Of each push that was found (6,): error of the changes of velocity and rate over their sigmas."""
    assert estimate.disturbances is not None
    out = []
    for push in estimate.disturbances.impulses:
        change = np.zeros((2, 3))
        for start_s, duration_s, force_N, torque_P in pushes:
            if push.start_ns < 1e9 * (start_s + duration_s) and push.end_ns > 1e9 * start_s:
                change += duration_s * np.array([np.array(force_N) / FREE.mass_kg, torque_P / MOMENTS * h])
        dv = (push.delta_v_N - change[0]) / push.sigma_delta_v_N
        dw = (push.delta_w_P - change[1]) / push.sigma_delta_w_P
        out.append([*dv.tolist(), *dw.tolist(), float(change.any())])
    return out


def print_known(lines: list[Case]) -> None:
    """Mass and middle moment with a known wrench."""
    values = np.array([line["kilograms"] for line in lines])
    rows: list[list[object]] = []
    for n, name in enumerate(("mass", "middle moment")):
        z, sigma = values[:, n, 0], values[:, n, 1]
        rows.append(
            [name, f"{100 * np.median(sigma):.2f} %", f"{np.mean(z**2):.2f}", f"{np.abs(z).max():.1f}"]
        )
    rows.append(["states", "", f"{np.mean([line['nees'] for line in lines]):.2f}", ""])
    print_table("known forces and torques | sigma | NEES | largest error over sigma", rows)


def print_unknown(lines: list[Case]) -> None:
    """Runs that look for disturbances, and runs that do not."""
    head = (
        "unknown disturbance | search | found | false | states: NEES, coverage | rms error k1, k2 "
        "| disturbance: NEES"
    )
    print()
    measured = dict.fromkeys((line["case"]["push"], line["case"]["search"]) for line in lines)
    print_table(head, (_row(*each, lines) for each in measured))


def _row(name: str, search: str, lines: list[Case]) -> list[object]:
    rows = [line for line in lines if (line["case"]["push"], line["case"]["search"]) == (name, search)]
    found = [push for row in rows for push in row["found"]]
    true = np.array([push[:6] for push in found if push[6]])
    right = sum(any(push[6] for push in row["found"]) for row in rows)
    k = np.sqrt(np.mean(np.square([row["error_k"] for row in rows]), axis=0))
    nees, inside = (np.mean([row[key] for row in rows]) for key in ("nees", "inside"))
    return [
        name, search, f"{right}/{len(rows)}", len(found) - len(true), f"{nees:.2f}, {100 * inside:.1f} %",
        f"{k[0]:.4f}, {k[1]:.4f}", f"{np.mean(true**2):.2f}" if len(true) else "",
    ]  # fmt: skip


if __name__ == "__main__":
    command(main)
