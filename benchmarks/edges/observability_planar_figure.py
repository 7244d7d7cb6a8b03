"""The slides' "Proof of Concept" and "Trends", a column for each degree of freedom."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.stats import linregress

from benchmarks.edges.observability_planar import (
    CASES,
    HALF_HEIGHT_M,
    MEAN_OVER_RMS,
    SIGMA_RAD,
    TRUTH,
    UNITS,
    mean_errors,
    middles,
    model,
    six_models,
)
from benchmarks.edges.planar_metric import metric
from polhode.lie import Array

TITLES = ("range $p_1$", "offset $p_2$", r"attitude $\theta$")
ERRORS = ("mean error of $p_1$ [mm]", "mean error of $p_2$ [mm]", r"mean error of $\theta$ [deg]")
ROOT_UNITS, SQUARE_UNITS = ("m/rad", "m/rad", "rad/rad"), ("m²/rad²", "m²/rad²", "1")
THEORY, POINTS, FIT = "#33556e", "#b3261e", "#d58f00"


def draw(path: Path, seed: int) -> None:
    """The figure of 100 cases a model, with what theory foretells."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    diagonal, errors = six_models(CASES, seed)
    means = mean_errors(errors) * UNITS
    figure, panels = plt.subplots(3, 3, figsize=(12.0, 10.2), layout="constrained")
    for i in range(3):
        _proof(panels[0, i], i, means[:, i])
        _trend(panels[1, i], i, diagonal[:, i], means[:, i], root=True)
        _trend(panels[2, i], i, diagonal[:, i], means[:, i], root=False)
    for axes in panels.flat:
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _proof(axes: Axes, i: int, means: Array) -> None:
    """Errors of the six models, along the whole way of the middle edge."""
    way = HALF_HEIGHT_M * np.linspace(-0.9, 0.9, 181)
    root = np.array([np.sqrt(metric(TRUTH, model(middle))[i, i]) for middle in way])
    axes.plot(way, MEAN_OVER_RMS * SIGMA_RAD * root * UNITS[i], color=THEORY, label="from the geometry alone")
    axes.plot(middles(), means, "o", color=POINTS, label=f"mean of {CASES} cases")
    for k, (middle, mean) in enumerate(zip(middles(), means, strict=True)):
        axes.annotate(f"{k + 1}", (middle, mean), xytext=(0, 7), textcoords="offset points", ha="center")
    axes.set_xlim(HALF_HEIGHT_M, -HALF_HEIGHT_M)
    axes.set_ylim(0.0, 1.35 * means.max())
    axes.set(title=TITLES[i], ylabel=ERRORS[i], xlabel="place of the middle edge [m]")


def _trend(axes: Axes, i: int, diagonal: Array, means: Array, root: bool) -> None:
    """Errors against the root of the metric, or against the metric, with straight line and theory."""
    x = np.sqrt(diagonal) if root else diagonal
    along = np.linspace(0.0, 1.05 * x.max(), 200)
    line = linregress(x, means)
    foretold = MEAN_OVER_RMS * SIGMA_RAD * UNITS[i] * (along if root else np.sqrt(along))
    axes.plot(along, foretold, color=THEORY, label=r"$\sigma\,\sqrt{2/\pi}\,\sqrt{(H^TH)^{-1}_{ii}}$")
    fit = f"straight line, correlation {line.rvalue:.3f}, at 0: {line.intercept:.2f}"
    axes.plot(along, line.intercept + line.slope * along, "--", color=FIT, label=fit)
    axes.plot(x, means, "o", color=POINTS)
    axes.set_xlim(0.0, along[-1])
    axes.set_ylim(0.0, 1.35 * means.max())
    unit = ROOT_UNITS[i] if root else SQUARE_UNITS[i]
    name = r"$\sqrt{(H^TH)^{-1}_{ii}}$" if root else r"$(H^TH)^{-1}_{ii}$"
    axes.set(xlabel=f"{name} [{unit}]", ylabel=ERRORS[i])
