"""An hour of frames: time a frame and memory against the number of frames, and the answer of a long run.

    python -m lab.live.long [--frames 10000] [--short] [--record DIR]

Synthetic tracks: the sliding window over 10,000 frames of a tumbling body, whose landmarks return into view
with each revolution. Rendered frames: the stream (features, matching, window) over the 2,000 small pairs of
configs/long.yaml, which are simulated into runs/long if they are not there, then the batch answer by key
frames; ``--short``: 12 frames of tracks alone. Milliseconds are processor time of one core, medians over 5 %
of the sequence; memory is that of the process at their ends (of the tracks, 580 MiB are the tracks themselves
and their generation).
"""

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import DEFAULT, ROOT, Record, Short, command, simulated
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.backend.window import SlidingWindow, frames_of
from polhode.compare.problem.sources import SCENES
from polhode.config.backend_settings import Backend
from polhode.config.loader import load_config
from polhode.pipeline.context import open_context
from polhode.pipeline.run import run
from polhode.pipeline.stream.stream import CameraMotion, Stream
from polhode.report.evaluation import evaluate
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import generate

PARTS = 20
"""Of each sequence."""
SHOWN = (0, 1, 4, 9, 14, 19)
"""Parts in the tables."""
ERRORS = {
    "rmse_position_m": (1e3, "position mm"),
    "rmse_velocity_m_s": (1e3, "velocity mm/s"),
    "rmse_angular_velocity_deg_s": (1.0, "w deg/s"),
    "error_k1": (1.0, "k1"),
    "error_k2": (1.0, "k2"),
    "error_com_mm": (1.0, "com mm"),
}


def main(
    frames: Annotated[int, arg(help="Frames of synthetic tracks.")] = 10_000,
    short: Short = False,
    record: Record = ROOT / "runs/records/long",
) -> None:
    """Measure what the record lacks, print the tables."""
    kinds = ("tracks",) if short else ("tracks", "rendered")
    cases: list[Case] = [{"kind": kind, "frames": 12 if short else frames} for kind in kinds]
    # one after the other, each in its process: time and memory are measured
    for line in complete(record, cases, measure, 1, process_each=True):
        (print_window if line["case"]["kind"] == "tracks" else print_run)(line)


def measure(case: Case) -> Case:
    """One sequence."""
    return measure_window(case["frames"]) if case["kind"] == "tracks" else measure_run()


def measure_window(n_frames: int) -> Case:
    """Synthetic tracks through the window alone; hardly a force acts, so that the target stays in view."""
    scene = replace(SCENES["tumble"], frames=n_frames, v_N=(0.0, 0.0, 0.0), accel_psd=1e-12, links=False)
    config = Backend(process_noise="given", accel_psd=scene.accel_psd, torque_psd=scene.torque_psd)
    sequence = generate(scene, 9)
    window, curve = SlidingWindow(sequence.tracks.rig, config), Curve(n_frames)
    for measurements in frames_of(sequence.tracks):
        begin = time.process_time()
        window.add(measurements)
        spent = {"window": 1e3 * (time.process_time() - begin)}
        curve.add(spent, {"landmarks": len(window.state.landmarks.used)})
    return {"parts": curve.parts, "restarts": window.restarts}


def measure_run() -> Case:
    """Rendered pairs through the stream, one by one, then the batch answer and its errors."""
    folder, config = simulated(ROOT / "configs/long.yaml", ROOT / "runs/long"), load_config(ROOT / DEFAULT)
    config = config.model_copy(update={"runtime": config.runtime.model_copy(update={"workers": 1})})
    context = open_context(folder, config, Silent())
    sequence = context.sequence
    camera = CameraMotion(sequence.sigma_camera_p_m, sequence.sigma_camera_theta_rad)
    stream, curve = Stream(config, sequence.calibration, camera), Curve(len(sequence))
    stream.prepare(sequence.read_pair(0))
    for k in range(len(sequence)):
        images = sequence.read_pair(k)
        begin = time.process_time()
        extracted = stream.extract(images)
        done = time.process_time()
        state = stream.add(int(sequence.timestamps_ns[k]), sequence.X_NC[k], extracted)
        added = 1e3 * (time.process_time() - done)
        # of the two parts of ``add`` the clock tells the shares
        share = state.seconds["matching"] / (state.seconds["matching"] + state.seconds["window"])
        spent = {"features": 1e3 * (done - begin), "matching": share * added, "window": (1 - share) * added}
        curve.add(spent, {"with_features": stream.n_with_features})
    begin = time.perf_counter()
    with TemporaryDirectory() as temporary:
        target = Path(temporary) / "run"
        result = run(config, folder, target, Silent(), streamed=stream.streamed(()))
        batch_s = time.perf_counter() - begin
        metrics = evaluate(target, folder)
    return {
        "parts": curve.parts,
        "batch_s": batch_s,
        "duration_s": float(context.time_s[-1]),
        "peak_mb": getrusage(RUSAGE_SELF).ru_maxrss / 1024.0,
        "status": result.status,
        "metrics": {key: metrics[key] for key in ERRORS},
    }


class Curve:
    """Times of frames, summed up in parts of the sequence."""

    def __init__(self, n_frames: int) -> None:
        self._ends = np.unique(np.linspace(0, n_frames, PARTS + 1).round().astype(int))[1:].tolist()
        self._ms: list[dict[str, float]] = []
        self._n = 0
        self.parts: list[Case] = []

    def add(self, ms: dict[str, float], held: dict[str, int]) -> None:
        """Milliseconds of the stages of the next frame, and what is held after it."""
        self._ms.append(ms)
        self._n += 1
        if self._n in self._ends:
            total = [sum(each.values()) for each in self._ms]
            part: Case = {"end": self._n, "frames": len(total), "longest": round(max(total), 2)}
            part |= {name: round(float(np.median([each[name] for each in self._ms])), 2) for name in ms}
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.parts.append(part | held | {"mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)})
            self._ms = []


def print_window(line: Case) -> None:
    """The window's table."""
    print("\nThe sliding window over synthetic tracks\n")
    print_table(
        "frames | ms a frame | longest | MB | landmarks held | restarts",
        (
            [where, f"{part['window']:.1f}", f"{part['longest']:.0f}", f"{part['mb']:.0f}", part["landmarks"],
             line["restarts"]]
            for where, part in _shown(line)
        ),
    )  # fmt: skip


def print_run(line: Case) -> None:
    """The stream's table, what the batch took, and the errors of the run."""
    print("\nThe stream over rendered pairs\n")
    stages = ("features", "matching", "window")
    print_table(
        "frames | features ms | matching ms | window ms | sum | MB | frames with features",
        (
            [where, *(f"{part[name]:.0f}" for name in stages), f"{sum(part[name] for name in stages):.0f}",
             f"{part['mb']:.0f}", part["with_features"]]
            for where, part in _shown(line)
        ),
    )  # fmt: skip
    print(
        f"\nBatch answer: {line['batch_s']:.0f} s of {line['duration_s']:.0f} s of film; at most "
        f"{line['peak_mb']:.0f} MB from the first frame to the report; status {line['status']}.\n"
    )
    values = [f"{scale * line['metrics'][key]:.3g}" for key, (scale, _) in ERRORS.items()]
    print_table([name for _, name in ERRORS.values()], [values])


def _shown(line: Case) -> Iterator[tuple[str, Case]]:
    for n in SHOWN:
        if n < len(line["parts"]):
            part = line["parts"][n]
            yield f"{part['end'] - part['frames']}-{part['end']}", part


if __name__ == "__main__":
    command(main)
