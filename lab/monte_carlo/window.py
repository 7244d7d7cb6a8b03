"""The sliding window against full smoothing of the same frames; growth of its time and memory.

    python -m lab.monte_carlo.window [--seeds 5] [--workers 1] [--short] [--record FILE] [--times FILE]

Accuracy: sequences at the thesis's size. At some frames the window's causal state is compared with the last
state of full smoothing of all frames up to then, started at the truth: the best possible estimate. Pixel
and process noise are given. RMSE over seeds and these frames; of com_G and of the five inertia parameters at
the last frame.

Growth: one sequence of 1,000 frames by each solver; ms on the clock, and of one core's own time in brackets,
which does not count what else the machine does. Last, after how many frames IPOPT's optimum is the answer.
"""

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import RECORDS, ROOT, Record, Seeds, Short, Workers, command
from lab.monte_carlo.accuracy import MOTIONS
from lab.monte_carlo.bound import UNITS, true_iterate
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.backend.problem.inertia import FORMS, principal_axes, second_moments_from_inertia
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.solve import refine
from polhode.backend.window import SlidingWindow, frames_of
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Ints, log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.tracks import RelativePoses
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

RECORD = RECORDS / "window"
TIMES = ROOT / "runs/records/window_times"
"""Not kept in the repository: times are those of a machine."""
SCENES = (
    "spin of 10 RPM near the middle axis (TS38)",
    "flip of a box, 8 RPM",
    "major-axis wobble, 8 RPM",
    "triaxial tumble, 7 RPM",
)
FRAMES = (40, 60, 80, 100, 114)
"""Frames, counted from 0, at which the current states are compared."""
GROWTH = replace(MOTIONS["triaxial tumble, 7 RPM"], frames=1000)
PARTS = ((10, 90), (100, 200), (450, 550), (900, 1000))
"""Of the long sequence; times are medians over a part. In the first one the history is solved as a whole."""
SOLVERS = ("gauss_newton", "ipopt")
GOAL_MS = 60.0
"""Largest median of a frame's time on the clock, with IPOPT."""


def main(
    seeds: Seeds = 5,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
    times: Annotated[Path, arg(help="File of the times that were measured.")] = TIMES,
) -> None:
    """Measure what the record lacks, print the tables."""
    scenes = SCENES[: 1 if short else None]
    cases: list[Case] = [
        {"motion": motion, "process_noise": "given", "seed": seed, "solver": "ipopt"}
        for seed in range(1 if short else seeds)
        for motion in scenes
    ]
    lines = complete(record, cases, measure_accuracy, workers)
    print_accuracy({name: [line for line in lines if line["case"]["motion"] == name] for name in scenes})
    n_frames = 20 if short else GROWTH.frames
    growth: list[Case] = [{"solver": solver, "frames": n_frames} for solver in SOLVERS]
    # one after the other: they are timed
    print_growth(complete(times, growth, measure_growth, 1))


def measure_accuracy(case: Case) -> Case:
    """One sequence: squared errors (frames, 6) of the window and of full smoothing."""
    sequence = generate(MOTIONS[case["motion"]], 9000 + case["seed"])
    config = _config(MOTIONS[case["motion"]], case["solver"])
    window, online = SlidingWindow(sequence.tracks.rig, config), []
    X_NG = np.eye(4)
    for k, measurements in enumerate(frames_of(sequence.tracks)):
        state = window.add(measurements)
        # G stays at its pose of the first frame
        X_NG = state.X_NG if k == 0 else X_NG
        if k in FRAMES:
            motion = (state.r_N, state.v_N, state.R_NP, state.w_P)
            online.append(
                squares(sequence, k, X_NG, motion, state.com_G, (state.k[0], state.k[1], state.R_GP))
            )
    return {"window": online, "smoothing": [smoothed(sequence, k, config) for k in FRAMES]}


def smoothed(sequence: SyntheticSequence, k: int, config: Backend) -> list[float]:
    """Squared errors (6,) of full smoothing of the frames 0 to k."""
    part = some_frames(sequence, np.arange(k + 1))
    data, start = motion_data(part.tracks, config), true_iterate(part, config)
    found, _, _ = refine(GaussNewton(data), start, 50)
    moments, R_GP = principal_axes(found.J_G(data.form))
    k1, k2 = np.log(moments[:2] / moments[1:])
    r_N, X_NG = found.p_NG[k] + found.R_NG[k] @ found.com_G, np.eye(4)
    X_NG[:3, :3], X_NG[:3, 3] = found.R_NG[0], found.p_NG[0]
    motion = (r_N, found.v_N[k], found.R_NG[k] @ R_GP, R_GP.T @ found.w_G[k])
    return squares(sequence, k, X_NG, motion, found.com_G, (float(k1), float(k2), R_GP))


def some_frames(sequence: SyntheticSequence, frames: Ints) -> SyntheticSequence:
    """Some frames (n,), ascending, with landmarks renumbered."""
    tracks, truth, relative = sequence.tracks, sequence.truth, sequence.relative
    use, pairs = np.isin(tracks.frame, frames), np.isin(relative.i, frames) & np.isin(relative.j, frames)
    marks, landmark = np.unique(tracks.landmark[use], return_inverse=True)
    part = replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[frames],
        X_NR=tracks.X_NR[frames],
        frame=np.searchsorted(frames, tracks.frame[use]),
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[use],
        sigma_px=tracks.sigma_px[use],
    )
    states = {name: getattr(truth, name)[frames] for name in ("timestamps_ns", "r_N", "R_NP", "v_N", "w_P")}
    i, j = (np.searchsorted(frames, each[pairs]) for each in (relative.i, relative.j))
    return replace(
        sequence,
        tracks=part,
        relative=RelativePoses(i, j, relative.X_RiRj[pairs], relative.inliers[pairs]),
        truth=replace(truth, **states),
        X_NG=sequence.X_NG[frames],
        p_G=sequence.p_G[marks],
        outlier=sequence.outlier[use],
    )


def squares(
    sequence: SyntheticSequence,
    k: int,
    X_NG: Array,
    motion: tuple[Array, Array, Array, Array],
    com_G: Array,
    mass: tuple[float, float, Array],
) -> list[float]:
    """Squared errors (6,) of r_N, v_N, attitude [rad], w along N, com_G, xi at frame k.

    X_NG (4, 4) is the pose of the estimate's G in the first frame; motion is r_N, v_N, R_NP, w_P; mass is k1,
    k2, R_GP.
    """
    truth, (r_N, v_N, R_NP, w_P), (k1, k2, R_GP) = sequence.truth, motion, mass
    turns = [log_so3(R_NP.T @ (truth.R_NP[k] * turn)) for turn in HALF_TURNS]
    theta = min(turns, key=lambda turn: float(turn @ turn))
    R_NG = X_NG[:3, :3]
    com_true = R_NG.T @ (truth.r_N[0] - X_NG[:3, 3])
    between = sequence.X_NG[0, :3, :3].T @ R_NG
    J = between @ (R_GP * np.exp([k1, 0.0, -k2])) @ R_GP.T @ between.T
    J_true = truth.R_GP * truth.moments @ truth.R_GP.T
    form = FORMS["second_moments"]
    xi, xi_true = (form.coordinates(second_moments_from_inertia(each))[0] for each in (J, J_true))
    errors = [
        r_N - truth.r_N[k],
        v_N - truth.v_N[k],
        theta,
        R_NP @ w_P - truth.R_NP[k] @ truth.w_P[k],
        com_G - com_true,
        xi - xi_true,
    ]
    return [float(error @ error) for error in errors]


def measure_growth(case: Case) -> Case:
    """One long sequence: milliseconds of each step, and the size of the window and the process."""
    scene = replace(GROWTH, frames=case["frames"])
    config = _config(scene, case["solver"])
    sequence = generate(scene, 9)
    window, wall_ms, cpu_ms, sizes = SlidingWindow(sequence.tracks.rig, config), [], [], {}
    for k, measurements in enumerate(frames_of(sequence.tracks), start=1):
        wall, cpu = time.perf_counter(), time.process_time()
        window.add(measurements)
        wall_ms.append(round(1e3 * (time.perf_counter() - wall), 2))
        cpu_ms.append(round(1e3 * (time.process_time() - cpu), 2))
        if k in {end for _, end in PARTS} | {case["frames"]}:
            active, marks = window.state.active, window.state.landmarks
            resident = Path("/proc/self/statm").read_text().split()[1]
            sizes[str(k)] = {
                "frames": len(active.frames),
                "observations": sum(len(frame.slot) for frame in active.frames),
                "landmarks": len(marks.used),
                "unknowns": len(active.arrival.g),
                "resident_mb": round(int(resident) * os.sysconf("SC_PAGE_SIZE") / 2**20, 1),
            }
    answers = {"updates": window.updates, "by_ipopt": window.answered}
    return {"wall_ms": wall_ms, "cpu_ms": cpu_ms, "held": sizes, "answers": answers}


def _config(scene: SyntheticScene, solver: str) -> Backend:
    stated = {"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd}
    return Backend.model_validate({"process_noise": "given", "window": {"solver": solver}, **stated})


def ratios(lines: list[Case]) -> Array:
    """(6,) RMSE of the window over that of smoothing: states at FRAMES, constants at the last of them."""
    window, smoothing = (np.array([line[name] for line in lines]) for name in ("window", "smoothing"))
    of_states = window[:, :, :4].mean(axis=(0, 1)) / smoothing[:, :, :4].mean(axis=(0, 1))
    of_constants = window[:, -1, 4:].mean(axis=0) / smoothing[:, -1, 4:].mean(axis=0)
    return np.asarray(np.sqrt(np.concatenate([of_states, of_constants])))


def print_accuracy(cells: dict[str, list[Case]]) -> None:
    """RMSE of the window, and over that of full smoothing up to then."""
    print(f"\nRMSE of the window (over that of full smoothing), frames {', '.join(map(str, FRAMES))}\n")
    rows = []
    for motion, lines in [*cells.items(), ("all", [line for cell in cells.values() for line in cell])]:
        window = np.array([line["window"] for line in lines])
        squares_of = np.concatenate([window[:, :, :4].mean(axis=(0, 1)), window[:, -1, 4:].mean(axis=0)])
        both = zip(UNITS * np.sqrt(squares_of), ratios(lines), strict=True)
        rows.append([motion, len(lines), *(f"{rmse:.3g} ({ratio:.2f})" for rmse, ratio in both)])
    print_table("motion | seeds | r mm | v mm/s | attitude deg | w deg/s | com mm | inertia", rows)
    worst = np.array([ratios(lines) for lines in cells.values()])
    print(f"\nAt most {worst[:, :4].max():.2f} for a current state, {worst[:, 4:].max():.2f} for a constant.")


def print_growth(lines: list[Case]) -> None:
    """Median milliseconds of a step in parts of the sequence, and the sizes at their ends."""
    rows: list[list[object]] = []
    for line in lines:
        for start, end in PARTS:
            if end > line["case"]["frames"]:
                continue
            wall, cpu, size = line["wall_ms"][start:end], line["cpu_ms"][start:end], line["held"][str(end)]
            rows.append([
                line["case"]["solver"], f"{start}-{end}", f"{np.median(wall):.1f} ({np.median(cpu):.1f})",
                f"{max(wall):.0f} ({max(cpu):.0f})", f"{size['resident_mb']:.0f}", size["landmarks"],
                size["observations"], size["unknowns"],
            ])  # fmt: skip
    print()
    head = "solver | frames | ms/step (one core) | longest | MB | landmarks | observations | unknowns"
    print_table(head, rows)
    for line in lines:
        if line["case"]["solver"] == "ipopt":
            median, answers = float(np.median(line["wall_ms"])), line["answers"]
            note = "" if median <= GOAL_MS else " *"
            print(
                f"\nWith IPOPT the median of all frames is {median:.1f} ms, goal at most {GOAL_MS:g}{note}."
            )
            print(f"Its optimum is the answer after {answers['by_ipopt']} of {answers['updates']} frames.")


if __name__ == "__main__":
    command(main)
