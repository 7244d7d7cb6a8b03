"""Time of the back end on measurements of the thesis's size: each part, both solvers, growth; errors beside.

    python -m benchmarks.solvers.backend_size [--seeds 1] [--short] [-o PNG]

115 frames, about 2,400 landmarks and 24,200 stereo observations, process noise of the thesis, one BLAS
thread. First the solvers alone on one problem, then whole cold starts with the default configuration (the
process noise is estimated) by either solver, then the growth, drawn with ``-o``. ``--short``: one scene, the
growth at small sizes. Seconds are those of the processor, on one thread: of a free core, those of the clock.

Attitude and angular velocity are compared in N after the one constant body rotation that fits best
(CONTRACT.md, metrics). "error / sigma" divides each error by the stated standard deviation; for attitude and
rate that would include the rotation of the axes, which the comparison takes out, so it is not printed.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.solvers.solver_times import (
    FRAMES,
    LANDMARKS,
    THESIS,
    draw_growth,
    growth,
    measure,
    print_growth,
    print_solvers,
)
from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend import Backend
from polhode.lie import Array, inverse_pose, log_so3, transform_points
from polhode.progress import Advance
from polhode.records import MotionEstimate
from polhode.simulation.monte_carlo.measurements import SyntheticScene, SyntheticSequence, generate
from polhode.threads import limit_threads

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


def figures(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Errors: r mm, v mm/s, attitude deg, w deg/s, com mm, k1, k2."""
    truth, mass = sequence.truth, estimate.mass
    D = np.swapaxes(estimate.R_NP, 1, 2) @ truth.R_NP
    fit = Rotation.from_matrix(D).mean().as_matrix()
    attitude = np.median(np.linalg.norm(log_so3(fit.T @ D), axis=1))
    w_error = np.einsum("fij,fj->fi", estimate.R_NP, estimate.w_P) - np.einsum(
        "fij,fj->fi", truth.R_NP, truth.w_P
    )
    in_G = transform_points(inverse_pose(estimate.X_NG), truth.r_N[:, None])[:, 0].mean(axis=0)

    def rms(e: Array) -> float:
        return float(np.sqrt(np.mean(np.sum(e**2, axis=1))))

    return np.array(
        [
            1e3 * rms(estimate.r_N - truth.r_N),
            1e3 * rms(estimate.v_N - truth.v_N),
            np.rad2deg(attitude),
            np.rad2deg(rms(w_error)),
            1e3 * float(np.linalg.norm(mass.com_G - in_G)),
            mass.k1 - truth.k1,
            mass.k2 - truth.k2,
        ]
    )


def stated(estimate: MotionEstimate) -> Array:
    """Standard deviations of the figures, in their order; not a number for attitude and rate."""
    variance = np.diagonal(estimate.covariance, axis1=1, axis2=2).reshape(-1, 4, 3).sum(axis=2)
    r, v = np.sqrt(np.mean(variance[:, :2], axis=0))
    com = np.sqrt(np.trace(estimate.mass.cov_com_G))
    k = np.sqrt(np.diag(estimate.mass.cov_k))
    return np.array([1e3 * r, 1e3 * v, np.nan, np.nan, 1e3 * com, *k])


def print_scenes(seeds: int, scenes: dict[str, SyntheticScene]) -> None:
    """Three rows per scene, solver and seed: errors, errors over stated standard deviations, seconds."""
    names = ["r mm", "v mm/s", "att deg", "w deg/s", "com mm", "err k1", "err k2"]
    header = "".join(f"{name:>9s}" for name in names)
    for title, scene in scenes.items():
        print(f"\n{title}\nsolver        seed  {header}")
        for seed in range(seeds):
            sequence = generate(scene, seed)
            for solver in SOLVERS:
                _print_scene(sequence, solver, seed)


def _print_scene(sequence: SyntheticSequence, solver: str, seed: int) -> None:
    config, clock = Backend.model_validate({"solver": solver}), Clock()
    start = time.process_time()
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    middle = time.process_time()
    estimate = estimate_motion(sequence.tracks, initial, config, clock)
    end = time.process_time()
    errors = figures(sequence, estimate)
    ratios = np.abs(errors) / stated(estimate)
    print(
        f"{solver:13s} {seed:4d}  "
        + "".join(f"{value:9.3f}" for value in errors[:5])
        + "".join(f"  {value:+.4f}" for value in errors[5:])
    )
    print(
        "     error / sigma  " + "".join(" " * 9 if np.isnan(value) else f"{value:9.2f}" for value in ratios)
    )
    parts = zip(PARTS, clock.parts_s(), strict=True)
    print(
        f"     seconds: first motion {middle - start:.2f}, "
        + ", ".join(f"{name} {seconds:.2f}" for name, seconds in parts)
        + f"; together {end - start:.2f}; {estimate.solver.iterations} iterations at the end",
        flush=True,
    )


def warm() -> list[MotionEstimate]:
    """Load the compiled loops, by a small motion with each solver; at the first time they are compiled."""
    estimates = []
    small = generate(replace(THESIS, frames=12, landmarks=300, min_inliers=8), 0)
    for solver in SOLVERS:
        config = Backend.model_validate({"solver": solver})
        initial = initialize_motion(small.tracks, small.relative, config)
        estimates.append(estimate_motion(small.tracks, initial, config, Clock()))
    return estimates


def run(seeds: int, short: bool, png: Path | None) -> None:
    """Everything that is printed."""
    warm()
    print_solvers(measure(THESIS))
    print_scenes(1 if short else seeds, dict([*SCENES.items()][:1]) if short else SCENES)
    sizes = (SHORT_FRAMES, SHORT_LANDMARKS) if short else (FRAMES, LANDMARKS)
    grown = growth(*sizes)
    print_growth(*grown)
    if png is not None:
        draw_growth(png, *grown)


def main() -> None:
    """In a new process, which reads the limit of threads before it loads NumPy."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="sequences per scene")
    parser.add_argument("--short", action="store_true", help="one scene, small sizes")
    parser.add_argument("-o", "--output", type=Path, help="PNG of the growth")
    options = parser.parse_args()
    limit_threads(1)
    with get_context("spawn").Pool(1) as pool:
        pool.apply(run, (options.seeds, options.short, options.output))


if __name__ == "__main__":
    main()
