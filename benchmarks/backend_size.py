"""Time and accuracy of the back end on measurements of the thesis's size.

Run: ``python -m benchmarks.backend_size [seeds] [--short]`` (short: the first scene, one seed). Motion:
intermediate-axis tumble at 10 RPM, 115 frames, about 2,400 landmarks and 24,700 stereo observations, 1 px,
process noise of the thesis. Attitude and angular velocity are compared in N after the one constant body
rotation that fits best (CONTRACT.md, metrics). "error / sigma" divides each error by the stated standard
deviation, the Cramer-Rao bound at the solution; for attitude and rate that would include the rotation of the
axes, which the comparison takes out, so it is not printed.
"""

import sys
import time
from multiprocessing import get_context

import numpy as np
from scipy.spatial.transform import Rotation

from backend import estimate_motion, initialize_motion
from pipeline.threads import limit_threads
from polhode.config.backend import Backend
from polhode.lie import Array, inverse_pose, log_so3, transform_points
from polhode.progress import Silent
from polhode.records import MotionEstimate
from simulation.measurements import SyntheticScene, SyntheticSequence, generate

SCENES = {
    "spin of 10 RPM near the middle axis, 1 px": SyntheticScene(),
    "clear flip, 1 px": SyntheticScene(w_G=(0.16, 1.04, 0.16)),
    "clear flip, 0.3 px": SyntheticScene(w_G=(0.16, 1.04, 0.16), sigma_uv_px=0.3, sigma_d_px=0.3),
    "clear flip, 1 px, 5 % outliers": SyntheticScene(w_G=(0.16, 1.04, 0.16), outliers=0.05),
}


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


def main(seeds: int, scenes: dict[str, SyntheticScene]) -> None:
    """Print two rows per scene, solver and seed: errors, and errors over stated standard deviations."""
    names = ["r mm", "v mm/s", "att deg", "w deg/s", "com mm", "err k1", "err k2"]
    header = "".join(f"{name:>9s}" for name in names) + "  init s  solve s  iterations"
    for title, scene in scenes.items():
        print(f"\n{title}\nsolver        seed  {header}")
        for seed in range(seeds):
            sequence = generate(scene, seed)
            for solver in ("ipopt", "gauss_newton"):
                config = Backend.model_validate({"solver": solver})
                start = time.perf_counter()
                initial = initialize_motion(sequence.tracks, sequence.relative, config)
                middle = time.perf_counter()
                estimate = estimate_motion(sequence.tracks, initial, config, Silent())
                end = time.perf_counter()
                errors = figures(sequence, estimate)
                ratios = np.abs(errors) / stated(estimate)
                print(
                    f"{solver:13s} {seed:4d}  "
                    + "".join(f"{value:9.3f}" for value in errors[:5])
                    + "".join(f"  {value:+.4f}" for value in errors[5:])
                    + f"  {middle - start:6.1f}  {end - middle:7.1f}  {estimate.solver.iterations:6d}\n"
                    + "     error / sigma  "
                    + "".join(" " * 9 if np.isnan(value) else f"{value:9.2f}" for value in ratios),
                    flush=True,
                )


if __name__ == "__main__":
    short = "--short" in sys.argv
    counts = [int(argument) for argument in sys.argv[1:] if argument.isdigit()]
    limit_threads(1)
    # in a new process, which reads the limit before it loads NumPy
    with get_context("spawn").Pool(1) as pool:
        pool.apply(
            main, (1 if short else (counts or [2])[0], dict([*SCENES.items()][:1]) if short else SCENES)
        )
