"""Sequences replayed at two frames a second: latency of stages, time to the report, errors live and final.

    python -m lab.live.latency [SEQ ...] [--rate-hz 2] [--short] [--record DIR]

Sequences: those of configs/ts38.yaml and three scenes of configs/scenes, which are simulated if data/ lacks
them; ``--short``: the first seconds of the sample. Each is replayed by ``polhode run --live``, and solved by
``polhode run`` for comparison, both with configs/default.yaml. Times are those of the wall clock on this
machine, with what else it does: the load (processes that want to run, mean of a minute) before each run is
printed beside them. "Of the processor" is what the main process took.

Errors are root mean squares over the second half of the frames: of the states as they were known live, of the
causal window of the batch run, whose tracks were found with all frames, and of the final answer. "r / sigma"
is the error of the position over the final answer's standard deviations.
"""

import os
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import (
    DEFAULT,
    LIGHT,
    ROOT,
    Record,
    Sequences,
    Short,
    beginning_of_sample,
    command,
    simulated,
)
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.config.loader import load_config
from polhode.pipeline.live.run_live import open_source, run_live
from polhode.pipeline.run import run
from polhode.records.dataset import open_sequence
from polhode.records.metrics import States, motion_errors, truth_at
from polhode.report.evaluation import truth_of_frames
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory
from polhode.runtime.progress import Silent

SCENES = ("ts38", "scenes/asteroid", "scenes/major_axis", "scenes/pure_spin")
STAGES = ("features", "matching", "window")
SAME = ("trajectory.csv", "landmarks.ply", "mesh.ply")
"""Files by which the final answer of a stream is compared with that of a batch run."""
TIMES = (
    "sequence | pairs | dropped | features [s] | matching [s] | window [s] | arrival to state [s] | "
    "last pair to report [s] | of the processor [s] | film [s] | batch [s] | load before"
)
ERRORS = (
    "sequence | estimate | position [mm] | velocity [mm/s] | w [deg/s] | r / sigma | same bytes as the batch"
)


def main(
    sequences: Sequences = (),
    rate_hz: Annotated[float, arg(help="Frames a second.")] = 2.0,
    short: Short = False,
    record: Record = ROOT / "runs/records/live",
) -> None:
    """Measure what the record lacks, print the tables."""
    chosen = [beginning_of_sample()] if short else list(sequences)
    for scene in () if chosen else SCENES:
        config = ROOT / "configs" / f"{scene}.yaml"
        chosen.append(simulated(config, ROOT / "data" / config.stem))
    quick = {"quick": True} if short else {}
    cases: list[Case] = [{"sequence": str(folder), "rate_hz": rate_hz, **quick} for folder in chosen]
    # one after the other: they are timed
    lines = complete(record, cases, measure, 1)
    print_table(TIMES, map(times_row, lines))
    print("\nSeconds of the stages: median (95 % are below).\n")
    print_table(ERRORS, [row for line in lines for row in error_rows(line)])


def measure(case: Case) -> Case:
    """One sequence, live and as a batch."""
    source, config = Path(case["sequence"]), load_config(ROOT / DEFAULT, LIGHT if "quick" in case else None)
    stamps_s = 1e-9 * open_sequence(source).timestamps_ns
    interval_s = float(np.median(np.diff(stamps_s)))
    live_run, batch_run = (ROOT / "runs" / f"{kind}_{source.name}" for kind in ("live", "batch"))
    load = os.getloadavg()[0]
    rate = case["rate_hz"] * interval_s
    _, live = run_live(
        config, open_source(source, rate), live_run, Silent(), rate, overwrite=True, even_if_failed=True
    )
    start = perf_counter()
    run(config, source, batch_run, Silent(), overwrite=True, even_if_failed=True)
    batch_s = perf_counter() - start
    seconds = {stage: [each.state.seconds[stage] for each in live.processed] for stage in STAGES}
    seconds["latency"] = [each.latency_s for each in live.processed]
    final = read_trajectory(batch_run / "trajectory.csv")
    return {
        "pairs": len(live.processed),
        "dropped": live.dropped,
        "report_s": live.report_s,
        "report_processor_s": live.report_processor_s,
        "seconds": {key: np.percentile(values, (50, 95)).tolist() for key, values in seconds.items()},
        "errors": {
            "live": errors_of(live_run / "trajectory_online.csv", source, final),
            "window of the batch": errors_of(batch_run / "trajectory_online.csv", source, final),
            "final": errors_of(live_run / "trajectory.csv", source, final),
        },
        "same": all((live_run / name).read_bytes() == (batch_run / name).read_bytes() for name in SAME),
        "film_s": float(stamps_s[-1] - stamps_s[0] + interval_s),
        "batch_s": batch_s,
        "load": load,
    }


def errors_of(file: Path, sequence: Path, final: Trajectory) -> list[float | None]:
    """Root mean square errors of position [mm], velocity [mm/s] and rate [deg/s] in the second half, and of
    the position over the standard deviations of the batch's final answer, which has these pairs and more.
    None without a truth."""
    table = read_trajectory(file)
    half = slice(len(table.timestamps_ns) // 2, None)
    stamps = table.timestamps_ns[half]
    truth = truth_of_frames(sequence, stamps)
    if truth is None:
        return [None] * 4
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


def times_row(line: Case) -> list[str]:
    """Of the first table."""
    spread = [f"{middle:.3f} ({high:.3f})" for middle, high in line["seconds"].values()]
    rest = [f"{line[key]:.1f}" for key in ("report_s", "report_processor_s", "film_s", "batch_s", "load")]
    return [_name(line), str(line["pairs"]), str(line["dropped"]), *spread, *rest]


def error_rows(line: Case) -> list[list[str]]:
    """Of the second table: live, causal of the batch, final."""
    same = {"final": "yes" if line["same"] else "no"}
    return [
        [
            _name(line),
            kind,
            *("-" if error is None else f"{error:.3g}" for error in errors),
            same.get(kind, "-"),
        ]
        for kind, errors in line["errors"].items()
    ]


def _name(line: Case) -> str:
    return Path(line["case"]["sequence"]).name


if __name__ == "__main__":
    command(main)
