"""A run's prediction against the truth that came after it, as in the thesis's figures 6-23 to 6-26.

    python -m benchmarks.end_to_end.prediction_error RUN SEQ -o PNG [--horizon 60]

Attitude and position that were predicted from the last state, the truth, their difference and three standard
deviations of the body itself (``polhode predict --marks``). As in metrics.json, the attitude is compared
after the constant rotation between estimated and true axes; the place is that of the body's mark at the
estimated centre of mass. Prints errors and sigmas at 10, 30 and 60 s, and the share inside three sigma.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.presentation import save_figure, subplots
from polhode.lie import Array, continuous_wxyz, log_so3, wxyz_from_matrix
from polhode.metrics import States, constant_body_rotation, motion_errors, truth_at, with_half_turn
from polhode.pipeline.after_run.predict import predict_run
from polhode.pipeline.run_directory.trajectory_file import read_trajectory, standard_deviations
from polhode.truth import read_truth

COLORS = ("#d55e00", "#009e73", "#0072b2")
SHOWN_S = (10.0, 30.0, 60.0)


@dataclass(frozen=True)
class PredictionComparison:
    """A prediction and the truth."""

    time_s: Array
    """(T,) after the last pair"""
    q_NP_wxyz: Array
    """(T, 4) predicted, in the true axes"""
    q_NP_true_wxyz: Array
    """(T, 4)"""
    attitude_deg: Array
    """(T, 3) errors along the axes"""
    sigma_attitude_deg: Array
    """(T, 3)"""
    place_mm: Array
    """(T, 3) errors along N"""
    sigma_place_mm: Array
    """(T, 3)"""


def main(
    run: Positional[Path],
    sequence: Positional[Path],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="Figure.")],
    horizon: Annotated[float, arg(help="Seconds ahead.")] = 60.0,
) -> None:
    """Draw the figure and print its numbers."""
    found = compare(run, sequence, horizon)
    draw(found, output)
    for name, unit, error, sigma in (
        ("attitude", "deg", found.attitude_deg, found.sigma_attitude_deg),
        ("position", "mm", found.place_mm, found.sigma_place_mm),
    ):
        inside = np.mean(np.abs(error) < 3.0 * sigma)
        at = [int(np.argmin(np.abs(found.time_s - s))) for s in SHOWN_S if s <= found.time_s[-1] + 1e-6]
        numbers = ", ".join(
            f"{np.linalg.norm(error[k]):.3g} (sigma {np.linalg.norm(sigma[k]):.3g}) {unit} "
            f"after {found.time_s[k]:.0f} s"
            for k in at
        )
        print(f"{name}: {numbers}; inside three sigma {inside:.1%}")


def compare(run: Path, sequence: Path, horizon_s: float) -> PredictionComparison:
    """Predict and read the truth. Raises InputError when the truth does not reach that far."""
    seen, prediction, truth = read_trajectory(run), predict_run(run, horizon_s), read_truth(sequence)
    estimate = States(seen.timestamps_ns, seen.r_N, seen.v_N, seen.R_NP, seen.w_P)
    at_frames = truth_at(truth, estimate.timestamps_ns)
    half_turn = motion_errors(estimate, at_frames).half_turn
    R_fit = constant_body_rotation(with_half_turn(estimate, half_turn), at_frames)
    states = prediction
    ahead = States(prediction.timestamps_ns, states.r_N, states.v_N, states.R_NP, states.w_P)
    came = truth_at(truth, prediction.timestamps_ns)
    R_NP = with_half_turn(ahead, half_turn).R_NP @ R_fit
    # where the mark at the estimated centre of mass lies in the true body, by all frames of the run
    offset_P = np.mean(np.einsum("fji,fj->fi", at_frames.R_NP, estimate.r_N - at_frames.r_N), axis=0)
    place = ahead.r_N - came.r_N - came.R_NP @ offset_P
    sigma = standard_deviations(states.covariance_of_marks)
    theta = log_so3(np.swapaxes(came.R_NP, 1, 2) @ R_NP)
    q = continuous_wxyz(wxyz_from_matrix(came.R_NP))
    q_predicted = wxyz_from_matrix(R_NP)
    q_predicted *= np.sign(np.sum(q * q_predicted, axis=1, keepdims=True))
    return PredictionComparison(
        states.time_s,
        q_predicted,
        q,
        np.rad2deg(theta),
        np.rad2deg(sigma[:, 6:9]),
        1e3 * place,
        1e3 * sigma[:, 0:3],
    )


def draw(found: PredictionComparison, path: Path) -> None:
    """Attitude, its error, the error of the position."""
    figure, (top, middle, bottom) = subplots(3, 1, (9.0, 8.4), sharex=True)
    for k, (name, color) in enumerate(zip("wxyz", ("#5d6b78", *COLORS), strict=True)):
        top.plot(found.time_s, found.q_NP_true_wxyz[:, k], color=color, linewidth=2.4, alpha=0.45)
        top.plot(found.time_s, found.q_NP_wxyz[:, k], color=color, linewidth=1.2, linestyle="--", label=name)
    top.set(ylabel="quaternion $q_{NP}$", title="predicted (dashed) and true (solid)")
    for axes, error, sigma, label in (
        (middle, found.attitude_deg, found.sigma_attitude_deg, "attitude error [deg]"),
        (bottom, found.place_mm, found.sigma_place_mm, "position error [mm]"),
    ):
        for k, (name, color) in enumerate(zip("xyz", COLORS, strict=True)):
            axes.fill_between(found.time_s, -3.0 * sigma[:, k], 3.0 * sigma[:, k], color=color, alpha=0.13)
            axes.plot(found.time_s, error[:, k], color=color, label=name)
        axes.set(ylabel=label)
    bottom.set(xlabel="time after the last stereo pair [s]")
    for axes in (top, middle, bottom):
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, ncols=4, fontsize=9, loc="upper left")
    middle.set_title("bands: three standard deviations", fontsize=10)
    figure.tight_layout()
    save_figure(figure, path, 120)


if __name__ == "__main__":
    command(main)
