"""An hour of frames: time a frame and memory against the number of frames, and the answer of a long run.

    python -m benchmarks.live.long [--only tracks] [--frames 10000] [--short] [--record FILE] [-o PNG]

Synthetic tracks: the sliding window over 10,000 frames of a tumbling body, whose landmarks return into view
with each revolution. Rendered frames: the stream (features, matching, window) over the 2,000 small pairs of
configs/long.yaml, which are simulated into runs/long if they are not there, then the batch answer by key
frames; ``--short``: 300 frames of tracks, and the shipped sample with 24 key frames. Milliseconds are
processor time of one core, medians over parts of the sequence; memory is that of the process at their ends
(of the tracks, 580 MiB are the tracks themselves and their generation).
"""

import os
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import numpy as np
from tyro.conf import arg

from benchmarks.command import DEFAULT, ROOT, Png, Record, Short, command, simulated
from benchmarks.monte_carlo.window import GROWTH
from benchmarks.presentation import print_table, save_figure, subplots
from benchmarks.record import Case, complete
from polhode.backend.window import SlidingWindow, frames_of
from polhode.config.backend_settings import Backend
from polhode.config.loader import load_config
from polhode.pipeline.context import open_context
from polhode.pipeline.evaluation import evaluate
from polhode.pipeline.run import run
from polhode.pipeline.stream.stream import CameraMotion, Stream
from polhode.progress import Silent
from polhode.simulation.monte_carlo import generate

RECORD = ROOT / "runs/records/long"
"""Not kept in the repository: times are those of a machine."""
SCENE = ROOT / "configs" / "long.yaml"
SEED = 9
PARTS = 20
"""Of each sequence, for the curve"""
SHOWN = (0, 1, 4, 9, 14, 19)
"""Of them, in the tables"""
SHORT_KEYS = {"key_frames": {"above": 40, "number": 24}}
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
    record: Record = RECORD,
    only: Annotated[Literal["tracks", "rendered"] | None, arg(help="One of the two; else both.")] = None,
    png: Png = None,
) -> None:
    """Measure what the record lacks, print the tables."""
    cases: list[Case] = []
    if only != "rendered":
        cases.append({"kind": "tracks", "frames": 300 if short else frames})
    if only != "tracks":
        folder = ROOT / "sample" if short else simulated(SCENE, ROOT / "runs" / "long")
        cases.append({"kind": "rendered", "sequence": str(folder.relative_to(ROOT)), "short": short})
    # one after the other: they are timed
    lines = complete(record, cases, measure, 1)
    for line in lines:
        (print_window if line["case"]["kind"] == "tracks" else print_run)(line)
    if png is not None:
        draw(lines, png)


def print_window(tracks: Case) -> None:
    """The window's table, and its errors at the end."""
    print("\nThe sliding window over synthetic tracks\n")
    print_table("frames | ms a frame | longest | MB | landmarks held | restarts", window_rows(tracks))
    errors = ", ".join(f"{name} {value:.2g}" for name, value in tracks["last"].items())
    print(f"\nErrors in sigmas after the last frame: {errors}.")


def print_run(rendered: Case) -> None:
    """The stream's table, what the batch took, and the errors of the run."""
    print("\nThe stream over rendered pairs\n")
    head = "frames | features ms | matching ms | window ms | sum | MB | frames with features"
    print_table(head, stream_rows(rendered))
    print(
        f"\nBatch answer: {rendered['batch_s']:.0f} s of {rendered['duration_s']:.0f} s of film; at most "
        f"{rendered['peak_mb']:.0f} MB from the first frame to the report; status {rendered['status']}.\n"
    )
    found = rendered["metrics"]
    print_table(
        " | ".join(name for _, name in ERRORS.values()),
        [[f"{scale * found[key]:.3g}" for key, (scale, _) in ERRORS.items()]],
    )


def measure(case: Case) -> Case:
    """One sequence."""
    return measure_window(case["frames"]) if case["kind"] == "tracks" else measure_run(case)


def measure_window(n_frames: int) -> Case:
    """Synthetic tracks through the window alone; hardly a force acts, so that the target stays in view."""
    scene = replace(GROWTH, frames=n_frames, v_N=(0.0, 0.0, 0.0), accel_psd=1e-12, links=False)
    config = Backend(process_noise="given", accel_psd=scene.accel_psd, torque_psd=scene.torque_psd)
    sequence = generate(scene, SEED)
    window, curve = SlidingWindow(sequence.tracks.rig, config), Curve(n_frames)
    for measurements in frames_of(sequence.tracks):
        begin = time.process_time()
        state = window.add(measurements)
        spent = {"window": 1e3 * (time.process_time() - begin)}
        curve.add(spent, {"landmarks": len(window.state.landmarks.used)})
    truth = sequence.truth
    sigma = np.sqrt(np.concatenate([np.diag(state.cov_k), np.diag(state.covariance)[:3]]))
    off = np.concatenate([state.k - [truth.k1, truth.k2], state.r_N - truth.r_N[-1]])
    last = dict(zip(("k1", "k2", "x", "y", "z"), (off / sigma).tolist(), strict=True))
    return {"parts": curve.parts, "restarts": window.restarts, "last": last}


def measure_run(case: Case) -> Case:
    """Rendered pairs through the stream, one by one, then the batch answer and its errors."""
    folder = ROOT / case["sequence"]
    config = load_config(ROOT / DEFAULT)
    changed = {"runtime": {"workers": 1}} | (SHORT_KEYS if case["short"] else {})
    config = type(config).model_validate(config.model_dump() | changed)
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
        spent = {
            "features": 1e3 * (done - begin), "matching": share * added, "window": (1 - share) * added,
        }  # fmt: skip
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
            self.parts.append(part | held | {"mb": round(resident_mb(), 1)})
            self._ms = []


def resident_mb() -> float:
    """Memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _shown(line: Case) -> Iterable[tuple[str, Case]]:
    for n in SHOWN:
        if n < len(line["parts"]):
            part = line["parts"][n]
            yield f"{part['end'] - part['frames']}-{part['end']}", part


def window_rows(line: Case) -> list[list[object]]:
    """Rows of the table of the window."""
    return [
        [where, f"{part['window']:.1f}", f"{part['longest']:.0f}", f"{part['mb']:.0f}", part["landmarks"],
         line["restarts"]]
        for where, part in _shown(line)
    ]  # fmt: skip


def stream_rows(line: Case) -> list[list[object]]:
    """Rows of the table of the stream."""
    stages = ("features", "matching", "window")
    return [
        [where, *(f"{part[name]:.0f}" for name in stages), f"{sum(part[name] for name in stages):.0f}",
         f"{part['mb']:.0f}", part["with_features"]]
        for where, part in _shown(line)
    ]  # fmt: skip


CURVES = {
    "tracks": ("window, synthetic tracks", ("window",)),
    "rendered": ("stream, rendered pairs", ("features", "matching", "window")),
}


def draw(lines: list[Case], png: Path) -> None:
    """Time a frame and memory over the number of frames, a column for each sequence."""
    n = len(lines)
    figure, axes = subplots(2, n, (1.0 + 4.0 * n, 5.0), sharex="col", squeeze=False, layout="constrained")
    for column, line in enumerate(lines):
        title, stages = CURVES[line["case"]["kind"]]
        ends = [part["end"] for part in line["parts"]]
        for stage in stages:
            axes[0, column].plot(ends, [part[stage] for part in line["parts"]], marker=".", label=stage)
        axes[1, column].plot(ends, [part["mb"] for part in line["parts"]], marker=".", color="0.3")
        axes[0, column].set(title=title, ylim=(0.0, None))
        axes[1, column].set(xlabel="frames so far", ylim=(0.0, 2048.0))
        axes[0, column].legend(frameon=False)
    axes[0, 0].set_ylabel("ms a frame, one core")
    axes[1, 0].set_ylabel("memory MiB (2 GiB allowed)")
    save_figure(figure, png, 110)


if __name__ == "__main__":
    command(main)
