"""Errors of the calibration drawn from their prior: coverage and consistency, considered and estimated.

    python -m lab.monte_carlo.calibration [--seeds 10] [--workers 2] [--short] [--record FILE]

Twelve motions and bodies, 60 pairs, about 60 observations a pair, 0.2 px, cold starts. Half of the seeds have
the default prior, half five times its sigmas; "exact" are the same sequences without errors; others have a
focal length 0.3 % too long and a prior of 0.2 % on it. "considered": with the calibration as stated;
"estimated": after errors that the data determine were taken off the measurements.

NEES, over its expectation, is that of the last frame, so that runs are independent; * marks what lies outside
of its 95 % band. Coverage: determined components within three sigma, over all frames.
"""

from dataclasses import replace

import numpy as np

from lab.command import ROOT, Record, Seeds, Short, Workers, command
from lab.monte_carlo.accuracy import MOTIONS, QUANTITIES, good, with_band
from lab.monte_carlo.bound import COMPONENTS, cold_start, constants_errors, errors_of, normalised_squares
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.backend import with_calibration
from polhode.backend.uncertainty.self_calibration import MAX_SHARE
from polhode.config.backend_settings import Backend
from polhode.frontend.calibration_effects import calibration_effects
from polhode.frontend.rectification import make_rectifier
from polhode.geometry.lie import Array, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_body import best_half_turn
from polhode.records.calibration_prior import default_prior
from polhode.records.estimate import MotionEstimate
from polhode.records.metrics import States, coverage, state_scores
from polhode.records.rig_calibration import StereoCalibration
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import RIG, SyntheticSequence, generate, random_scene

PSD, NOISE_PX = 1e-8, 0.2
DRAWN = {"default prior": 1.0, "five times its sigmas": 5.0}
"""Sizes of the prior's sigmas, from which errors are drawn"""
CONDITIONS = {"exact": 1.0, **dict.fromkeys(DRAWN, 0.5), "focal length 0.3 % too long, prior 0.2 %": 0.3}
"""With the share of the seeds"""
SCENES = {**MOTIONS, **{f"random body {n}": random_scene(n) for n in range(4)}}
PARTS = ("considered", "estimated")
COVERED = ("position", "velocity", "attitude", "angular_velocity", "k", "axes", "com")


def main(
    seeds: Seeds = 10,
    workers: Workers = 2,
    short: Short = False,
    record: Record = ROOT / "runs/records/calibration",
) -> None:
    """Measure what the record lacks, print the tables."""
    numbers = {name: [*range(1 if short else max(1, round(x * seeds)))] for name, x in CONDITIONS.items()}
    # the sequences of drawn errors, without errors
    numbers["exact"] = [
        100 * n + k for n, name in enumerate(CONDITIONS) if name in DRAWN for k in numbers[name]
    ]
    cases: list[Case] = [
        {"condition": condition, "motion": motion, "seed": seed}
        for condition in CONDITIONS
        for seed in numbers[condition]
        for motion in list(SCENES)[: 1 if short else None]
    ]
    lines = good(complete(record, cases, measure, workers))
    groups = {name: [line for line in lines if line["case"]["condition"] == name] for name in CONDITIONS}
    groups["all drawn"] = [line for name in DRAWN for line in groups[name]]
    rows = [(name, part) for name in groups for part in PARTS[: 1 if name == "exact" else None]]
    consistent, covered = [], []
    for name, part in rows:
        of = [line[part] for line in groups[name]]
        consistent.append([name, part, len(of), *with_band(of)])
        shares = np.array([[each["covered"][n] for n in COVERED] for each in of], dtype=np.float64)
        along = np.sqrt(np.mean([each["along_mm"] ** 2 for each in of]))
        taken = sum(bool(line["errors"]) for line in groups[name]) if part == "estimated" else 0
        covered.append([name, part, taken, f"{along:.3g}", *(f"{x:.2%}" for x in np.nanmean(shares, axis=0))])
    print("\nNEES of the last frame over its expectation (95 % band)\n")
    print_table(("calibration", "its errors", "runs", *QUANTITIES), consistent)
    print("\nWithin three sigma; runs of which errors were taken off, position along the line of sight\n")
    print_table(("calibration", "its errors", "taken off", "RMSE along [mm]", *COVERED), covered)
    if found := [error for line in lines for error in line["errors"]]:
        print(f"\n{len(found)} errors estimated, off by {np.sqrt(np.mean(np.square(found))):.2f} sigma (rms)")


def measure(case: Case) -> Case:
    """One sequence, considered and estimated."""
    condition, number = case["condition"], list(SCENES).index(case["motion"])
    # other sequences in each condition
    seed = 100 * list(CONDITIONS).index(condition) + case["seed"]
    level = {"accel_psd": PSD, "torque_psd": PSD}
    scene = replace(SCENES[case["motion"]], frames=60, landmarks=900, detection=0.2, min_inliers=8, **level)
    scene = replace(scene, sigma_uv_px=NOISE_PX, sigma_d_px=NOISE_PX)
    sequence, z = generate(scene, 1000 * number + seed), np.zeros(0)
    if condition != "exact":
        sequence, z = with_errors(sequence, condition, [seed, number, 23])
    none = {"systematic_px": (0.0, 0.0, 0.0), "light_px": 0.0}
    config = Backend(solver="gauss_newton", process_noise="given", **level, **none)
    try:
        considered = cold_start(sequence, config)[1]
        tracks, estimated = with_calibration(sequence.tracks, considered, config, Silent())
    except RunFailure as failure:
        return {"failure": str(failure)}
    line: Case = {"considered": scores(sequence, considered, config), "errors": []}
    line["estimated"] = scores(sequence, estimated, config)
    part = estimated.calibration
    if part is not None and part.correction is not None and tracks.calibration is not None:
        # in units of the prior's sigmas, then of those that are left
        to_unit = np.linalg.pinv(sequence.tracks.calibration.factor)
        left, found = to_unit @ tracks.calibration.factor, to_unit @ part.correction.factor[:, 0]
        own = np.linalg.norm(left, axis=0) < MAX_SHARE
        line["errors"] = (np.linalg.pinv(left) @ (z - found))[own].tolist()
    return line


def with_errors(
    sequence: SyntheticSequence, condition: str, seed: list[int]
) -> tuple[SyntheticSequence, Array]:
    """The sequence as measured with a wrong calibration, and its errors (c,) in sigmas."""
    X_BC1, none = make_pose(np.eye(3), np.array([RIG.baseline_m, 0.0, 0.0])), np.zeros(4)
    stated = StereoCalibration(RIG.K, RIG.K, none, none, np.eye(4), X_BC1, RIG.width_px, RIG.height_px)
    prior = default_prior(stated)
    focal = np.array([2e-3 * RIG.focal_px * name.endswith((".fu", ".fv")) for name in prior.names])
    focal *= condition not in DRAWN
    covariance = DRAWN.get(condition, 1.0) ** 2 * prior.covariance + np.outer(focal, focal)
    stated = replace(stated, prior=replace(prior, covariance=covariance))
    effects, tracks = calibration_effects(stated, make_rectifier(stated), poses_stated=False), sequence.tracks
    assert effects is not None
    z = np.random.default_rng(seed).normal(size=effects.factor.shape[1])
    if focal.any():
        z = np.linalg.lstsq(effects.factor, -1.5 * focal)[0]
    X_RG = inverse_pose(sequence.X_NR) @ sequence.X_NG
    p_R = transform_points(X_RG[tracks.frame], sequence.p_G[tracks.landmark][:, None])[:, 0]
    uvd_px = tracks.uvd_px + effects.at(RIG, p_R) @ z
    return replace(sequence, tracks=replace(tracks, uvd_px=uvd_px, calibration=effects)), z


def scores(sequence: SyntheticSequence, found: MotionEstimate, config: Backend) -> Case:
    """NEES of the last frame and the constants; shares of the components within three sigma."""
    errors, mass, last = errors_of(found, sequence, config), found.mass, slice(-1, None)
    end = replace(found, R_NP=found.R_NP[last], w_P=found.w_P[last], covariance=found.covariance[last])
    ours, truth = (
        States(each.timestamps_ns, each.r_N, each.v_N, each.R_NP, each.w_P)
        for each in (found, sequence.truth)
    )
    of_states = state_scores(ours, truth, found.covariance, best_half_turn(ours.R_NP, truth.R_NP))[1]
    axes = constants_errors(found, sequence)[5:]
    constants = {
        "k": (errors.ratios, mass.cov_k),
        "axes": (axes, mass.cov_R_GP),
        "com": (errors.com_G, mass.cov_com_G),
    }
    squares = normalised_squares(replace(errors, states=errors.states[last]), end)
    known = np.isfinite(squares)
    return {
        "nees": np.where(known, squares, 0.0).tolist(),
        "freedom": (COMPONENTS * known).tolist(),
        "covered": of_states | {name: coverage(*pair) for name, pair in constants.items()},
        "along_mm": float(1e3 * errors.states[-1, 2]),
    }


if __name__ == "__main__":
    command(main)
