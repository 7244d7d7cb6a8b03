"""Edges of runs' meshes, before and after they were moved to where the images have them, and the true ones.

    python -m lab.navigation.refined_edges [--inspections DIR] [--numbers 3]

The inspections are those of ``inspect_and_approach``; those that the folder lacks are made. Distances are
from points on the edges of the model, a hundredth of the body's radius apart, to the nearest true edge. Edges
of paint are none of those: a model that has some is farther from the true edges than from what images show.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree
from tyro.conf import arg

from lab.command import command
from lab.navigation.inspect_and_approach import RECORD, inspections_beside
from lab.navigation.inspections import (
    FAMILIES,
    Inspection,
    inspection,
    true_frame,
)
from lab.presentation import print_table
from polhode.config.loader import load_config
from polhode.geometry.lie import Array, transform_points
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.measured_edges import measured_edge_model
from polhode.planning.observability.assess import refined_edges_of_run
from polhode.planning.plan import surface_of
from polhode.simulation.bodies import build_body

INSPECTIONS = inspections_beside(RECORD)
SPACING = 0.01
"""Of the points on edges, over the body's radius"""
NEAR_M = 3e-3
"""As near as a pixel of the inspection at most"""


def main(
    inspections: Annotated[Path, arg(help="Folder that keeps the inspections.")] = INSPECTIONS,
    numbers: Annotated[int, arg(help="Inspections of each body.")] = 3,
) -> None:
    """Refine the edges of every inspection; print a row for each body."""
    columns = [
        "body",
        "segments",
        "kept",
        "from a true edge, mesh: median [mm]",
        "within 3 mm",
        "refined: median [mm]",
        "within 3 mm",
        "sigma, median [mm]",
        "s",
    ]
    print_table(" | ".join(columns), _rows(inspections, numbers), right_from=1)


def _rows(folder: Path, numbers: int) -> Iterator[list[str]]:
    for family in FAMILIES:
        every = [inspection(folder, family, number) for number in range(1, numbers + 1)]
        compared = [_compared(each) for each in every if not each.error]
        before, after, sigma = (np.concatenate([each[k] for each in compared]) for k in range(3))
        segments, kept, seconds = (np.array([each[k] for each in compared]) for k in range(3, 6))
        yield [
            family,
            ", ".join(str(each) for each in segments),
            f"{kept.sum() / segments.sum():.0%}",
            *(
                text
                for distance in (before, after)
                for text in (f"{1e3 * np.median(distance):.1f}", f"{np.mean(distance < NEAR_M):.0%}")
            ),
            f"{1e3 * np.median(sigma):.1f}",
            f"{np.median(seconds):.1f}",
        ]


def _compared(inspected: Inspection) -> tuple[Array, Array, Array, int, int, float]:
    """Distances before and after [m], sigmas [m], numbers of segments before and after, and seconds."""
    surface = surface_of(inspected.run)
    model = measured_edge_model(surface.mesh, surface.sigma_m)
    begin = time.perf_counter()
    edges = refined_edges_of_run(inspected.run, inspected.sequence)
    seconds = time.perf_counter() - begin
    config = load_config(inspected.sequence / "scene.yaml")
    assert config.scene is not None
    true = edge_model(build_body(config.scene.body, config.seed).mesh)
    tree = cKDTree(points_on(true.ends_G, 0.1 * NEAR_M))
    X_BG = true_frame(inspected, model.centre_G)
    step_m = SPACING * model.radius_m
    before, after = (
        np.asarray(tree.query(transform_points(X_BG, points_on(ends, step_m)))[0])
        for ends in (model.ends_G, edges.model.ends_G)
    )
    return before, after, edges.sigma_m, len(model.ends_G), len(edges.model.ends_G), seconds


def points_on(ends_G: Array, step_m: float) -> Array:
    """Points (m, 3) on segments (n, 2, 3), evenly, at most so far apart."""
    length = np.linalg.norm(ends_G[:, 1] - ends_G[:, 0], axis=1)
    count = np.maximum(np.ceil(length / step_m).astype(np.int64), 1)
    which = np.repeat(np.arange(len(ends_G)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[which]
    return np.asarray(ends_G[which, 0] + share[:, None] * (ends_G[which, 1] - ends_G[which, 0]))


if __name__ == "__main__":
    command(main)
