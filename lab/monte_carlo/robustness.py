"""Gross outliers, a gap of ten seconds, an inspector that jitters: Monte Carlo on measurements, cold start.

    python -m lab.monte_carlo.robustness [--seeds 12] [--workers 1] [--short] [--record FILE]

80 pairs, 600 landmarks, about 50 observations a pair, 0.5 px, disturbances of 1e-7; 12 sequences of each of
five motions, the same in every row but for what is wrong. Disturbances and noise of the pixels are estimated,
from a stated 1e-6.

"outliers": 30 % of the observations are off by up to 40 px, 10 % of the relative poses are wrong. "gap": no
measurement in the ten seconds in the middle. "jitter": the inspector swings within a dead band of 4 mm and
0.4 degrees; its poses are known exactly, or reported with noise of a stated sigma (0.5 mm, 0.02 degrees).

"converge" and "falsely" are those of ``lab/monte_carlo/convergence.py``; bound, NEES and its 95 % band
those of ``lab/monte_carlo/accuracy.py``. What the information at the truth does not determine does not
count.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lab.command import RECORDS, Record, Seeds, Short, Workers, command
from lab.monte_carlo.accuracy import MOTIONS, QUANTITIES, good, with_band
from lab.monte_carlo.bound import (
    cold_start,
    constants_errors,
    cramer_rao_bound,
    determined_at_truth,
    errors_of,
    normalised_squares,
    rate_along_N,
)
from lab.monte_carlo.convergence import missed, print_failures, stated_sigma, wrong
from lab.monte_carlo.disturbances import state_errors
from lab.presentation import numbers, print_table
from lab.record import Case, complete
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import inverse_pose, log_so3
from polhode.records.estimate import MotionEstimate
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

RECORD = RECORDS / "robustness"
"""Kept in the repository, like that of the accuracy."""
CHOSEN = (
    "spin of 10 RPM near the middle axis (TS38)",
    "flip of a box, 8 RPM",
    "minor-axis wobble, 8 RPM",
    "triaxial tumble, 7 RPM",
    "fast tumble, 20 RPM, 4 pairs a second",
)
FRAMES, NOISE_PX, PSD, GAP_S = 80, 0.5, 1e-7, 10.0
OUTLIERS, WRONG_PAIRS = 0.3, 0.1
DEADBAND_M, DEADBAND_RAD = (4e-3, 1e-3), (np.deg2rad(0.4), np.deg2rad(0.3))
SIGMA_P_M, SIGMA_THETA_RAD = 5e-4, float(np.deg2rad(0.02))
CONDITIONS = (
    "no fault", "outliers", "gap", "gap and outliers", "jitter, reported poses", "jitter, exact poses",
)  # fmt: skip
NEEDS = (range(3), range(3), range(5, 8), range(0), range(3), range(3, 8))
"""Of each of them: which of convergence.NAMES must be determined at the truth for it to count."""
PLACED_M, PLACED_RAD = 5e-3, float(np.deg2rad(2.0))
"""Frames behind a gap are right when the body is so near to where it is, as seen from the first frame."""
SHORT_MOTIONS, SHORT_SEEDS = 1, 1


def main(
    seeds: Seeds = 12,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    motions = CHOSEN[:SHORT_MOTIONS] if short else CHOSEN
    # seeds outermost: an interrupted benchmark has as many of each row
    cases: list[Case] = [
        {"condition": condition, "motion": motion, "seed": seed}
        for seed in range(SHORT_SEEDS if short else seeds)
        for motion in motions
        for condition in CONDITIONS
    ]
    print_tables(complete(record, cases, measure, workers))


def gap_of(scene: SyntheticScene) -> slice:
    """The frames of ten seconds in the middle."""
    count = round(GAP_S / scene.dt_s)
    start = (scene.frames - count) // 2
    return slice(start, start + count)


def scene_of(condition: str, motion: str) -> SyntheticScene:
    """The motion with what is wrong."""
    scene = replace(MOTIONS[motion], frames=FRAMES, landmarks=600, min_inliers=8)
    scene = replace(scene, sigma_uv_px=NOISE_PX, sigma_d_px=NOISE_PX, accel_psd=PSD, torque_psd=PSD)
    if "outliers" in condition:
        scene = replace(scene, outliers=OUTLIERS, wrong_pairs=WRONG_PAIRS)
    if "gap" in condition:
        scene = replace(scene, dropped=tuple(range(FRAMES)[gap_of(scene)]))
    if "jitter" in condition:
        scene = replace(scene, deadband_m=DEADBAND_M, deadband_rad=DEADBAND_RAD)
    if "reported" in condition:
        scene = replace(scene, sigma_camera_p_m=SIGMA_P_M, sigma_camera_theta_rad=SIGMA_THETA_RAD)
    return scene


def measure(case: Case) -> Case:
    """One sequence: errors and sigmas of the constants, squares over the frames, signed means."""
    scene = scene_of(case["condition"], case["motion"])
    # the same motion and landmarks in every condition
    sequence = generate(scene, 1000 * CHOSEN.index(case["motion"]) + case["seed"])
    config = Backend(solver="gauss_newton", systematic_px=(0.0, 0.0, 0.0), light_px=0.0)
    given = Backend(accel_psd=PSD, torque_psd=PSD)
    known = determined_at_truth(sequence, given)
    start = time.perf_counter()
    try:
        _, estimate = cold_start(sequence, config)
    except RunFailure as failure:
        return {"failure": str(failure), "determined_at_truth": known}
    seconds = time.perf_counter() - start
    errors = errors_of(estimate, sequence, config)
    counts = np.array([all(known[n] for n in needs) for needs in NEEDS])
    noise = estimate.noise

    def squares(frames: slice) -> Case:
        """Of the states in these frames and of the constants."""
        of_frames = replace(errors, states=errors.states[frames])
        part = replace(
            estimate,
            R_NP=estimate.R_NP[frames],
            w_P=estimate.w_P[frames],
            covariance=estimate.covariance[frames],
        )
        bound = cramer_rao_bound(sequence, given, frames)
        return {
            "squares": np.where(counts, of_frames.mean_squares, np.nan).tolist(),
            "bound": bound.mean_squares.tolist(),
            "nees": np.where(counts, normalised_squares(of_frames, part), np.nan).tolist(),
            "freedom": bound.freedom.tolist(),
            "inside": inside(sequence, estimate, frames),
        }

    out: Case = {
        "errors": constants_errors(estimate, sequence).tolist(),
        "sigma": stated_sigma(estimate),
        "determined_at_truth": known,
        **squares(slice(None)),
        "pixels": noise.pixel_sigma_px / NOISE_PX,
        "levels": [noise.accel_psd / PSD, noise.torque_psd / PSD],
        "seconds": round(seconds, 2),
    }
    if scene.dropped:
        gap = gap_of(scene)
        out["gap"] = {
            **squares(gap),
            "sigma": sigma_about(estimate, gap),
            "behind": placed_off(sequence, estimate, gap.stop),
        }
    return out


def inside(sequence: SyntheticSequence, estimate: MotionEstimate, frames: slice) -> float:
    """Share of the states' determined components within three standard deviations."""
    errors = np.abs(state_errors(sequence, estimate)[0][frames])
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)[frames])
    return float(np.mean((errors < 3.0 * sigma)[np.isfinite(sigma)]))


def sigma_about(estimate: MotionEstimate, gap: slice) -> list[list[float]]:
    """Sigma of r [m], attitude [rad] and w along N [rad/s], beside the gap and the largest in it."""
    T = rate_along_N(estimate.R_NP, estimate.w_P)
    covariance = T @ estimate.covariance @ np.swapaxes(T, 1, 2)
    variance = np.diagonal(covariance, axis1=1, axis2=2).reshape(-1, 4, 3)[:, [0, 2, 3]]
    sigma = np.sqrt(variance.mean(axis=2))
    beside = np.delete(sigma, np.arange(len(sigma))[gap], axis=0)
    return [np.median(beside, axis=0).tolist(), sigma[gap].max(axis=0).tolist()]


def placed_off(sequence: SyntheticSequence, estimate: MotionEstimate, first: int) -> list[float]:
    """Largest error of position [m] and attitude [rad] from a frame on, G fixed at the first frame."""
    D = inverse_pose(sequence.X_NG) @ estimate.X_NG
    # where G itself was put at the first frame is free
    off = (sequence.X_NG @ D @ inverse_pose(D[0]))[first:]
    shift = np.linalg.norm((off - sequence.X_NG[first:])[:, :3, 3], axis=1)
    turn = log_so3(np.swapaxes(sequence.X_NG[first:, :3, :3], 1, 2) @ off[:, :3, :3])
    return [float(shift.max()), float(np.linalg.norm(turn, axis=1).max())]


def print_tables(lines: list[Case]) -> None:
    """Convergence, errors, consistency, the gap; then what went wrong."""
    rows = [(name, [line for line in lines if line["case"]["condition"] == name]) for name in CONDITIONS]
    print("\nConvergence, and the noise that was estimated over the true one (median)\n")
    _print(("", "runs", "failed", "determined at the truth", "of them converge", "falsely", "pixels",
            "acceleration", "torque", "seconds"), rows, _convergence)  # fmt: skip
    print("\nRMSE over the bound of the same measurements; in brackets over the RMSE without a fault\n")
    reference = good(rows[0][1])
    _print(("", *QUANTITIES), rows, lambda some: _over_bound(some, reference))
    print("\nNEES over its expectation, in brackets the 95 % band; states within three sigma\n")
    _print(("", *QUANTITIES, "inside"), rows, _consistency)
    print("\nWithin the gap: RMSE over the bound, and NEES\n")
    gaps = [row for row in rows if "gap" in row[0]]
    _print(("", *(f"{q}, {what}" for what in ("RMSE", "NEES") for q in QUANTITIES[:4]), "inside"), gaps, _gap)
    print("\nMedian sigma beside the gap and at its largest within it, and the frames behind the gap\n")
    _print(("", "r mm", "attitude deg", "w deg/s", "runs with right poses", "largest error"), gaps, _growth)
    print_failures(lines)


def _print(
    head: tuple[str, ...], rows: list[tuple[str, list[Case]]], cells: Callable[[list[Case]], list[str]]
) -> None:
    print_table(head, ([name, *cells(lines)] for name, lines in rows))


def _convergence(lines: list[Case]) -> list[str]:
    runs, known = good(lines), [line for line in lines if all(line["determined_at_truth"])]
    converge = sum(not missed(line) for line in known)
    share = f"{converge} ({converge / max(len(known), 1):.0%})"
    false = sum(int(wrong(line).sum()) for line in runs)
    levels = np.median([[line["pixels"], *line["levels"]] for line in runs], axis=0)
    seconds = np.median([line["seconds"] for line in runs])
    counts = (len(lines), len(lines) - len(runs), len(known), share, false)
    return [*map(str, counts), *numbers(levels, ".2f"), f"{seconds:.1f}"]


def _over_bound(lines: list[Case], reference: list[Case]) -> list[str]:
    """Every sequence with its own bound; against the reference the sequences that both have."""
    runs, by_name = good(lines), {_sequence(line): line for line in reference}
    over = np.sqrt(np.nanmean([np.divide(line["squares"], line["bound"]) for line in runs], axis=0))
    pairs = [(line, by_name[_sequence(line)]) for line in runs if _sequence(line) in by_name]
    ours, theirs = (
        np.nanmean([np.divide(pair[n]["squares"], pair[1]["bound"]) for pair in pairs], axis=0)
        for n in (0, 1)
    )
    return [f"{a:.3f} ({b:.2f})" for a, b in zip(over, np.sqrt(ours / theirs), strict=True)]


def _consistency(lines: list[Case]) -> list[str]:
    runs = good(lines)
    return [*with_band(runs), f"{np.mean([line['inside'] for line in runs]):.2%}"]


def _gap(lines: list[Case]) -> list[str]:
    parts = [line["gap"] for line in good(lines)]
    over = np.sqrt(np.nanmean([np.divide(part["squares"], part["bound"]) for part in parts], axis=0))
    share = np.mean([part["inside"] for part in parts])
    return [*numbers(over[:4], ".3f"), *with_band(parts)[:4], f"{share:.2%}"]


def _growth(lines: list[Case]) -> list[str]:
    parts = [line["gap"] for line in good(lines)]
    beside, within = np.nanmedian([part["sigma"] for part in parts], axis=0) * [1e3, *[np.rad2deg(1.0)] * 2]
    off = np.array([part["behind"] for part in parts])
    right = np.all(off < [PLACED_M, PLACED_RAD], axis=1).sum()
    worst = f"{1e3 * off[:, 0].max():.2f} mm, {np.rad2deg(off[:, 1].max()):.2f} deg"
    return [
        *(f"{a:.2g} -> {b:.2g}" for a, b in zip(beside, within, strict=True)),
        f"{right} of {len(lines)}",
        worst,
    ]


def _sequence(line: Case) -> tuple[str, int]:
    return line["case"]["motion"], line["case"]["seed"]


if __name__ == "__main__":
    command(main)
