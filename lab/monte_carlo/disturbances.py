"""Known forces and torques, unknown disturbances, and their level: how well they are estimated, Monte Carlo.

    python -m lab.monte_carlo.disturbances [--seeds 20] [--workers 1] [--short] [--record FILE]

60 frames of 0.5 s, 300 landmarks, pixel noise 1 px, process noise 1e-8, both estimated. NEES: mean normalised
squared error, 1 is expected; coverage: share of the states' components within three standard deviations.

Levels: sequences of seven motions, 0.3 px, under levels drawn from the prior, and some without disturbances;
predictions of 60 s against the truth, levels of parts against each other and against the truth.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import gamma

from lab.command import RECORDS, Record, Seeds, Short, Workers, command
from lab.monte_carlo.bound import cold_start
from lab.monte_carlo.window import some_frames
from lab.presentation import numbers, print_table
from lab.record import Case, complete
from polhode.backend.outliers_and_noise.level_posterior import ACCELERATION, TORQUE
from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.backend.problem.level_prior import LevelPrior
from polhode.backend.window import SlidingWindow, frames_of
from polhode.compare.problem.sources import SCENES
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.planning.prediction import FinalState, power_shape, predict
from polhode.records.estimate import MotionEstimate
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, Vector, generate

RECORD = RECORDS / "pushes"
SEEN, AHEAD_S = 60, 60.0
"""Frames that are measured, and seconds that are predicted."""
STATES = ("r_N", "v_N", "R_NP", "w_P")
DRAWN, MOST_DECADES = "drawn levels", 1.5
"""Level over the stated one that is not exceeded: with stronger disturbances the target leaves the view."""
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
    kinds = {DRAWN: range(1)} if short else {DRAWN: range(5 * seeds), "no disturbances": draws}
    levels: list[Case] = [
        {"push": kind, "search": "level", "seed": seed} for kind, own in kinds.items() for seed in own
    ]
    unknown: list[Case] = [
        {"push": push, "search": search, "seed": seed}
        for push in list(UNKNOWN)[: 1 if short else None]
        for search in (("found",) if short else ("none", "found"))
        for seed in draws
    ]
    print_known(complete(record, known, measure, workers))
    print_unknown(complete(record, unknown, measure, workers))
    lines = complete(record, levels, measure_levels, workers)
    for kind in kinds:
        print_levels(kind, [line for line in lines if line["case"]["push"] == kind and "all" in line])


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


def measure_levels(case: Case) -> Case:
    """Levels of a sequence and of its parts, with their decades, and its prediction against the truth."""
    config = Backend(solver="gauss_newton", light_px=0.0, systematic_px=(0.0, 0.0, 0.0))
    prior, rng = LevelPrior.of(config), np.random.default_rng([case["seed"], 52])
    drawn = np.minimum(prior.decades * (rng.normal(size=2) - 1.0), MOST_DECADES)
    psd = prior.stated * 10.0**drawn * (case["push"] == DRAWN)
    scene = replace(
        list(SCENES.values())[case["seed"] % len(SCENES)], accel_psd=psd[0], torque_psd=psd[1],
        landmarks=800, sigma_uv_px=0.3, sigma_d_px=0.2, station_keeping=True,
    )  # fmt: skip
    last, seen = SEEN - 1 + round(AHEAD_S / scene.dt_s), np.arange(SEEN)
    scene = replace(scene, frames=last + 1, dropped=tuple(range(SEEN, last + 1)))
    whole, out = generate(scene, case["seed"]), {"truth": psd.tolist()}
    parts = {"all": seen, "first": seen[: SEEN // 2], "second": seen[SEEN // 2 :], "third": seen[::3]}
    for name, frames in parts.items():
        tracks = (part := some_frames(whole, frames)).tracks
        try:
            estimate = cold_start(part, config)[1]
        except RunFailure:
            continue
        noise = estimate.noise
        out[name] = [noise.accel_psd, noise.torque_psd, noise.accel_psd_decades, noise.torque_psd_decades]
        if name == "all":
            out |= prediction_errors(estimate, some_frames(whole, np.array([SEEN - 1, last])))
            window = SlidingWindow(tracks.rig, config)
            for measurements in frames_of(tracks):
                window.add(measurements)
            out["window"] = [*window.state.disturbances, *out[name][2:]]
    return out


def prediction_errors(estimate: MotionEstimate, ends: SyntheticSequence) -> Case:
    """Of the second of two frames, predicted from the first: errors (12,), sigmas, squares over regions."""
    mass, noise = estimate.mass, estimate.noise
    J_G, by_parameters = inertia_by_parameters(mass.J_G, FORMS[Backend().inertia])
    r_N, v_N, R_NP, w_P = (getattr(estimate, name)[-1] for name in STATES)
    assert estimate.covariance_last_body is not None
    last = FinalState(r_N, v_N, R_NP @ mass.R_GP.T, mass.R_GP @ w_P, J_G, mass.R_GP, by_parameters,
                      estimate.covariance_last_body)  # fmt: skip
    decades = noise.accel_psd_decades, noise.torque_psd_decades
    found = predict(last, [0.0, AHEAD_S], noise.accel_psd, noise.torque_psd, decades)
    error = state_errors(ends, replace(estimate, **{name: getattr(found, name) for name in STATES}))[0][1]
    squares = [
        error[k : k + 3] @ np.linalg.solve(found.covariance[1, k : k + 3, k : k + 3], error[k : k + 3])
        for k in range(0, 12, 3)
    ]
    sigma, over = np.sqrt(np.diag(found.covariance[1])), squares / found.region_sigmas[1] ** 2
    return {"error": error.tolist(), "sigma": sigma.tolist(), "squares": over.tolist()}


def print_levels(kind: str, lines: list[Case]) -> None:
    """Predictions by quantity, and levels by pairs of parts."""
    error, sigma, squares = (np.array([row[name] for row in lines]) for name in ("error", "sigma", "squares"))
    spread, missed, ratio = (np.sqrt(np.mean(each**2, axis=0)) for each in (sigma, error, error / sigma))
    rows: list[list[object]] = []
    for n, name in enumerate(("r [m]", "v [m/s]", "theta [rad]", "w [rad/s]")):
        own = slice(3 * n, 3 * n + 3)
        cells = [", ".join(numbers(each[own], ".2f")) for each in (spread / missed, 1.0 / ratio)]
        rows.append([name, f"{np.mean(squares[:, n] < 1.0):.1%}", *cells, f"{np.median(sigma[:, own]):.2g}"])
    head = f"{kind}: {len(lines)} predictions of 60 s | in the 99 % region | rms sigma / rms error"
    print_table(f"{head} | 1 / rms of error / sigma | median sigma", rows)
    pairs = [("first", "second"), ("third", "all"), ("window", "all"), ("all", "truth"), ("first", "truth")]
    print()
    print_table(
        "level of, and of | acceleration within 95 % | its decades | torque within 95 % | its decades",
        ([*pair, *agreement(lines, *pair)] for pair in pairs[: 5 if kind == DRAWN else 3]),
    )


def agreement(lines: list[Case], one: str, other: str) -> list[str]:
    """Of both levels: how many agree within both uncertainties, and the median uncertainty of the one."""
    both, cells = [line for line in lines if one in line and other in line], []
    for axis in (ACCELERATION, TORQUE):
        a, b = (np.array([line[name][axis::2] for line in both]).T for name in (one, other))
        shape = np.array([power_shape(decades) for decades in a[1]])
        inside = (
            np.abs(gamma.cdf(shape * b[0] / a[0], shape) - 0.5) < 0.475 if other == "truth"
            else np.abs(np.log10(a[0] / b[0])) < 1.96 * np.hypot(a[1], b[1])
        )  # fmt: skip
        cells += [f"{np.sum(inside)} of {len(both)}", f"{np.median(a[1]):.2f}"]
    return cells


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
