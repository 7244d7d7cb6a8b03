"""The simplified problem of Eaton and Naasz (2012): does (H^T H)^-1 predict the errors of a pose?

    python -m benchmarks.edges.planar [-o docs/images/observability_planar.png]

A rigid flat model moves in a plane before a camera at the origin that looks along the first axis (C). State
x = (p1, p2, theta): position of the model's origin along the two axes of C [m] and its rotation [rad]. An
edge is a point e (2,) of the model [m]; it is seen in the direction ``s = p + R(theta) e`` at the bearing

    phi = atan2(s2, s1)   [rad], in (-pi, pi]

The slides write arccos, which has no sign (``folded_bearings``), and print the last term of s2 as
``- e2 cos(theta)``, which is no rotation (``printed_directions``). See docs/observability_planar.md.
With H = d phi / d x (n, 3) and bearings of standard deviation sigma, the covariance of the least-squares
state is sigma^2 (H^T H)^-1.

Three edges on a flat model; the middle one moves from the top edge (nearly there in model 1) to the centre
(model 6, the most spread out). Each model has many cases with their own noise and a priori, solved by the
slides' one linear step and by Gauss-Newton to convergence. Then: which power of the metric the errors follow,
what one step costs, how arccos fails, and the misprints in numbers. Some 20 s of one core.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import linregress

from benchmarks.command import Png, command
from benchmarks.presentation import numbers, print_table, save_figure, subplots
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


SINGULAR = 1e-10
"""Singular values of H, columns scaled to length 1, that count as zero; relative to the largest."""
ROUNDING = 1e-13
"""A column of H shorter than this share of what it could be is 0."""
SHARE = 1e-6
"""A component with a larger share in an unobservable direction is unobservable."""
MAX_ITERATIONS = 50
MAX_HALVINGS = 20
STEP = 1e-11
"""A step of less than this, in bearings [rad], ends the iteration."""
BLUR = 1e-14
"""Rounding of a bearing [rad], generously; costs that differ by less than it makes are alike."""


@dataclass(frozen=True)
class PlanarEstimate:
    """Least-squares states of any number of cases."""

    state: Array
    """(..., 3)"""
    cost: Array
    """(...,) half the sum of squared residuals [rad^2]"""
    iterations: Array
    """(...,) Gauss-Newton steps taken"""
    converged: Array
    """(...,) bool"""


def wrapped(angle: Array) -> Array:
    """Angles [rad] in [-pi, pi]; small ones keep all their digits."""
    return np.asarray(angle - 2.0 * np.pi * np.round(np.asarray(angle) / (2.0 * np.pi)))


def rotation(theta: Array) -> Array:
    """(...,) [rad] -> (..., 2, 2), counter-clockwise."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def directions(state: Array, edges: Array) -> Array:
    """Positions of the edges (n, 2) from the camera [m]; state (..., 3) -> (..., n, 2)."""
    return np.asarray(_turned(state, edges) + state[..., None, :2])


def bearings(state: Array, edges: Array) -> Array:
    """(..., n) [rad] in (-pi, pi]; state (..., 3), edges (n, 2)."""
    s = directions(state, edges)
    return np.arctan2(s[..., 1], s[..., 0])


def folded_bearings(state: Array, edges: Array) -> Array:
    """The slides' ``arccos(s1 / |s|)``, in [0, pi]: an edge below the axis looks as if it were above."""
    s = directions(state, edges)
    return np.asarray(np.arccos(s[..., 0] / np.linalg.norm(s, axis=-1)))


def printed_directions(state: Array, edges: Array) -> Array:
    """``directions`` as the slides print them: the last term of s2 is ``- e2 cos(theta)``."""
    c, s = np.cos(state[..., 2:]), np.sin(state[..., 2:])
    first = state[..., :1] + edges[:, 0] * c - edges[:, 1] * s
    second = state[..., 1:2] + edges[:, 0] * s - edges[:, 1] * c
    return np.stack([first, second], axis=-1)


def jacobian(state: Array, edges: Array) -> Array:
    """H = d bearings / d state: (..., n, 3) in [rad/m, rad/m, rad/rad]; state (..., 3), edges (n, 2).

    d phi = (s1 ds2 - s2 ds1) / |s|^2 and ds / d theta is R e turned by 90 degrees, so a row is
    (-s2, s1, s . R e) / |s|^2.
    """
    turned = _turned(state, edges)
    s = turned + state[..., None, :2]
    rows = np.stack([-s[..., 1], s[..., 0], (s * turned).sum(axis=-1)], axis=-1)
    return np.asarray(rows / (s**2).sum(axis=-1)[..., None])


def metric(state: Array, edges: Array) -> Array:
    """(H^T H)^-1 (..., 3, 3) in [m^2/rad^2], [m/rad], [1]; state (..., 3), edges (n, 2).

    Where a component is unobservable its variance is inf and its covariances are 0; what the bearings do
    determine stays finite.
    """
    scaled, length = _scaled_jacobian(state, edges)
    # rows beyond the number of edges are unobservable directions
    _, some, rows = np.linalg.svd(scaled)
    values = np.zeros(length.shape)
    values[..., : some.shape[-1]] = np.where(some > SINGULAR * some[..., :1], some, 0.0)
    seen = values > 0.0
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=seen)
    half = rows * inverse[..., None] / length[..., None, :]
    cov = np.swapaxes(half, -1, -2) @ half
    lost = (~seen[..., None] & (np.abs(rows) > SHARE)).any(axis=-2)
    cov = np.where(lost[..., None] | lost[..., None, :], 0.0, cov)
    return np.where(lost[..., None] & np.eye(3, dtype=bool), np.inf, cov)


def linear_estimate(prior: Array, edges: Array, measured_rad: Array) -> Array:
    """The slides' one step: x_a + (H^T H)^-1 H^T z with H and z = measured - predicted at the prior x_a.

    prior (..., 3), edges (n, 2), measured_rad (..., n) -> (..., 3). Differences are taken around the circle.
    """
    return prior + _step(prior, edges, wrapped(measured_rad - bearings(prior, edges)))


def gauss_newton(prior: Array, edges: Array, measured_rad: Array) -> PlanarEstimate:
    """Least squares of the bearings themselves: the linear step repeated, halved while it increases the cost.

    prior (..., 3), edges (n, 2), measured_rad (..., n). ``converged`` is false for a case
    that ends elsewhere than at a minimum.
    """
    shape = np.broadcast_shapes(prior.shape[:-1], measured_rad.shape[:-1])
    x = np.broadcast_to(prior, (*shape, 3)).reshape(-1, 3).copy()
    z = np.broadcast_to(measured_rad, (*shape, len(edges))).reshape(-1, len(edges))
    residual = wrapped(z - bearings(x, edges))
    cost = 0.5 * (residual**2).sum(axis=1)
    iterations, done, stuck = np.zeros(len(x), int), np.zeros(len(x), bool), np.zeros(len(x), bool)
    for _ in range(MAX_ITERATIONS):
        running = np.flatnonzero(~done & ~stuck)
        if not len(running):
            break
        step = _step(x[running], edges, residual[running])
        seen = np.abs(np.einsum("cij,cj->ci", jacobian(x[running], edges), step)).max(axis=1)
        scale, waiting = np.ones(len(running)), np.ones(len(running), bool)
        for _ in range(MAX_HALVINGS):
            rows = running[waiting]
            trial = x[rows] + scale[waiting, None] * step[waiting]
            left = wrapped(z[rows] - bearings(trial, edges))
            new = 0.5 * (left**2).sum(axis=1)
            # near the minimum rounding decides which of two costs is less; it must not stop the iteration
            blur = BLUR * np.abs(residual[rows]).sum(axis=1)
            good = (new <= cost[rows] + blur) | (seen[waiting] < STEP)
            x[rows[good]], residual[rows[good]], cost[rows[good]] = trial[good], left[good], new[good]
            waiting[np.flatnonzero(waiting)[good]] = False
            if not waiting.any():
                break
            scale[waiting] *= 0.5
        iterations[running] += 1
        stuck[running] = waiting
        done[running] = ~waiting & (seen < STEP)
    return PlanarEstimate(
        x.reshape(*shape, 3), cost.reshape(shape), iterations.reshape(shape), done.reshape(shape)
    )


def _step(state: Array, edges: Array, residual: Array) -> Array:
    """(..., 3) least-squares solution of H dx = residual (..., n), by H with columns of length 1."""
    scaled, length = _scaled_jacobian(state, edges)
    solution = np.linalg.pinv(scaled, rcond=SINGULAR) @ residual[..., None]
    return np.asarray(solution[..., 0] / length)


def _scaled_jacobian(state: Array, edges: Array) -> tuple[Array, Array]:
    """H (..., n, 3) with columns of length 1, so that metres and radians are alike; their lengths (..., 3).

    A column that is rounding alone, beside what the lever arms could give, becomes 0 and its length 1.
    """
    H = jacobian(state, edges)
    length = np.linalg.norm(H, axis=-2)
    reach = 1.0 / np.linalg.norm(directions(state, edges), axis=-1)
    arms = np.stack([reach, reach, reach * np.linalg.norm(edges, axis=1)], axis=-1)
    real = length > ROUNDING * np.linalg.norm(arms, axis=-2)
    length = np.where(real, length, 1.0)
    return np.where(real[..., None, :], H / length[..., None, :], 0.0), length


def _turned(state: Array, edges: Array) -> Array:
    """R(theta) e: (..., n, 2)."""
    return np.asarray(np.einsum("...ij,nj->...ni", rotation(state[..., 2]), edges))


@dataclass(frozen=True)
class PoseErrors:
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


def monte_carlo(edges: Array, cases: int, seed: Iterable[int], spread: float = 1.0) -> PoseErrors:
    """Cases with their own noise and a priori, the latter ``spread`` times SPREAD from the truth."""
    rng = np.random.default_rng(list(seed))
    prior = TRUTH + spread * SPREAD * rng.normal(size=(cases, 3))
    measured = bearings(TRUTH, edges) + SIGMA_RAD * rng.normal(size=(cases, len(edges)))
    found = gauss_newton(prior, edges, measured)
    one_step = _error(linear_estimate(prior, edges, measured))
    return PoseErrors(one_step, _error(found.state), found.converged)


def _error(state: Array) -> Array:
    error = state - TRUTH
    error[..., 2] = wrapped(error[..., 2])
    return np.asarray(error)


def six_models(cases: int, seed: int) -> tuple[Array, list[PoseErrors]]:
    """Diagonals of the metric at the truth (6, 3), and the errors for each model."""
    models = [model(middle) for middle in middles()]
    diagonal = np.array([np.diag(metric(TRUTH, edges)) for edges in models])
    return diagonal, [monte_carlo(edges, cases, (seed, k)) for k, edges in enumerate(models)]


def mean_errors(errors: Sequence[PoseErrors], one_step: bool = False) -> Array:
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
    head = (
        "model | middle edge [m] | root p1 [m/rad] | root p2 [m/rad] | root theta [rad/rad] | p1 [mm] "
        "| p2 [mm] | theta [deg] | RMSE over sigma root: p1 | p2 | theta"
    )
    ratio = np.array([_rms(each.converged) for each in errors]) / (SIGMA_RAD * np.sqrt(diagonal))
    means = mean_errors(errors) * UNITS
    rows = [
        [
            k + 1,
            f"{middle:.4f}",
            *numbers((*np.sqrt(diagonal[k]), *means[k]), ".2f"),
            *numbers(ratio[k], ".3f"),
        ]
        for k, middle in enumerate(middles())
    ]
    print_table(head, rows)
    range_m = np.linspace(-0.9, 0.9, 1801) * HALF_HEIGHT_M
    best = range_m[np.argmin([np.diag(metric(TRUTH, model(middle))) for middle in range_m], axis=0)]
    positions = ", ".join(f"{height:+.3f} m ({name})" for name, height in zip(NAMES, best, strict=True))
    print(f"\nAnywhere between the outer ones the middle edge is best at {positions}")
    print(f"All {MODELS * CASES} cases converged: {all(each.ended.all() for each in errors)}\n")


def print_trends(seed: int) -> None:
    """Straight lines through the six models, against the root of the metric and against the metric itself."""
    print("Trend of the mean absolute error over the six models: error = slope * metric + intercept, in SI.")
    print(f"Theory, for the root: slope {SIGMA_RAD * MEAN_OVER_RMS:.4e} rad, intercept 0, exponent 0.5\n")
    head = (
        "component | estimate | cases | against | correlation | slope | intercept (its sigma) "
        "| unit of the intercept | exponent of the diagonal"
    )
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
    print_table(head, rows)
    correlations, exponents = repeated(seed)
    low, middle, high = np.quantile(exponents, [0.025, 0.5, 0.975], axis=0)
    print(f"\nOver {REPEATS} repetitions of {CASES} cases a model, against the root:")
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
            rows.append([k, cm_deg, *numbers(both, ".2f"), f"{errors.ended.mean():.2%}"])
    head = ["model", "a priori off by (sigma)", *(f"one step: {name}" for name in NAMES)]
    print_table([*head, *(f"converged: {name}" for name in NAMES), "share converged"], rows)


def print_folds(seed: int) -> None:
    """What arccos does to an edge near the axis."""
    print(f"\narccos against atan2: model 6, theta 10 deg, one step, {MANY} cases; RMSE\n")
    rows = []
    for offset in OFFSETS_M:
        crossed, signed, folded = folded_errors(offset, MANY, seed)
        both = np.column_stack([signed * UNITS, folded * UNITS]).ravel()
        rows.append([f"{100 * offset:g}", f"{100 * crossed:.1f} %", *numbers(both, ".2f")])
    head = ["p2 [cm]", "cases with a folded edge"]
    units = ("mm", "mm", "deg")
    for name, unit in zip(NAMES, units, strict=True):
        head += [f"{name} atan2 [{unit}]", f"{name} arccos [{unit}]"]
    print_table(head, rows)
    upside_down = np.array([TRUTH[0], -TRUTH[1], np.pi - TRUTH[2]])
    same = np.abs(folded_bearings(TRUTH, model(0.1)) - folded_bearings(upside_down, model(0.1))).max()
    print("\narccos of a flat model at (p1, p2, theta) and at (p1, -p2, pi - theta):", end=" ")
    print(f"differ by {same:.0e} rad\n")


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
        rows.append([f"{degrees:g}", *numbers((length, np.linalg.norm(edge), determinant), ".4f")])
    print_table("theta [deg] | printed [m] | rotated [m] | determinant of the printed matrix", rows)
    print("\nCorrelation of the mean absolute error with the diagonals, over six models\n")
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
            rows.append([label, what, *numbers(r, "+.3f"), *numbers(change, ".3g")])
    head = ["models", "diagonal of", *NAMES, *(f"{name}: last over first model" for name in NAMES)]
    print_table(head, rows)


TITLES = ("range $p_1$", "offset $p_2$", r"attitude $\theta$")
ERRORS = ("mean error of $p_1$ [mm]", "mean error of $p_2$ [mm]", r"mean error of $\theta$ [deg]")
ROOT_UNITS, SQUARE_UNITS = ("m/rad", "m/rad", "rad/rad"), ("m²/rad²", "m²/rad²", "1")
THEORY, POINTS, FIT = "#33556e", "#b3261e", "#d58f00"


def draw(path: Path, seed: int) -> None:
    """The figure of 100 cases per model, with the prediction of theory."""
    diagonal, errors = six_models(CASES, seed)
    means = mean_errors(errors) * UNITS
    figure, panels = subplots(3, 3, (12.0, 10.2), layout="constrained")
    for i in range(3):
        _proof(panels[0, i], i, means[:, i])
        _trend(panels[1, i], i, diagonal[:, i], means[:, i], root=True)
        _trend(panels[2, i], i, diagonal[:, i], means[:, i], root=False)
    for axes in panels.flat:
        axes.grid(color="#e8ecf0")
        axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path, 110)


def _proof(axes: Axes, i: int, means: Array) -> None:
    """Errors of the six models, over all positions of the middle edge."""
    range_m = HALF_HEIGHT_M * np.linspace(-0.9, 0.9, 181)
    root = np.array([np.sqrt(metric(TRUTH, model(middle))[i, i]) for middle in range_m])
    axes.plot(
        range_m, MEAN_OVER_RMS * SIGMA_RAD * root * UNITS[i], color=THEORY, label="from the geometry alone"
    )
    axes.plot(middles(), means, "o", color=POINTS, label=f"mean of {CASES} cases")
    for k, (middle, mean) in enumerate(zip(middles(), means, strict=True)):
        axes.annotate(f"{k + 1}", (middle, mean), xytext=(0, 7), textcoords="offset points", ha="center")
    axes.set_xlim(HALF_HEIGHT_M, -HALF_HEIGHT_M)
    axes.set_ylim(0.0, 1.35 * means.max())
    axes.set(title=TITLES[i], ylabel=ERRORS[i], xlabel="position of the middle edge [m]")


def _trend(axes: Axes, i: int, diagonal: Array, means: Array, root: bool) -> None:
    """Errors against the root of the metric, or against the metric, with straight line and theory."""
    x = np.sqrt(diagonal) if root else diagonal
    along = np.linspace(0.0, 1.05 * x.max(), 200)
    line = linregress(x, means)
    predicted = MEAN_OVER_RMS * SIGMA_RAD * UNITS[i] * (along if root else np.sqrt(along))
    axes.plot(along, predicted, color=THEORY, label=r"$\sigma\,\sqrt{2/\pi}\,\sqrt{(H^TH)^{-1}_{ii}}$")
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
