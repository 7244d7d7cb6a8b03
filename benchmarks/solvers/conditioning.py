"""Condition number of the process covariance against the time step, before and after scaling (thesis 4.9).

Run: ``python -m benchmarks.solvers.conditioning -o docs/images/conditioning.png``. Left: translation as in
figure 4-6 (alpha = 1: position in m, velocity in m/s) and 4-8 (velocity divided by alpha), and in units that
follow the step. Right: rotation of a box that flips, as it is and as the back end scales it. By eq. 4.118 the
best step is sqrt(3) / alpha; the thesis's text says alpha sqrt(3).
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import command
from benchmarks.presentation import save_figure, subplots
from polhode.backend.dynamics.process_noise import rotation_covariance_scaled, translation_covariance
from polhode.lie import Array

ALPHAS = (0.1, 1.0, 10.0)
RATES_RPM = (0.0, 5.0, 20.0)
COLORS = ("#0072b2", "#009e73", "#d55e00")
BOX = np.diag([1.5, 1.2, 0.9])
FLIP = np.array([0.1, 0.99, 0.1])
"""Direction of the rate: near the middle axis, where errors grow."""


def main(output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="Figure.")]) -> None:
    """Draw the figure and print the numbers that it shows."""
    draw(output)
    for dt_s in (1e-3, 0.5, 10.0):
        dt = np.array([dt_s])
        plain, scaled = rotation_conditions(dt, 20.0)
        print(
            f"step {dt_s:6g} s: translation {translation_conditions(dt)[0]:.3g}, "
            f"scaled {scaled_translation_conditions(dt)[0]:.3g}; "
            f"rotation at 20 RPM {plain[0]:.3g}, scaled {scaled[0]:.3g}"
        )


def translation_conditions(dt_s: Array, alpha: float = 1.0) -> Array:
    """(n,) of (r, v / alpha) along one axis (eqs. 4.112, 4.118)."""
    unit = np.array([1.0, 1.0 / alpha])
    return np.asarray(np.linalg.cond(unit[:, None] * translation_covariance(dt_s, 1.0) * unit))


def scaled_translation_conditions(dt_s: Array) -> Array:
    """(n,) in the units dt^1.5 and dt^0.5, that is alpha = 1 / dt: the same for every step."""
    unit = np.stack([dt_s**-1.5, dt_s**-0.5], axis=1)
    return np.asarray(np.linalg.cond(unit[:, :, None] * translation_covariance(dt_s, 1.0) * unit[:, None, :]))


def rotation_conditions(dt_s: Array, rate_rpm: float) -> tuple[Array, Array]:
    """(n,) of the covariance of (theta, w) in rad and rad/s, and of the scaled one."""
    w = np.tile(FLIP / np.linalg.norm(FLIP) * rate_rpm * np.pi / 30.0, (len(dt_s), 1))
    cov, scale = rotation_covariance_scaled(w, BOX, dt_s, 1.0)
    return np.linalg.cond(cov * scale[:, :, None] * scale[:, None, :]), np.linalg.cond(cov)


def draw(path: Path) -> None:
    """The figure."""
    wide, used = np.logspace(-3, 3, 241), np.logspace(-3, 1, 121)
    figure, (left, right) = subplots(1, 2, (11.0, 4.4), sharey=True)
    for alpha, color in zip(ALPHAS, COLORS, strict=True):
        left.loglog(wide, translation_conditions(wide, alpha), color=color, label=rf"$\alpha$ = {alpha:g}")
    best = np.sqrt(3.0) / np.array(ALPHAS)
    least = [
        translation_conditions(np.array([step]), alpha)[0] for step, alpha in zip(best, ALPHAS, strict=True)
    ]
    left.loglog(best, least, "ko", markersize=5, label=r"best, at $\sqrt{3}/\alpha$ s")
    left.loglog(wide, scaled_translation_conditions(wide), "k", linewidth=2.2, label="scaled by the step")
    left.set(title="position and velocity", xlabel="time step [s]", ylabel="condition number")
    for rate, color in zip(RATES_RPM, COLORS, strict=True):
        plain, scaled = rotation_conditions(used, rate)
        right.loglog(used, plain, "--", color=color, label=f"{rate:g} RPM")
        right.loglog(used, scaled, color=color, linewidth=2.2, label=f"{rate:g} RPM, scaled")
    right.set(title="attitude and angular velocity, a flip", xlabel="time step [s]", ylim=(1.0, 1e9))
    for axes in (left, right):
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, fontsize=9)
    figure.tight_layout()
    save_figure(figure, path, 130)


if __name__ == "__main__":
    command(main)
