"""The simplified problem of Eaton and Naasz (2012): does (H^T H)^-1 foretell the errors of a pose?

    python -m benchmarks.edges.planar [-o docs/images/observability_planar.png]

Three edges on a flat model; the middle one slides from the top edge (nearly there in model 1) to the centre
(model 6, the most spread out). For each model so many cases with their own noise and a priori, solved by the
slides' one linear step and by Gauss-Newton to the end. Then: which power of the metric the errors follow,
what one step costs, how arccos fails, and the misprints in numbers. Some 20 s of one core.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from scipy.stats import linregress

from benchmarks.command import Png, command
from benchmarks.edges.planar_metric import (
    bearings,
    folded_bearings,
    gauss_newton,
    jacobian,
    linear_estimate,
    metric,
    printed_directions,
    wrapped,
)
from benchmarks.presentation import markdown_table, save_figure
from polhode.lie import Array

HALF_HEIGHT_M = 0.5
MODELS = 6
TRUTH = np.array([3.0, 0.2, np.deg2rad(10.0)])
"""p1, p2 [m], theta [rad]: off the axis and turned, so that no symmetry hides a trend."""
SIGMA_RAD = 2e-4
SPREAD = np.array([0.01, 0.01, np.deg2rad(0.5)])
"""Standard deviation of the a priori: 1 cm, 1 cm, 0.5 deg."""
CASES, MANY = 100, 10_000
REPEATS = 200
SPREADS = (1, 2, 5, 10, 20, 50)
OFFSETS_M = (0.0, 0.005, 0.01, 0.02, 0.05, 0.2)
SIZES_M = (0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
NAMES = ("p1", "p2", "theta")
UNITS = np.array([1e3, 1e3, 180.0 / np.pi])
"""To mm, mm, deg."""
MEAN_OVER_RMS = np.sqrt(2.0 / np.pi)
"""Mean absolute value of a normal variable over its standard deviation."""


@dataclass(frozen=True)
class Errors:
    """Errors of estimates minus truth, (cases, 3) [m, m, rad]."""

    one_step: Array
    converged: Array
    ended: Array
    """(cases,) whether Gauss-Newton converged"""


def model(middle_m: float, half_height_m: float = HALF_HEIGHT_M) -> Array:
    """(3, 2) top, middle and bottom edge of a flat model [m]."""
    return np.array([[0.0, half_height_m], [0.0, middle_m], [0.0, -half_height_m]])


def middles() -> Array:
    """(6,) the middle edge of models 1 to 6 [m], in equal steps from the top edge to the centre."""
    return np.asarray(HALF_HEIGHT_M * (1.0 - np.arange(1, MODELS + 1) / MODELS))


def monte_carlo(edges: Array, cases: int, seed: Iterable[int], spread: float = 1.0) -> Errors:
    """Cases with their own noise and a priori, the latter ``spread`` times SPREAD from the truth."""
    rng = np.random.default_rng(list(seed))
    prior = TRUTH + spread * SPREAD * rng.normal(size=(cases, 3))
    measured = bearings(TRUTH, edges) + SIGMA_RAD * rng.normal(size=(cases, len(edges)))
    found = gauss_newton(prior, edges, measured)
    one_step = _error(linear_estimate(prior, edges, measured))
    return Errors(one_step, _error(found.state), found.converged)


def _error(state: Array) -> Array:
    error = state - TRUTH
    error[..., 2] = wrapped(error[..., 2])
    return np.asarray(error)


def six_models(cases: int, seed: int) -> tuple[Array, list[Errors]]:
    """Diagonals of the metric at the truth (6, 3), and the errors for each model."""
    models = [model(middle) for middle in middles()]
    diagonal = np.array([np.diag(metric(TRUTH, edges)) for edges in models])
    return diagonal, [monte_carlo(edges, cases, (seed, k)) for k, edges in enumerate(models)]


def mean_errors(errors: Sequence[Errors], one_step: bool = False) -> Array:
    """(models, 3) mean absolute errors."""
    return np.array([np.abs(each.one_step if one_step else each.converged).mean(axis=0) for each in errors])


def exponent(diagonal: Array, errors: Array) -> float:
    """The power of the diagonal (models,) that the errors (models,) follow: 0.5 is its root."""
    return float(linregress(np.log(diagonal), np.log(errors)).slope)


def folded_errors(offset_m: float, cases: int, seed: int) -> tuple[float, Array, Array]:
    """One step of model 6 at p2 = offset: share of cases with an edge on the other side of the axis a priori
    than in truth; root mean square errors (3,) with atan2 and with arccos, of the same noise and a priori."""
    rng = np.random.default_rng([seed, round(1e4 * offset_m)])
    truth, edges = np.array([TRUTH[0], offset_m, TRUTH[2]]), model(0.0)
    prior = truth + SPREAD * rng.normal(size=(cases, 3))
    noise = SIGMA_RAD * rng.normal(size=(cases, len(edges)))
    signed = linear_estimate(prior, edges, bearings(truth, edges) + noise)
    side = np.sign(bearings(prior, edges))
    z = folded_bearings(truth, edges) + noise - folded_bearings(prior, edges)
    step = np.linalg.solve(side[..., None] * jacobian(prior, edges), z[..., None])[..., 0]
    crossed = float((side * np.sign(bearings(truth, edges)) < 0.0).any(axis=1).mean())
    return crossed, _rms(signed - truth), _rms(prior + step - truth)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt((values**2).mean(axis=0)))


def main(output: Png = None, seed: int = 0) -> None:
    """Print the tables, draw the figure where one is asked for."""
    print_models(seed)
    print_trends(seed)
    print_one_step(seed)
    print_folds(seed)
    print_misprints(seed)
    if output is not None:
        draw(output, seed)


def print_models(seed: int) -> None:
    """The six models: metric beside error."""
    diagonal, errors = six_models(CASES, seed)
    print(f"Six models, {CASES} cases each: root of the metric's diagonal, mean absolute error (converged)\n")
    head = ["model", "middle edge [m]", "root p1 [m/rad]", "root p2 [m/rad]", "root theta [rad/rad]"]
    head += ["p1 [mm]", "p2 [mm]", "theta [deg]", "RMSE over sigma root: p1", "p2", "theta"]
    ratio = np.array([_rms(each.converged) for each in errors]) / (SIGMA_RAD * np.sqrt(diagonal))
    means = mean_errors(errors) * UNITS
    rows = [
        [f"{k + 1}", f"{middle:.4f}"]
        + [f"{x:.2f}" for x in (*np.sqrt(diagonal[k]), *means[k])]
        + [f"{x:.3f}" for x in ratio[k]]
        for k, middle in enumerate(middles())
    ]
    print(markdown_table(head, rows) + "\n")
    way = np.linspace(-0.9, 0.9, 1801) * HALF_HEIGHT_M
    best = way[np.argmin([np.diag(metric(TRUTH, model(middle))) for middle in way], axis=0)]
    places = ", ".join(f"{place:+.3f} m ({name})" for name, place in zip(NAMES, best, strict=True))
    print(f"Anywhere between the outer ones the middle edge is best at {places}")
    print(f"All {MODELS * CASES} cases converged: {all(each.ended.all() for each in errors)}\n")


def print_trends(seed: int) -> None:
    """Straight lines through the six models, against the root of the metric and against the metric itself."""
    print("Trend of the mean absolute error over the six models: error = slope * metric + intercept, in SI.")
    print(f"Theory, for the root: slope {SIGMA_RAD * MEAN_OVER_RMS:.4e} rad, intercept 0, exponent 0.5\n")
    head = ["component", "estimate", "cases", "against", "correlation", "slope"]
    head += ["intercept (its sigma)", "unit of the intercept", "exponent of the diagonal"]
    rows = []
    for cases, one_step in ((CASES, True), (CASES, False), (MANY, False)):
        diagonal, errors = six_models(cases, seed)
        means = mean_errors(errors, one_step)
        for i, name in enumerate(NAMES):
            for label, x in (("root", np.sqrt(diagonal[:, i])), ("diagonal", diagonal[:, i])):
                line = linregress(x, means[:, i])
                at_zero = f"{line.intercept * UNITS[i]:+.3f} ({line.intercept_stderr * UNITS[i]:.3f})"
                power = f"{exponent(diagonal[:, i], means[:, i]):.3f}"
                how = "one step" if one_step else "converged"
                row = [name, how, f"{cases}", label, f"{line.rvalue:.4f}", f"{line.slope:.3e}", at_zero]
                rows.append([*row, "deg" if i == 2 else "mm", power])
    print(markdown_table(head, rows) + "\n")
    correlations, exponents = repeated(seed)
    low, middle, high = np.quantile(exponents, [0.025, 0.5, 0.975], axis=0)
    print(f"Over {REPEATS} repetitions of {CASES} cases a model, against the root:")
    for i, name in enumerate(NAMES):
        print(
            f"{name}: least correlation {correlations[:, i].min():.4f}, "
            f"median {np.median(correlations[:, i]):.4f}; "
            f"exponent {middle[i]:.3f}, 95 % in {low[i]:.3f} to {high[i]:.3f}"
        )
    print()


def repeated(seed: int) -> tuple[Array, Array]:
    """(REPEATS, 3) correlations with the root, and exponents of the diagonal."""
    correlations, exponents = np.zeros((REPEATS, 3)), np.zeros((REPEATS, 3))
    for r in range(REPEATS):
        diagonal, errors = six_models(CASES, seed + 1 + r)
        means = mean_errors(errors)
        for i in range(3):
            correlations[r, i] = np.corrcoef(np.sqrt(diagonal[:, i]), means[:, i])[0, 1]
            exponents[r, i] = exponent(diagonal[:, i], means[:, i])
    return correlations, exponents


def print_one_step(seed: int) -> None:
    """What the slides' single step costs, by the distance of the a priori."""
    print(f"One linear step against convergence, {MANY} cases: RMSE over sigma root of the metric;")
    print("of the converged estimate: over the cases that converged\n")
    rows = []
    for k in (1, MODELS):
        edges = model(middles()[k - 1])
        expected = SIGMA_RAD * np.sqrt(np.diag(metric(TRUTH, edges)))
        for spread in SPREADS:
            errors = monte_carlo(edges, MANY, (seed, k, spread), spread)
            cm_deg = f"{100 * spread * SPREAD[0]:g} cm, {np.rad2deg(spread * SPREAD[2]):g} deg"
            both = [*_rms(errors.one_step) / expected, *_rms(errors.converged[errors.ended]) / expected]
            rows.append([f"{k}", cm_deg, *(f"{x:.2f}" for x in both), f"{errors.ended.mean():.2%}"])
    head = ["model", "a priori off by (sigma)", *(f"one step: {name}" for name in NAMES)]
    print(markdown_table([*head, *(f"converged: {name}" for name in NAMES), "share converged"], rows) + "\n")


def print_folds(seed: int) -> None:
    """What arccos does to an edge near the axis."""
    print(f"arccos against atan2: model 6, theta 10 deg, one step, {MANY} cases; RMSE\n")
    rows = []
    for offset in OFFSETS_M:
        crossed, signed, folded = folded_errors(offset, MANY, seed)
        both = [f"{x:.2f}" for pair in zip(signed * UNITS, folded * UNITS, strict=True) for x in pair]
        rows.append([f"{100 * offset:g}", f"{100 * crossed:.1f} %", *both])
    head = ["p2 [cm]", "cases with a folded edge"]
    units = ("mm", "mm", "deg")
    for name, unit in zip(NAMES, units, strict=True):
        head += [f"{name} atan2 [{unit}]", f"{name} arccos [{unit}]"]
    print(markdown_table(head, rows) + "\n")
    upside_down = np.array([TRUTH[0], -TRUTH[1], np.pi - TRUTH[2]])
    same = np.abs(folded_bearings(TRUTH, model(0.1)) - folded_bearings(upside_down, model(0.1))).max()
    print(
        f"arccos of a flat model at (p1, p2, theta) and at (p1, -p2, pi - theta): differ by {same:.0e} rad\n"
    )


def print_misprints(seed: int) -> None:
    """The sign in s2, and "a lower H^T H"."""
    edge = np.array([[0.3, 0.2]])
    print(f"Length of an edge at {edge[0]} m, turned as printed (last term - e2 cos theta) and by R(theta)\n")
    rows = []
    for degrees in (0.0, 10.0, 30.0, 45.0, 90.0):
        state = np.array([0.0, 0.0, np.deg2rad(degrees)])
        basis = printed_directions(state, np.eye(2)).T
        length = np.linalg.norm(printed_directions(state, edge))
        determinant = np.round(np.linalg.det(basis), 4) + 0.0  # without a sign of 0
        rows.append([f"{degrees:g}", *(f"{x:.4f}" for x in (length, np.linalg.norm(edge), determinant))])
    print(
        markdown_table(
            ["theta [deg]", "printed [m]", "turned [m]", "determinant of the printed matrix"], rows
        )
        + "\n"
    )
    print("Correlation of the mean absolute error with the diagonals, over six models\n")
    rows = []
    slid = [model(middle) for middle in middles()]
    grown = [model(0.0, size) for size in SIZES_M]
    for label, models in (("the middle edge slid", slid), ("the whole model grown", grown)):
        errors = mean_errors([monte_carlo(edges, CASES, (seed, k)) for k, edges in enumerate(models)])
        H = [jacobian(TRUTH, edges) for edges in models]
        plain = np.array([np.diag(each.T @ each) for each in H])
        inverse = np.array([np.diag(metric(TRUTH, edges)) for edges in models])
        for what, diagonal in (("H^T H", plain), ("(H^T H)^-1", inverse)):
            r = [np.corrcoef(diagonal[:, i], errors[:, i])[0, 1] for i in range(3)]
            change = diagonal[-1] / diagonal[0]
            rows.append([label, what, *(f"{x:+.3f}" for x in r), *(f"{x:.3g}" for x in change)])
    head = ["models", "diagonal of", *NAMES, *(f"{name}: last over first model" for name in NAMES)]
    print(markdown_table(head, rows) + "\n")


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
    save_figure(figure, path, 110)


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


if __name__ == "__main__":
    command(main)
