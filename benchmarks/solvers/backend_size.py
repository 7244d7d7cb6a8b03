"""Time of the back end on measurements of the thesis's size: each part, both solvers, growth.

    python -m benchmarks.solvers.backend_size [--seeds 1] [--short] [-o PNG]

115 frames, about 2,400 landmarks and 24,200 stereo observations, process noise of the thesis, one BLAS
thread. First the solvers alone on one problem, and IPOPT as a run uses it, from where Gauss-Newton ends; then
whole cold starts with the default configuration (the process noise is estimated) by either solver, then the
growth, drawn with ``-o``. ``--short``: one scene, the growth at small sizes. Seconds are those of the
processor, on one thread: of a free core, those of the clock.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.command import Png, Seeds, Short, command
from benchmarks.monte_carlo.bound import true_iterate
from benchmarks.presentation import numbers, print_table, save_figure, subplots
from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, MotionFit, linearization_point
from polhode.backend.solvers.solve import refine
from polhode.backend.uncertainty.covariance import (
    body_jacobians,
    marginals,
    state_covariances,
    state_jacobians,
)
from polhode.backend.uncertainty.principal_axes import axes_derivative
from polhode.compare.problem.sources import THESIS
from polhode.config.backend_settings import Backend
from polhode.lie import Array, exp_so3
from polhode.progress import Advance
from polhode.records import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

FRAMES = (29, 58, 115, 230, 345)
LANDMARKS = (600, 1200, 2430, 4860, 9720)
REPETITIONS = 3
ITERATIONS = 60
LIMITS = {
    "IPOPT over Gauss-Newton": 3.0,
    "IPOPT with building [s]": 3.0,
    "IPOPT after Gauss-Newton, with building [s]": 3.0,
    "covariance [s]": 0.3,
}
COLORS = ("#0072b2", "#d55e00", "#009e73")
SCENES = {
    "spin of 10 RPM near the middle axis, 1 px": THESIS,
    "clear flip, 1 px": replace(THESIS, w_G=(0.16, 1.04, 0.16)),
    "clear flip, 0.3 px": replace(THESIS, w_G=(0.16, 1.04, 0.16), sigma_uv_px=0.3, sigma_d_px=0.3),
    "clear flip, 1 px, 5 % outliers": replace(THESIS, w_G=(0.16, 1.04, 0.16), outliers=0.05),
}
SOLVERS = ("ipopt", "gauss_newton")
PARTS = ("hypotheses", "pruning", "process noise", "solution", "covariance, verdicts")
SHORT_FRAMES, SHORT_LANDMARKS = (29, 58, 115), (600, 1200, 2430)


class Clock:
    """A listener that notes when the back end advances: once per hypothesis, then once per part."""

    def __init__(self) -> None:
        self.at = [time.process_time()]

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        del title, total
        self.at = [time.process_time()]
        yield lambda: self.at.append(time.process_time())

    def parts_s(self) -> Array:
        """(5,) seconds of PARTS."""
        ends = np.array([self.at[0], *self.at[-len(PARTS) :]])
        return np.asarray(np.diff(ends))


def print_scenes(seeds: int, scenes: dict[str, SyntheticScene]) -> None:
    """Seconds of each part of a cold start."""
    head = ("scene", "solver", "seed", "first motion", *PARTS, "together", "iterations at the end")
    print()
    print_table(head, _cold_starts(seeds, scenes))


def _cold_starts(seeds: int, scenes: dict[str, SyntheticScene]) -> Iterator[list[object]]:
    for title, scene in scenes.items():
        for seed in range(seeds):
            sequence = generate(scene, seed)
            for solver in SOLVERS:
                config, clock = Backend.model_validate({"solver": solver}), Clock()
                start = time.process_time()
                initial = initialize_motion(sequence.tracks, sequence.relative, config)
                first_s = time.process_time() - start
                estimate = estimate_motion(sequence.tracks, initial, config, clock)
                seconds = (first_s, *clock.parts_s(), time.process_time() - start)
                yield [title, solver, seed, *numbers(seconds, ".2f"), estimate.solver.iterations]


def warm() -> list[MotionEstimate]:
    """Load the compiled loops, by a small motion with each solver; at the first time they are compiled."""
    estimates = []
    small = generate(replace(THESIS, frames=12, landmarks=300, min_inliers=8), 0)
    for solver in SOLVERS:
        config = Backend.model_validate({"solver": solver})
        initial = initialize_motion(small.tracks, small.relative, config)
        estimates.append(estimate_motion(small.tracks, initial, config, Clock()))
    return estimates


def main(seeds: Seeds = 1, short: Short = False, output: Png = None) -> None:
    """Print the tables, draw the growth where a figure is asked for."""
    warm()
    print_solvers(measure(THESIS))
    print_scenes(1 if short else seeds, dict([*SCENES.items()][:1]) if short else SCENES)
    sizes = (SHORT_FRAMES, SHORT_LANDMARKS) if short else (FRAMES, LANDMARKS)
    grown = growth(*sizes)
    print_growth(*grown)
    if output is not None:
        draw_growth(output, *grown)


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds, numbers of iterations, and the size of the problem."""

    frames: int
    landmarks: int
    observations: int
    gauss_newton_s: float
    gauss_newton_iterations: int
    ipopt_s: float
    ipopt_iterations: int
    build_s: float
    answer_s: float
    """IPOPT from where Gauss-Newton ends, with building: what ``backend.solver: ipopt`` adds to a run"""
    answer_iterations: int
    covariance_s: float
    """All marginals, and the joint ones of the last state with inertia and centre of mass"""
    costs: tuple[float, float]
    """Where Gauss-Newton and IPOPT end"""


def measure(scene: SyntheticScene) -> PhaseTimes:
    """Time the parts on the measurements of a scene."""
    sequence, config = generate(scene, 0), Backend(solver="gauss_newton")
    data = motion_data(sequence.tracks, config)
    start = disturbed_start(sequence, data, config)
    fixed, x = linearization_point(data, start, TIGHT_GAUGE), start.vector()
    newton, program = GaussNewton(data), MotionProgram(data)
    gauss_newton_s = least(lambda: newton.solve(fixed, x, ITERATIONS))
    by_newton = newton.solve(fixed, x, ITERATIONS)
    ipopt_s = least(lambda: program.solve(fixed, x, ITERATIONS))
    # no iteration: all that it takes is the building
    build_s = least(lambda: MotionProgram(data).solve(fixed, x, 0))
    by_ipopt = program.solve(fixed, x, ITERATIONS)
    end, ended, _ = refine(GaussNewton(data, line_search=True), start, ITERATIONS)
    _, _, answer_iterations = refine(MotionProgram(data), end, ITERATIONS, before=ended.cost)
    weight = np.ones(len(data.frame))
    return PhaseTimes(
        scene.frames,
        data.n_landmarks,
        len(data.frame),
        gauss_newton_s,
        by_newton.iterations,
        ipopt_s,
        by_ipopt.iterations,
        build_s,
        least(lambda: refine(MotionProgram(data), end, ITERATIONS, before=ended.cost)),
        answer_iterations,
        least(lambda: covariances(MotionFit(data, end), weight)),
        (by_newton.cost, by_ipopt.cost),
    )


def disturbed_start(sequence: SyntheticSequence, data: MotionData, config: Backend) -> Iterate:
    """Off the truth, the inertia that of a sphere."""
    truth, rng = true_iterate(sequence, config), np.random.default_rng([0, 61])
    xi, R_inertia = data.form.coordinates(np.eye(3))

    def off(values: Array) -> Array:
        return values + 1e-3 * rng.normal(size=values.shape)

    turn = exp_so3(1e-3 * rng.normal(size=(truth.n_frames, 3)))
    return replace(
        truth,
        p_NG=off(truth.p_NG),
        R_NG=truth.R_NG @ turn,
        v_N=off(truth.v_N),
        w_G=off(truth.w_G),
        xi=xi,
        R_inertia=R_inertia,
        p_G=off(truth.p_G),
    )


def covariances(fit: MotionFit, weight: Array) -> None:
    """What a run does for its covariances."""
    at, m = fit.iterate, marginals(fit, weight)
    state_covariances(at, m, state_jacobians(at, axes_derivative(fit.data.form, at)))
    state_covariances(at, m, body_jacobians(at))


def least(work: Callable[[], object]) -> float:
    """Seconds that it takes at best."""
    seconds = []
    for _ in range(REPETITIONS):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def exponent(sizes: Array, seconds: Array) -> float:
    """Slope of ln(seconds) over ln(size)."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def print_solvers(times: PhaseTimes) -> None:
    """The table of one problem, and how it compares with what was asked for."""
    print(f"\n{times.frames} frames, {times.landmarks} landmarks, {times.observations} observations\n")
    rows = [
        [name, iterations, f"{seconds:.2f}", f"{1e3 * seconds / iterations:.0f}"]
        for name, seconds, iterations in (
            ("Gauss-Newton", times.gauss_newton_s, times.gauss_newton_iterations),
            ("IPOPT, solving", times.ipopt_s, times.ipopt_iterations),
        )
    ]
    rows.append(["IPOPT, building", "", f"{times.build_s:.2f}", ""])
    name = "IPOPT from where Gauss-Newton ends, with building"
    rows.append([name, times.answer_iterations, f"{times.answer_s:.2f}", ""])
    rows.append(["all marginals and the joint covariance", "", f"{times.covariance_s:.3f}", ""])
    print_table(" | iterations | seconds | ms per iteration", rows)
    a, b = times.costs
    print(f"\nThe costs differ by a relative {abs(a - b) / a:.1e}.")
    alone_s = times.ipopt_s + times.build_s
    found = (times.ipopt_s / times.gauss_newton_s, alone_s, times.answer_s, times.covariance_s)
    for (name, limit), value in zip(LIMITS.items(), found, strict=True):
        print(f"{name}: {value:.2f}, goal at most {limit:g}{'' if value <= limit else ' *'}")


def growth(frames: tuple[int, ...], landmarks: tuple[int, ...]) -> tuple[list[PhaseTimes], list[PhaseTimes]]:
    """Times along both sizes, the other one that of the thesis."""
    return (
        [measure(replace(THESIS, frames=n)) for n in frames],
        [measure(replace(THESIS, landmarks=n)) for n in landmarks],
    )


def print_growth(over_frames: list[PhaseTimes], over_landmarks: list[PhaseTimes]) -> None:
    """Rows of times, and the exponents."""
    rows = []
    for t in [*over_frames, *over_landmarks]:
        newton, ipopt, covariance = curves([t])[:, 0]
        steps = numbers((1e3 * newton, 1e3 * ipopt), ".0f")
        rows.append([t.frames, t.landmarks, t.observations, *steps, f"{covariance:.3f}"])
    head = "frames | landmarks | observations | Gauss-Newton ms/step | IPOPT ms/step | covariance s"
    print()
    print_table(head, rows)
    for name, times, sizes in _axes(over_frames, over_landmarks):
        found = ", ".join(f"{exponent(sizes, c):.2f}" for c in curves(times))
        print(f"exponents over {name}: {found}")


def curves(times: list[PhaseTimes]) -> Array:
    """(3, n) seconds: an iteration of Gauss-Newton, one of IPOPT, the covariance."""
    rows = [
        (t.gauss_newton_s / t.gauss_newton_iterations, t.ipopt_s / t.ipopt_iterations, t.covariance_s)
        for t in times
    ]
    return np.array(rows).T


def draw_growth(path: Path, over_frames: list[PhaseTimes], over_landmarks: list[PhaseTimes]) -> None:
    """Both curves, with the exponents in the legend."""
    figure, panels = subplots(1, 2, (11.0, 4.4), sharey=True)
    names = ("Gauss-Newton, an iteration", "IPOPT, an iteration", "all covariances")
    for axes, (title, times, sizes) in zip(panels, _axes(over_frames, over_landmarks), strict=True):
        for seconds, name, color in zip(curves(times), names, COLORS, strict=True):
            label = f"{name}: n^{exponent(sizes, seconds):.2f}"
            axes.loglog(sizes, seconds, "o-", color=color, linewidth=2.0, markersize=5, label=label)
        axes.set(xlabel=title, title=f"growth with {title}")
        axes.set_xticks(sizes, [f"{size:.0f}" for size in sizes])
        axes.minorticks_off()
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, fontsize=9)
    panels[0].set_ylabel("seconds")
    figure.tight_layout()
    save_figure(figure, path, 130)


def _axes(
    over_frames: list[PhaseTimes], over_landmarks: list[PhaseTimes]
) -> list[tuple[str, list[PhaseTimes], Array]]:
    return [
        ("frames", over_frames, np.array([t.frames for t in over_frames], dtype=np.float64)),
        ("landmarks", over_landmarks, np.array([t.landmarks for t in over_landmarks], dtype=np.float64)),
    ]


if __name__ == "__main__":
    command(main)
