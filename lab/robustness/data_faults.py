"""Faults in the data, one at a time, on twelve bodies: what a run finds, how far off it is, what it says.

    python -m lab.robustness.data_faults [--bodies ...] [--faults ...] [--workers 1] [--short]

Each body is simulated once, or a second time where a fault must be rendered; the other faults change its
images, times, calibration or poses. Each run is a row of the record; an interrupted campaign goes on. Cases
are independent: on several machines, give each its ``--bodies`` and ``--record``, and join the records (cat).

"wrong", "claimed" and the floors: ``lab/robustness/judge.py``; docs/trust.md explains the faults.
"""

import fcntl
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from tyro.conf import arg

from lab.command import RECORDS, ROOT, Record, Short, Workers, command
from lab.presentation import print_table
from lab.record import Case, complete, measured
from lab.robustness import faults_of_files as files
from lab.robustness import faults_of_scenes as scenes
from lab.robustness.bodies import BODIES, FRAMES
from lab.robustness.judge import OUTCOMES, judged, outcome_of
from lab.robustness.recording import write_recording
from polhode.config import Config
from polhode.pipeline.run import run
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Silent

RECORD = RECORDS / "data_faults"
CONFIGURATION: dict[str, Any] = {
    "frontend": {"features": {"max_features": 900, "second_below": 40}},
    "backend": {"window": {"enabled": False}},
    "mapping": {"voxel_mm": 5.0},
    "outputs": ["motion", "surface"],
    "runtime": {"workers": 1},
}
"""Small images give fewer features: with the default the slower second method would be used in every run."""
LIGHT = CONFIGURATION | {
    "frontend": {"features": {"max_features": 900, "second": None}, "depth": {"method": "sgbm"}},
    "backend": {"window": {"enabled": False}, "bounds": {"intervals": False}},
    "mapping": {"voxel_mm": 10.0},
}
"""Without networks and intervals and with a coarse surface, for the short form"""


@dataclass(frozen=True)
class Fault:
    """One fault: how the sequence is made, and how a warning that names it reads."""

    title: str
    change: files.Change | None = None
    """Of the recording; None: none besides the rendered fault"""
    render: scenes.Rendered = scenes.undisturbed
    named: tuple[str, ...] = ()
    """Regular expressions of warnings that name the trouble"""


FAULTS: dict[str, Fault] = {
    "none": Fault("undisturbed"),
    "dropped_10": Fault("10 % of the frames dropped", files.dropped(0.1)),
    "dropped_30": Fault("30 % of the frames dropped", files.dropped(0.3)),
    "dropped_60": Fault("60 % of the frames dropped", files.dropped(0.6)),
    "burst": Fault("10 s lost", files.burst(10.0)),
    "dead_camera": Fault("one camera dead for 5 s", files.dead_camera),
    "sides_exchanged": Fault("left and right exchanged in a fifth of the pairs", files.sides_exchanged),
    "order_exchanged": Fault("successive pairs exchanged, four times", files.order_exchanged),
    "right_late": Fault("the right camera 20 ms late", render=scenes.right_camera_late),
    "clock_jumps": Fault("clock jumps by +0.8 s and -0.3 s", files.clock_jumps),
    "exposure_jumps": Fault("exposure jumps five times", files.exposure_jumps),
    "saturation": Fault("exposed four times too long", files.saturation),
    "dead_columns": Fault("eight dead columns in each camera", files.dead_columns),
    "dust": Fault("thirty grains of dust on each sensor", files.dust),
    "blur": Fault("2 px of blur", files.blur),
    "knocked_pitch": Fault("right camera knocked by 0.2 deg, up", files.knocked((1.0, 0.0, 0.0))),
    "knocked_yaw": Fault("right camera knocked by 0.2 deg, sideways", files.knocked((0.0, 1.0, 0.0))),
    "knocked_roll": Fault("right camera knocked by 0.2 deg, about its axis", files.knocked((0.0, 0.0, 1.0))),
    "focal_wrong": Fault(
        "focal length 0.5 % wrong", files.focal_wrong, named=("a focal length wrong by up to",)
    ),
    "plume": Fault("a plume", files.plume),
    "mass_ejected": Fault(
        "8 % of the mass ejected", render=scenes.mass_ejected, named=("left it or moved with the push",)
    ),
    "thruster_burst": Fault("a thruster fires for 1 s", render=scenes.thruster_burst),
    "disturbances_10": Fault("disturbances x 10", render=scenes.disturbances(10.0)),
    "disturbances_100": Fault("disturbances x 100", render=scenes.disturbances(100.0)),
    "poses_wrong": Fault("half of the inspector's attitudes 1 deg wrong", files.poses_wrong),
    "eclipse": Fault("eclipse of 8 s", files.eclipse),
    "leaves_and_returns": Fault("out of view for 6 s", render=scenes.leaves_and_returns),
}
ONLY_WARNED = "of these by a warning alone"
SHORT_BODIES, SHORT_FAULTS, SHORT_FRAMES = ("flyer",), ("dropped_30",), 12


def main(
    bodies: Annotated[tuple[str, ...], arg(help="Names of bodies; all by default.")] = (),
    faults: Annotated[tuple[str, ...], arg(help="Names of faults; all by default.")] = (),
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    folder: Annotated[Path, arg(help="Where sequences are kept while they are needed.")] = ROOT
    / "runs/data_faults",
    table: Annotated[bool, arg(help="Only print the table of what the record has.")] = False,
) -> None:
    """Measure what the record lacks, print the tables."""
    bodies = bodies or (SHORT_BODIES if short else tuple(BODIES))
    faults = faults or (SHORT_FAULTS if short else tuple(FAULTS))
    for word, known in ((bodies, BODIES), (faults, FAULTS)):
        for name in word:
            if name not in known:
                raise SystemExit(f"{name}: there are only {', '.join(known)}")
    cases: list[Case] = [{"body": body, "fault": fault} for body in bodies for fault in faults]
    if short:
        measure = Measure(folder / "short", SHORT_FRAMES, LIGHT)
    else:
        measure = Measure(folder, FRAMES, CONFIGURATION)
    print_tables(measured(record, cases) if table else complete(record, cases, measure, workers))


@dataclass(frozen=True)
class Measure:
    """One run, judged."""

    folder: Path
    frames: int
    configuration: Mapping[str, Any]

    def __call__(self, case: Case) -> Case:
        """The row of a case."""
        body, fault = case["body"], FAULTS[case["fault"]]
        with _alone(self.folder / body):
            recording = fault.render(body, self.frames, self.folder / body / "rendered")
        if fault.change is not None:
            seed = crc32(f"{body} {case['fault']}".encode())
            recording = fault.change(recording, np.random.default_rng(seed))
        place = self.folder / body / case["fault"]
        shutil.rmtree(place, ignore_errors=True)
        write_recording(recording, place / "sequence")
        start = time.perf_counter()
        code = 0
        try:
            run(Config.model_validate(self.configuration), place / "sequence", place / "run", Silent())
        except RunFailure:
            code = 1
        except InputError as error:
            shutil.rmtree(place, ignore_errors=True)
            refused = {"status": "failed", "warnings": [str(error)], "claims": {}, "wrong": []}
            return {"exit": 2, **refused, "seconds": round(time.perf_counter() - start, 1)}
        seconds = time.perf_counter() - start
        row = {"exit": code, **judged(place / "run", recording), "seconds": round(seconds, 1)}
        shutil.rmtree(place)
        return row


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time renders a body."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def print_tables(lines: Sequence[Case]) -> None:
    """Outcomes by fault; then each run that is wrong."""
    by_fault = {name: [line for line in lines if line["case"]["fault"] == name] for name in FAULTS}
    by_fault = {name: some for name, some in by_fault.items() if some}
    columns = ("position", "attitude", "rate", "com", "k", "axes")
    print(f"\n{len(lines)} runs\n")
    outcomes_head = (*OUTCOMES[:2], ONLY_WARNED, *OUTCOMES[2:])
    head = ("fault", "runs", *outcomes_head, *(f"{c}, worst sigmas" for c in columns), "seconds")
    print_table(head, (_row(name, some, columns) for name, some in by_fault.items()), right_from=1)
    outcomes = [outcome(line) for line in lines]
    warned = f"{_only_warned(lines)} {ONLY_WARNED}"
    counts = [f"{outcomes.count(name)} {name}" for name in OUTCOMES]
    print("\n" + ", ".join([*counts[:2], warned, *counts[2:]]) + "\n")
    print_table(
        ("body", "fault", "status", "wrong: worst sigmas, worst error", "warnings"),
        (_wrong_row(line) for line in lines if line["wrong"]),
    )


def outcome(line: Case) -> str:
    """Of a row of the record."""
    return outcome_of(line, FAULTS[line["case"]["fault"]].named)


def _only_warned(lines: Sequence[Case]) -> int:
    """Number of wrong runs that say so in a warning alone: their status is ok."""
    return sum(outcome(line) == OUTCOMES[1] and line["status"] == "ok" for line in lines)


def _row(name: str, lines: list[Case], columns: Sequence[str]) -> list[str]:
    outcomes = [outcome(line) for line in lines]
    counts = [str(outcomes.count(each) or "") for each in OUTCOMES]
    counts.insert(2, str(_only_warned(lines) or ""))
    claims = [line["claims"] for line in lines if line["status"] != "failed"]
    worst = []
    for column in columns:
        values = [claim[column]["worst_sigmas"] for claim in claims if column in claim]
        worst.append(f"{np.median(values):.1f}, {max(values):.1f}" if values else "-")
    seconds = np.median([line["seconds"] for line in lines])
    return [FAULTS[name].title, str(len(lines)), *counts, *worst, f"{seconds:.0f}"]


def _wrong_row(line: Case) -> list[str]:
    claims = line["claims"]
    wrong = [f"{name} {claims[name]['worst_sigmas']}, {claims[name]['worst']}" for name in line["wrong"]]
    case = line["case"]
    return [case["body"], case["fault"], line["status"], "; ".join(wrong), "; ".join(line["warnings"])]


if __name__ == "__main__":
    command(main)
