"""Sequences replayed at two frames a second: latency of stages, frames dropped, time to the report, errors.

    python -m benchmarks.live.replay [SEQ ...] [--rate-hz 2] [--short] [--record FILE]

Sequences: those of configs/ts38.yaml and three scenes of configs/scenes, which are simulated if data/ lacks
them; ``--short``: the shipped sample. Each is replayed by ``polhode run --live``, and solved by ``polhode
run`` for comparison, both with configs/default.yaml. The times are those of a machine, with what else it
does.

Errors are root mean squares over the second half of the frames: of the states as they were known live, of the
causal window of the batch run, whose tracks were found with all frames, and of the final answer.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import DEFAULT, ROOT, Record, Sequences, Short, command, simulated
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.metrics import States, motion_errors, truth_at
from polhode.pipeline.evaluation import truth_of_frames
from polhode.pipeline.live.run_live import LiveReport, run_live
from polhode.pipeline.run import run
from polhode.pipeline.run_directory.trajectory_file import read_trajectory
from polhode.progress import Silent

RECORD = ROOT / "runs" / "live.jsonl"
"""Not kept in the repository: times are those of a machine."""
SAMPLE = ROOT / "sample"
SCENES = (
    "configs/ts38.yaml",
    *(f"configs/scenes/{name}.yaml" for name in ("asteroid", "major_axis", "pure_spin")),
)
STAGES = ("features", "matching", "window", "latency")
SAME = ("trajectory.csv", "landmarks.ply", "mesh.ply")
"""Files by which the final answer of a stream is compared with that of a batch run."""
TIMES = (
    "sequence | pairs | dropped | features [s] | matching [s] | window [s] | arrival to state [s] | "
    "last pair to report [s]"
)
ERRORS = "sequence | estimate | position [mm] | velocity [mm/s] | w [deg/s] | same bytes as the batch"


def main(
    sequences: Sequences = (),
    rate_hz: Annotated[float, arg(help="Frames a second.")] = 2.0,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    if short:
        chosen = [SAMPLE]
    else:
        chosen = list(sequences) or [
            simulated(ROOT / each, ROOT / "data" / Path(each).stem) for each in SCENES
        ]
    cases: list[Case] = [{"sequence": str(folder), "rate_hz": rate_hz} for folder in chosen]
    # one after the other: they are timed
    lines = complete(record, cases, measure, 1)
    print_table(TIMES, map(times_row, lines))
    print("\nSeconds of the stages: median (95 % are below).\n")
    print_table(ERRORS, [row for line in lines for row in error_rows(line)])


def measure(case: Case) -> Case:
    """One sequence, live and as a batch."""
    source, config = Path(case["sequence"]), load_config(ROOT / DEFAULT)
    time_s = 1e-9 * np.diff(open_sequence(source).timestamps_ns)
    live_run, batch_run = (ROOT / "runs" / f"{kind}_{source.name}" for kind in ("live", "batch"))
    rate = case["rate_hz"] * float(np.median(time_s))
    _, live = run_live(config, source, live_run, Silent(), rate, overwrite=True, even_if_failed=True)
    run(config, source, batch_run, Silent(), overwrite=True, even_if_failed=True)
    same = all((live_run / name).read_bytes() == (batch_run / name).read_bytes() for name in SAME)
    return {
        "pairs": len(live.processed),
        "dropped": live.dropped,
        "report_s": live.report_s,
        "seconds": stage_times(live),
        "errors": {
            "live": errors_of(live_run, "trajectory_online.csv", source),
            "window of the batch": errors_of(batch_run, "trajectory_online.csv", source),
            "final": errors_of(live_run, "trajectory.csv", source),
        },
        "same": same,
    }


def stage_times(live: LiveReport) -> dict[str, list[float]]:
    """Median and 95th percentile of each stage and of the whole latency [s]."""
    found = {stage: [each.state.seconds[stage] for each in live.processed] for stage in STAGES[:-1]}
    found["latency"] = [each.latency_s for each in live.processed]
    return {stage: [float(np.percentile(values, q)) for q in (50, 95)] for stage, values in found.items()}


def errors_of(run_folder: Path, name: str, sequence: Path) -> list[float]:
    """Root mean square errors of position [mm], velocity [mm/s] and rate [deg/s] in the second half."""
    table = read_trajectory(run_folder / name)
    half = slice(len(table.timestamps_ns) // 2, None)
    stamps = table.timestamps_ns[half]
    truth = truth_of_frames(sequence, stamps)
    if truth is None:
        return [float("nan")] * 3
    states = States(stamps, table.r_N[half], table.v_N[half], table.R_NP[half], table.w_P[half])
    errors = motion_errors(states, truth_at(truth, stamps))
    return [
        1e3 * errors.rmse_position_m,
        1e3 * errors.rmse_velocity_m_s,
        errors.rmse_angular_velocity_deg_s,
    ]


def times_row(line: Case) -> list[str]:
    """Of the first table."""
    spread = [f"{middle:.3f} ({high:.3f})" for middle, high in (line["seconds"][stage] for stage in STAGES)]
    name = Path(line["case"]["sequence"]).name
    return [name, str(line["pairs"]), str(line["dropped"]), *spread, f"{line['report_s']:.1f}"]


def error_rows(line: Case) -> list[list[str]]:
    """Of the second table: live, causal of the batch, final."""
    name = Path(line["case"]["sequence"]).name
    same = {"final": "yes" if line["same"] else "no"}
    return [
        [name, kind, *(f"{error:.3g}" for error in errors), same.get(kind, "-")]
        for kind, errors in line["errors"].items()
    ]


if __name__ == "__main__":
    command(main)
