"""A run's prediction against the truth that came after it, as in the thesis's figures 6-23 to 6-26.

    python -m lab.end_to_end.prediction_error RUN SEQ -o PNG [--horizon 60]

Attitude and position that were predicted from the last state, the truth, their difference and three standard
deviations of the body itself (``polhode predict --marks``), whose G is exact at the first frame
(``lab/missions/predictions.py``). Prints errors and sigmas at 10, 30 and 60 s, and the share inside three
sigma.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import command
from lab.missions.predictions import body_errors
from lab.presentation import save_figure, subplots
from polhode.geometry.lie import Array, continuous_wxyz, wxyz_from_matrix
from polhode.planning.predict import predict_run
from polhode.records.metrics import truth_at
from polhode.records.read_truth import read_truth
from polhode.run_directory.trajectory_file import read_trajectory, standard_deviations

COLORS = ("#d55e00", "#009e73", "#0072b2")
SHOWN_S = (10.0, 30.0, 60.0)


@dataclass(frozen=True)
class PredictionErrors:
    """Of one quantity."""

    name: str
    unit: str
    error: Array
    """(T, 3)"""
    sigma: Array
    """(T, 3)"""

    def line(self, time_s: Array) -> str:
        """Lengths of the error and of its sigma at some times, and the share inside three sigma."""
        at = [int(np.argmin(np.abs(time_s - s))) for s in SHOWN_S if s <= time_s[-1] + 1e-6]
        lengths = ", ".join(
            f"{np.linalg.norm(self.error[k]):.3g} (sigma {np.linalg.norm(self.sigma[k]):.3g}) {self.unit} "
            f"after {time_s[k]:.0f} s"
            for k in at
        )
        inside = np.mean(np.abs(self.error) < 3.0 * self.sigma)
        return f"{self.name}: {lengths}; inside three sigma {inside:.1%}"


def main(
    run: Positional[Path],
    sequence: Positional[Path],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="Figure.")],
    horizon: Annotated[float, arg(help="Seconds ahead.")] = 60.0,
) -> None:
    """Draw the figure and print its numbers."""
    time_s, quaternions, errors = compare(run, sequence, horizon)
    for each in errors:
        print(each.line(time_s))
    draw(output, time_s, quaternions, errors)


def compare(
    run: Path, sequence: Path, horizon_s: float
) -> tuple[Array, tuple[Array, Array], tuple[PredictionErrors, PredictionErrors]]:
    """Times (T,) after the last pair, true and predicted quaternions (T, 4) in the true axes, and the errors.

    Raises InputError when the truth does not reach that far.
    """
    seen, ahead, truth = read_trajectory(run), predict_run(run, horizon_s), read_truth(sequence)
    came, first = truth_at(truth, ahead.timestamps_ns), truth_at(truth, seen.timestamps_ns[:1])
    error, sigma = body_errors(ahead, seen, truth, first), standard_deviations(ahead.covariance_of_marks)
    # the true axes, of which the estimate's G was a copy at the first frame
    predicted = ahead.X_NG[:, :3, :3] @ ahead.R_GP @ seen.R_NP[0].T @ first.R_NP[0]
    q, q_predicted = continuous_wxyz(wxyz_from_matrix(came.R_NP)), wxyz_from_matrix(predicted)
    q_predicted *= np.sign(np.sum(q * q_predicted, axis=1, keepdims=True))
    errors = (
        PredictionErrors("attitude", "deg", np.rad2deg(error[:, 6:9]), np.rad2deg(sigma[:, 6:9])),
        PredictionErrors("position", "mm", 1e3 * error[:, 0:3], 1e3 * sigma[:, 0:3]),
    )
    return ahead.time_s, (q, q_predicted), errors


def draw(
    path: Path, time_s: Array, quaternions: tuple[Array, Array], errors: tuple[PredictionErrors, ...]
) -> None:
    """Attitude, its error, the error of the position."""
    figure, (top, *below) = subplots(3, 1, (9.0, 8.4), sharex=True)
    for k, (name, color) in enumerate(zip("wxyz", ("#5d6b78", *COLORS), strict=True)):
        top.plot(time_s, quaternions[0][:, k], color=color, linewidth=2.4, alpha=0.45)
        top.plot(time_s, quaternions[1][:, k], color=color, linewidth=1.2, linestyle="--", label=name)
    top.set(ylabel="quaternion $q_{NP}$", title="predicted (dashed) and true (solid)")
    for axes, each in zip(below, errors, strict=True):
        for k, (name, color) in enumerate(zip("xyz", COLORS, strict=True)):
            band = 3.0 * each.sigma[:, k]
            axes.fill_between(time_s, -band, band, color=color, alpha=0.13)
            axes.plot(time_s, each.error[:, k], color=color, label=name)
        axes.set(ylabel=f"{each.name} error [{each.unit}]")
    below[0].set_title("bands: three standard deviations", fontsize=10)
    below[1].set(xlabel="time after the last stereo pair [s]")
    for axes in (top, *below):
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, ncols=4, fontsize=9, loc="upper left")
    figure.tight_layout()
    save_figure(figure, path, 120)


if __name__ == "__main__":
    command(main)
