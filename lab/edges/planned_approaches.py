"""What a planned approach gives over the straight one, by Monte Carlo on images.

    python -m lab.edges.planned_approaches [BODY ...] [--seeds 10] [--short] [--stored]

Each seed draws the attitude and the rate of a tumbling body, and the Sun. A camera starts at rest 4 m away
and has 60 s: along the straight path to where the body just fills the image, or along the path from which
its pose is best observable by the metric (``observable_paths.py``). Along both, images with noise are
made at even times, and the tracker of edges looks at each on its own, from a guess that is off by 2
degrees and 2 cm about each axis.

An error is the root of the squares of the translation in radii and of the rotation in radians, in
thousandths. No image is left out; median and mean are over the images of an approach, the latter of errors
up to CAPPED. Ratios are of the planned approach to the straight one, their means over the seeds geometric,
with the band of 95 % of a bootstrap over the seeds. "Promised" is the same ratio of what is expected of the
tracker at these views before there is an image (``polhode/planning/edges/expected_tracking.py``). Where no
path keeps the limits, the straight one is flown, and the ratio is 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import trimesh
from scipy import stats
from tyro.conf import Positional, arg

from lab.command import Record, Short, Workers, command
from lab.edges.observable_paths import (
    CameraPathTask,
    EvaluatedPath,
    best_path,
    evaluated,
    straight_path,
)
from lab.edges.views import (
    EdgeBody,
    EdgeViews,
    ViewOptions,
    edge_body,
    edge_rig,
    perturbed,
    random_rotation,
    random_suns,
)
from lab.presentation import print_table
from lab.record import Case, complete, measured
from polhode.geometry.lie import Array
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.expected_tracking import expected_tracking, lit_from
from polhode.planning.edges.observability_metric import motion_scale, pose_error
from polhode.planning.edges.tracking import track_edges
from polhode.planning.keep_out.volumes import InstantKeepOut, KeepOutOptions, keep_out
from polhode.planning.prediction import FinalEstimate, FinalState
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError
from polhode.studies.page.dependence import bootstrap_band

START_N = np.array([0.0, 0.0, -4.0])
RECORD = Path("runs/records/planned_approaches")
BODIES = ("house", "steps", "ell", "satellite", "bus", "cubesat", "truss", "dish")
SEEDS, IMAGES = 10, 8
SHORT_BODIES = ("house",)
RATE_DEG_S = (1.5, 5.0)
"""Uniform"""
CAPPED = 0.1
"""An error beyond it is as useless as this one"""


def main(
    bodies: Positional[tuple[str, ...]] = BODIES,
    seeds: Annotated[int, arg(help="Tumbles, each with its Sun.")] = SEEDS,
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
) -> None:
    """Measure what the record lacks; print the tables."""
    wanted: list[Case] = [
        {"body": body, "seed": seed, "images": IMAGES}
        for seed in range(1 if short else seeds)
        for body in (SHORT_BODIES if short else bodies)
    ]
    lines = measured(record, wanted) if stored else complete(record, wanted, measure, workers)
    flights = [Flight.of(line) for line in lines]
    if not flights:
        print("nothing was measured yet")
        return
    print_table(
        "body | seeds | no path | straight: median | mean | planned: median | mean | ratio of medians"
        " | of means | promised | better | dv [m/s]",
        table_of(flights),
        right_from=1,
    )
    promised, found = (
        np.log([getattr(each, name) for each in flights]) for name in ("promised", "ratio_of_medians")
    )
    if len(flights) > 2:
        ranks = stats.spearmanr(promised, found)
        print(f"\nranks of promised and measured ratios correlate by {ranks.statistic:.2f}")


def measure(case: Case) -> dict[str, Any]:
    """Both approaches to one body."""
    target, rig = edge_body(case["body"]), edge_rig()
    rng = np.random.default_rng([28, case["seed"]])
    R_NG, axis = random_rotation(rng), rng.standard_normal(3)
    rate_G = np.deg2rad(rng.uniform(*RATE_DEG_S)) * axis / np.linalg.norm(axis)
    estimate = tumbling(target.mesh, rate_G, R_NG)
    sun_N = random_suns(1, 1000 + case["seed"])[0]
    volume = volume_of(target.mesh, estimate)
    task = CameraPathTask(edge_model(target.mesh), rig, estimate, volume, sun_N, START_N)
    straight = approach(target, task, evaluated(task, straight_path(task)), case)
    try:
        return {"straight": straight, "planned": approach(target, task, best_path(task), case)}
    except InputError as reason:
        return {"straight": straight, "planned": None, "reason": str(reason)}


def tumbling(mesh: trimesh.Trimesh, rate_G: Array, R_NG: Array) -> FinalEstimate:
    """The motion of a body about its centre with small covariances; rate (3,) and attitude at the start."""
    basis = np.zeros((5, 3, 3))
    for n, (i, j) in enumerate([(0, 0), (1, 1), (0, 1), (0, 2), (1, 2)]):
        basis[n, i, j] = basis[n, j, i] = 1.0
    sigma = np.concatenate([np.repeat([1e-3, 1e-4, 5e-3, 2e-4], 3), np.full(5, 1e-3), np.full(3, 5e-4)])
    last = FinalState(
        np.zeros(3), np.zeros(3), R_NG, rate_G, np.diag([1.3, 1.0, 0.8]), np.eye(3), basis, np.diag(sigma**2)
    )
    return FinalEstimate(last, np.mean(mesh.bounds, axis=0), 0.0, 0.0)


def volume_of(mesh: trimesh.Trimesh, estimate: FinalEstimate) -> InstantKeepOut:
    """The keep-out volume of a tumbling body at each instant of the approach."""
    fine = mesh.subdivide_to_size(0.05)
    count = len(fine.vertices)
    surface = SurfaceModel(fine, np.full(count, 1e-3), np.full(count, 5, dtype=np.int64))
    return keep_out(surface, estimate, KeepOutOptions(60.0, 0.97, members=120, cells=32)).instant


def approach(target: EdgeBody, task: CameraPathTask, flown: EvaluatedPath, case: Case) -> dict[str, Any]:
    """Errors of the poses from images along a path, and what was expected of them."""
    rows = np.linspace(0, len(flown.X_RG) - 1, case["images"]).round().astype(int)
    X_RG, sun_R, model = flown.X_RG[rows], flown.sun_R[rows], task.model
    images = EdgeViews(target, task.rig, 3 + case["seed"], ViewOptions(earth=0.0)).images(X_RG, sun_R)
    starts = perturbed(X_RG, model.centre_G, 4 + case["seed"])
    scale = motion_scale(model.radius_m)
    error, expected = [], []
    for image, true, start, sun in zip(images, X_RG, starts, sun_R, strict=True):
        found = track_edges(model, task.rig, image, start)
        error.append(float(np.linalg.norm(pose_error(found.X_RG, true, model.centre_G) / scale)))
        promise = expected_tracking(model, task.rig, true, lit_from(sun, earth=0.0))
        expected.append(_size(promise.covariance / np.outer(scale, scale)))
    return {"error": error, "expected": expected, "delta_v_m_s": flown.path.delta_v_m_s}


def _size(covariance: Array) -> float:
    """Root of the trace, at most CAPPED, which is also that of a pose that is not determined."""
    trace = float(np.trace(covariance))
    return min(CAPPED, float(np.sqrt(trace))) if np.isfinite(trace) else CAPPED


@dataclass(frozen=True)
class Flight:
    """Both approaches of one seed, in numbers."""

    body: str
    found: bool
    """A path was found that keeps the limits"""
    straight: tuple[float, float]
    """Median and mean of the errors"""
    planned: tuple[float, float]
    ratio_of_medians: float
    ratio_of_means: float
    promised: float
    delta_v_m_s: tuple[float, float]

    @classmethod
    def of(cls, line: Case) -> "Flight":
        """From a line of the record."""
        straight, planned = line["straight"], line["planned"] or line["straight"]
        a, b = _errors(straight), _errors(planned)
        promised = float(np.median(planned["expected"]) / np.median(straight["expected"]))
        dv = (straight["delta_v_m_s"], planned["delta_v_m_s"])
        found = line["planned"] is not None
        return cls(line["case"]["body"], found, a, b, b[0] / a[0], b[1] / a[1], promised, dv)


def _errors(approach: Case) -> tuple[float, float]:
    error = np.array(approach["error"])
    return float(np.median(error)), float(np.mean(np.minimum(error, CAPPED)))


def table_of(flights: Sequence[Flight]) -> list[list[str]]:
    """A row for each body, and one for all."""
    bodies = dict.fromkeys(each.body for each in flights)
    rows = [_row(body, [each for each in flights if each.body == body]) for body in bodies]
    return [*rows, _row("all", flights)]


def _row(name: str, flights: Sequence[Flight]) -> list[str]:
    straight, planned = (
        np.exp(np.mean(np.log([getattr(each, way) for each in flights]), axis=0))
        for way in ("straight", "planned")
    )
    dv = np.mean([each.delta_v_m_s for each in flights], axis=0)
    return [
        name,
        str(len(flights)),
        str(sum(not each.found for each in flights)),
        *(f"{1e3 * value:.2f}" for value in (*straight, *planned)),
        *_ratios(flights),
        f"{_mean(np.array([each.promised for each in flights])):.2f}",
        _better(flights),
        f"{dv[0]:.2f}, {dv[1]:.2f}",
    ]


def _mean(ratios: Array) -> float:
    return float(np.exp(np.mean(np.log(ratios))))


def _ratios(flights: Sequence[Flight]) -> list[str]:
    """Geometric means of both ratios, with their bands."""
    return [
        _with_band(np.array([getattr(each, name) for each in flights]))
        for name in ("ratio_of_medians", "ratio_of_means")
    ]


def _with_band(ratios: Array) -> str:
    low, high = np.exp(bootstrap_band(np.log(ratios), np.mean))
    return f"{_mean(ratios):.2f}" + (f" ({low:.2f} to {high:.2f})" if np.isfinite(low) else "")


def _better(flights: Sequence[Flight]) -> str:
    return f"{sum(each.ratio_of_medians < 1.0 for each in flights)} of {len(flights)}"


if __name__ == "__main__":
    command(main)
