"""One sequence live and as a batch: what is measured, and the rows of the tables."""

import os
from functools import partial
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np

from benchmarks.command import DEFAULT, ROOT
from benchmarks.record import Case
from polhode.config.frontend_settings import Features
from polhode.config.loader import load_config
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.features.keypoints import enlarge
from polhode.frontend.rectification import Rectifier, rectified_pair, target_crop
from polhode.metrics import NEES, States, expected_range, motion_errors, nees, state_errors, truth_at
from polhode.pipeline.context import rectifier_of
from polhode.pipeline.evaluation import truth_of_frames
from polhode.pipeline.live.run_live import LiveReport, run_live
from polhode.pipeline.run import run
from polhode.pipeline.run_directory.archives import read_online
from polhode.pipeline.run_directory.trajectory_file import Trajectory, read_trajectory
from polhode.processes import in_order, worker_count
from polhode.progress import Silent

SAMPLE = ROOT / "sample"
SCENES = (
    "configs/ts38.yaml",
    *(f"configs/scenes/{name}.yaml" for name in ("asteroid", "major_axis", "pure_spin")),
)
STAGES = ("features", "matching", "window", "latency")
QUANTITIES = ("position", "velocity", "attitude", "angular_velocity")
SAME = ("trajectory.csv", "landmarks.ply", "mesh.ply")
"""Files by which the final answer of a stream is compared with that of a batch run."""
TIMES = (
    "sequence | pairs | dropped | features [s] | matching [s] | window [s] | arrival to state [s] | "
    "last pair to report [s] | of the processor [s] | load before"
)
ERRORS = (
    "sequence | estimate | position [mm] | velocity [mm/s] | w [deg/s] | r / sigma | same bytes as the batch"
)
NEES_HEAD = "sequence | live states: NEES r | v | attitude | w | band of each"
BATCH = (
    "sequence | film [s] | batch [s] | over film | SIFT alone [s] | over SIFT | "
    "of the processor, one process [s] | load before"
)


def measure(case: Case) -> Case:
    """One sequence, live and as a batch, then SIFT alone."""
    source, config = Path(case["sequence"]), load_config(ROOT / DEFAULT)
    sequence = open_sequence(source)
    interval_s = 1e-9 * float(np.median(np.diff(sequence.timestamps_ns)))
    live_run, batch_run = (ROOT / "runs" / f"{kind}_{source.name}" for kind in ("live", "batch"))
    load = [os.getloadavg()[0]]
    _, live = run_live(
        config, source, live_run, Silent(), case["rate_hz"] * interval_s, overwrite=True, even_if_failed=True
    )
    load.append(os.getloadavg()[0])
    start, processor_s = perf_counter(), process_time()
    run(config, source, batch_run, Silent(), overwrite=True, even_if_failed=True)
    batch_s, processor_s = perf_counter() - start, process_time() - processor_s
    sift_s = sift_seconds(sequence, config.frontend.features, worker_count(config.runtime.workers))
    same = all((live_run / name).read_bytes() == (batch_run / name).read_bytes() for name in SAME)
    final = read_trajectory(batch_run / "trajectory.csv")
    return {
        "pairs": len(live.processed),
        "dropped": live.dropped,
        "report_s": live.report_s,
        "report_processor_s": live.report_processor_s,
        "seconds": stage_times(live),
        "errors": {
            "live": errors_of(live_run, "trajectory_online.csv", source, final),
            "window of the batch": errors_of(batch_run, "trajectory_online.csv", source, final),
            "final": errors_of(live_run, "trajectory.csv", source, final),
        },
        "nees": live_nees(live_run, source),
        "same": same,
        "film_s": float(1e-9 * (sequence.timestamps_ns[-1] - sequence.timestamps_ns[0]) + interval_s),
        "batch_s": batch_s,
        "processor_s": processor_s,
        "sift_s": sift_s,
        "load": load,
    }


def sift_seconds(sequence: StereoSequence, config: Features, workers: int) -> float:
    """Time in which so many processes find and describe key points in all enlarged crops [s]."""
    job = partial(_sift_of_pair, sequence, rectifier_of(sequence), config)
    return sum(in_order(job, range(len(sequence)), workers)) / workers


def _sift_of_pair(sequence: StereoSequence, rectifier: Rectifier, config: Features, k: int) -> float:
    """Seconds that SIFT takes for one pair, without reading and rectifying it."""
    pair, seconds = rectified_pair(sequence, rectifier, k), 0.0
    detector = cv2.SIFT.create(contrastThreshold=config.contrast_threshold, enable_precise_upscale=True)
    for image, mask in ((pair.left, pair.mask_left), (pair.right, pair.mask_right)):
        crop = target_crop(mask)
        if crop is None:
            continue
        enlarged = enlarge(image, crop, config).image
        start = perf_counter()
        detector.detectAndCompute(enlarged, None)
        seconds += perf_counter() - start
    return seconds


def stage_times(live: LiveReport) -> dict[str, list[float]]:
    """Median and 95th percentile of each stage and of the whole latency [s]."""
    found = {stage: [each.state.seconds[stage] for each in live.processed] for stage in STAGES[:-1]}
    found["latency"] = [each.latency_s for each in live.processed]
    return {stage: [float(np.percentile(values, q)) for q in (50, 95)] for stage, values in found.items()}


def errors_of(run_folder: Path, name: str, sequence: Path, final: Trajectory) -> list[float]:
    """Root mean square errors of position [mm], velocity [mm/s] and rate [deg/s] in the second half, and of
    the position over the standard deviations of the batch's final answer, which has these pairs and more."""
    table = read_trajectory(run_folder / name)
    half = slice(len(table.timestamps_ns) // 2, None)
    stamps = table.timestamps_ns[half]
    truth = truth_of_frames(sequence, stamps)
    if truth is None:
        return [float("nan")] * 4
    states = States(stamps, table.r_N[half], table.v_N[half], table.R_NP[half], table.w_P[half])
    errors = motion_errors(states, truth_at(truth, stamps))
    sigma_r = final.sigma_r[np.searchsorted(final.timestamps_ns, stamps)]
    known = np.isfinite(sigma_r)
    over_sigma = ((states.r_N - truth.r_N)[known] / sigma_r[known]) if known.any() else np.array([np.nan])
    return [
        1e3 * errors.rmse_position_m,
        1e3 * errors.rmse_velocity_m_s,
        errors.rmse_angular_velocity_deg_s,
        float(np.sqrt(np.mean(np.square(over_sigma)))),
    ]


def live_nees(run_folder: Path, sequence: Path) -> dict[str, float | None]:
    """Mean NEES of the live states in the second half, over the frames where the quantity is determined."""
    online = read_online(run_folder)
    truth = None if online is None else truth_of_frames(sequence, online.timestamps_ns)
    if online is None or truth is None:
        return dict.fromkeys(QUANTITIES)
    half = np.arange(len(online.timestamps_ns)) >= len(online.timestamps_ns) // 2
    states = States(online.timestamps_ns, online.r_N, online.v_N, online.R_NP, online.w_P)
    true_states = truth_at(truth, online.timestamps_ns)
    errors = state_errors(states, true_states, motion_errors(states, true_states).half_turn)
    found: dict[str, float | None] = {}
    for n, name in enumerate(QUANTITIES):
        block = slice(3 * n, 3 * n + 3)
        covariance = online.covariance[:, block, block]
        known = half & np.isfinite(np.diagonal(covariance, axis1=1, axis2=2)).all(axis=1)
        found[name] = nees(errors[name][known], covariance[known]) if known.any() else None
    return found


def times_row(line: Case) -> list[str]:
    """Of the first table."""
    spread = [f"{middle:.3f} ({high:.3f})" for middle, high in (line["seconds"][stage] for stage in STAGES)]
    last = [f"{line[name]:.1f}" for name in ("report_s", "report_processor_s")]
    last.append(f"{line['load'][0]:.1f}")
    return [_name(line), str(line["pairs"]), str(line["dropped"]), *spread, *last]


def error_rows(line: Case) -> list[list[str]]:
    """Of the second table: live, causal of the batch, final."""
    same = {"final": "yes" if line["same"] else "no"}
    return [
        [_name(line), kind, *(f"{error:.3g}" for error in errors), same.get(kind, "-")]
        for kind, errors in line["errors"].items()
    ]


def nees_row(line: Case) -> list[str]:
    """Of the third table."""
    low, high = expected_range(NEES, "position") or (0.0, 0.0)
    values = (line["nees"][name] for name in QUANTITIES)
    return [
        _name(line),
        *("-" if each is None else f"{each:.2f}" for each in values),
        f"{low:.2f} to {high:.2f}",
    ]


def batch_row(line: Case) -> list[str]:
    """Of the fourth table."""
    film_s, batch_s, sift_s = (line[name] for name in ("film_s", "batch_s", "sift_s"))
    return [
        *(_name(line), f"{film_s:.1f}", f"{batch_s:.1f}", f"{batch_s / film_s:.2f}"),
        *(f"{sift_s:.1f}", f"{batch_s / sift_s:.1f}"),
        *(f"{line['processor_s']:.1f}", f"{line['load'][1]:.1f}"),
    ]


def _name(line: Case) -> str:
    return Path(line["case"]["sequence"]).name
