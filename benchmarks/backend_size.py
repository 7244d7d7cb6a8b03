"""Time and accuracy of the back end on measurements of the thesis's size.

Run: ``python -m benchmarks.backend_size [seeds]``. Motion: intermediate-axis tumble at 10 RPM, 115 frames,
about 2,400 landmarks and 24,700 stereo observations, 1 px, process noise of the thesis. Attitude and angular
velocity are compared in N after the one constant body rotation that fits best (CONTRACT.md, metrics).
"""

import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

from backend import estimate_motion, initialize_motion
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
    """Errors: r mm, v mm/s, attitude deg, w deg/s, com mm, k1, k2, then the stated sigmas of k1, k2."""
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
            *np.sqrt(np.diag(mass.cov_k)),
        ]
    )


def main(seeds: int) -> None:
    """Print one row per scene, solver and seed."""
    names = ["r mm", "v mm/s", "att deg", "w deg/s", "com mm", "err k1", "err k2", "sig k1", "sig k2"]
    header = "".join(f"{name:>9s}" for name in names) + "  init s  solve s  iterations"
    for title, scene in SCENES.items():
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
                row = figures(sequence, estimate)
                errors = "".join(f" {value:8.3f}" for value in row[:5])
                print(
                    f"{solver:13s} {seed:4d} {errors}"
                    + "".join(f"  {value:+.4f}" for value in row[5:])
                    + f"  {middle - start:6.1f}  {end - middle:7.1f}  {estimate.solver.iterations:6d}",
                    flush=True,
                )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
