"""Sets of edges along a few views: how good greedy is, and how few edges do.

    python -m benchmarks.edges.selection [BODY ...] [--views 8] [--budget 8]

First table: ``budget`` edges chosen from the views by log det and by the trace: greedy, after exchanges, the
best choice where branch and bound ends, and the upper bound. For the trace its difference from 6 is shown, in
millionths: the mean of the summed variances, translations in radii, for one pixel. Second table:
the fewest edges for which each sigma stays within 10 %, the lower bound, and the exact number where all sets
can be tried. Third, for bodies of few edges: the smooth table of `view_table.py` against the metric at views
between its own. Edges count where they stand clear of others (`visible_edges.clear_points`).
"""

from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.edges.trajectory_optimization import min_range
from benchmarks.edges.view_table import camera_attitude, view_table
from benchmarks.edges.views import edge_body, edge_rig, random_poses
from benchmarks.presentation import print_table
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.information import FeatureInformation, feature_information
from polhode.planning.edges.selection import (
    best_selection,
    greedy,
    improved_by_exchange,
    upper_bound,
)
from polhode.planning.edges.smallest_set import SigmaLimits, exact_smallest_set, smallest_set

BODIES = ("block", "house", "drum", "satellite", "bus", "cubesat")
EXACT_UP_TO = 25
TABLES_UP_TO = 200
BETWEEN = 100
SUN_G = np.array([[0.3, 0.8, 0.5]])


def main(
    bodies: Positional[tuple[str, ...]] = BODIES,
    views: Annotated[int, arg(help="Views that the edges serve.")] = 8,
    budget: Annotated[int, arg(help="Edges to choose.")] = 8,
) -> None:
    """Print the tables."""
    rig = edge_rig()
    models = {name: edge_model(edge_body(name).mesh) for name in bodies}
    information = {
        name: feature_information(model, rig, random_poses(model.surface, rig, views, seed=1), clear=True)
        for name, model in models.items()
    }
    print_table(
        "body | edges seen | value | greedy | exchanged | best | bound | computed",
        ([name, *row] for name, each in information.items() for row in choices(each, budget)),
    )
    print()
    print_table(
        "body | edges seen | within 10 % | at least | exact | largest sigma",
        ([name, *fewest(each)] for name, each in information.items()),
    )
    print()
    print_table(
        "body | spread | even light: median error | correlation | sunlight: error | correlation",
        ([name, *between(model, rig)] for name, model in models.items() if model.size <= TABLES_UP_TO),
    )


def choices(information: FeatureInformation, budget: int) -> list[list[object]]:
    """Two rows: by log det, by the trace."""
    A = information.scaled
    seen = len(SigmaLimits(information).candidates)
    rows: list[list[object]] = []
    for value in ("log_det", "trace"):
        first = greedy(A, budget, value)
        second = improved_by_exchange(A, first, budget, value)
        best = "-"
        if seen <= EXACT_UP_TO:
            try:
                best = shown(best_selection(A, budget, value).value, value)
            except InputError:
                best = "too long"
        bound = shown(upper_bound(A, budget, value), value)
        of_greedy, of_second = shown(first.value, value), shown(second.value, value)
        rows.append([seen, value, of_greedy, of_second, best, bound, first.evaluations])
    return rows


def shown(value: float, kind: str) -> str:
    """log det itself; for the trace its difference from 6."""
    return f"{value:.2f}" if kind == "log_det" else f"{1e6 * (6.0 - value):.1f}"


def fewest(information: FeatureInformation) -> list[object]:
    """One row."""
    found = smallest_set(information)
    seen = len(SigmaLimits(information).candidates)
    try:
        exact = str(len(exact_smallest_set(information).features)) if seen <= EXACT_UP_TO else "-"
    except InputError:
        exact = "-"
    return [seen, len(found.features), found.at_least, exact, f"{np.nanmax(found.ratio):.3f}"]


def between(model: EdgeModel, rig: RectifiedRig) -> list[str]:
    """One row: spread of the natural logarithm, median difference, correlation; even light, then sunlight."""
    near = min_range(model, rig) + 0.02
    rng = np.random.default_rng(0)
    towards = rng.normal(size=(BETWEEN, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    far = rng.uniform(near, 2.0 * near, BETWEEN)
    cells = []
    for sun in None, SUN_G:
        table = view_table(model, rig, (near, 2.0 * near), sun)
        value = table.log_trace_of()
        found, true = np.empty(BETWEEN), np.empty(BETWEEN)
        for k, p_G in enumerate(far[:, None] * towards):
            R_RG = camera_attitude(-p_G, np.array([0.0, 0.0, 1.0]))
            X_RG = make_pose(R_RG, -R_RG @ (p_G + model.centre_G))
            C = feature_information(model, rig, X_RG[None], sun, clear=True).scaled.sum(axis=1)[0]
            true[k] = np.log(np.trace(np.linalg.inv(C + np.eye(6))))
            found[k] = float(value(p_G, table.log_trace[0]))
        if sun is None:
            cells.append(f"{true.std():.2f}")
        cells.append(f"{np.median(np.abs(found - true)):.2f}")
        cells.append(f"{np.corrcoef(found, true)[0, 1]:.2f}")
    return cells


if __name__ == "__main__":
    command(main)
