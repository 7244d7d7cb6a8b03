"""The observability metric against the errors of an edge tracker: Monte Carlo on rendered images.

python -m benchmarks.edges.observability [--short] [--workers 1] [--record FILE] [--stored]
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import Png, Record, Short, Workers, command
from benchmarks.edges.observability_tables import (
    Spot,
    good_and_bad_table,
    nees_table,
    plot,
    spots_of,
    trend_table,
    wrong_table,
)
from benchmarks.edges.tracking.calibrated_covariance import noise_parts, parts_of
from benchmarks.edges.tracking.residual import support
from benchmarks.edges.tracking.tracker import TrackingResult, body_beside, polarity, track
from benchmarks.edges.views import (
    NAMES,
    SOLIDS,
    EdgeViews,
    ViewOptions,
    edge_body,
    edge_rig,
    perturbed,
    random_poses,
    random_rotation,
    random_suns,
)
from benchmarks.record import Case, complete, measured
from polhode.camera import RectifiedRig
from polhode.config.scene_settings import Sensor
from polhode.images import Grey
from polhode.lie import Array, make_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    moved,
    observability,
    pose_error,
)
from polhode.planning.edges.visible_edges import SPACING_PX, clear_points

RECORD = Path("runs/records/observability")


PLAIN = (*(name for name in SOLIDS if name != "satellite"), "free_flyer")
"""Bodies whose edges stand clear of each other"""
CLUTTERED = tuple(name for name in NAMES if name not in PLAIN)
"""Bodies with thin panels, bars, bevels and many small parts"""
FIXED_M = 3.0


def cases(short: bool) -> list[Case]:
    """Every measurement, the most important first."""
    count = {"poses": 4, "each": 3} if short else {"poses": 20, "each": 10}
    fixed = {"poses": 3, "each": 3} if short else {"poses": 10, "each": 10}
    plain = PLAIN[:2] if short else PLAIN
    cluttered = () if short else CLUTTERED
    near = {"near_m": 2.0, "far_m": 4.0, "rich": False}
    at = {"near_m": FIXED_M, "far_m": FIXED_M, "rich": False}
    wrong = {"poses": 2 if short else 5, "each": 1, **near, "seed": 5}
    out: list[Case] = [
        {"part": "approach", "body": body, "poses": 9, **near, "each": fixed["each"], "seed": 9}
        for body in ("satellite", "steps")
    ]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in plain]
    out += [{"part": "fixed", "body": body, **at, **fixed, "seed": 2} for body in plain]
    out += [{"part": "wrong", "body": body, **wrong} for body in (*plain, *cluttered)]
    out += [{"part": "trend", "body": body, **near, **count, "seed": 1} for body in cluttered]
    return out


def main(
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
    output: Png = None,
) -> None:
    """Measure what the record lacks; print the tables; draw the trends."""
    wanted = cases(short)
    lines = measured(record, wanted) if stored else complete(record, wanted, measure, workers)
    groups = {
        "three models of steps, 4 to 2 m": _spots(lines, "approach", ["steps"]),
        "three models of satellite, 4 to 2 m": _spots(lines, "approach", ["satellite"]),
        "plain bodies, 2 to 4 m": _spots(lines, "trend", PLAIN),
        f"plain bodies, {FIXED_M:g} m": _spots(lines, "fixed", PLAIN),
        "cluttered bodies, 2 to 4 m": _spots(lines, "trend", CLUTTERED),
        "all bodies, 2 to 4 m": _spots(lines, "trend", NAMES),
    }
    groups = {name: spots for name, spots in groups.items() if spots}
    print("# Trends\n\n" + trend_table(groups))
    plain = _spots(lines, "trend", PLAIN)
    if len({spot.body for spot in plain}) > 1:
        print("\n# What is good and what is bad\n\n" + good_and_bad_table(plain))
        for first, title in ((True, "one trial of each pose"), (False, "all trials")):
            table, found, before = nees_table(plain, first)
            print(f"\n# Consistency of covariances, {title}\n\n{table}")
        print(f"\nLEVELS = {found}\nWITHOUT_IMAGE = {before}")
    wrong = [line for line in lines if line["case"]["part"] == "wrong"]
    if len(wrong) > 1:
        print("\n# Right and wrong poses\n\n" + wrong_table(wrong))
    if output:
        plot(groups, output)


def _spots(lines: list[Case], part: str, bodies: Sequence[str]) -> list[Spot]:
    return spots_of(
        [line for line in lines if line["case"]["part"] == part and line["case"]["body"] in bodies]
    )


RIG = edge_rig()
LEVELS = (1.0, 0.75, 0.5)
"""Of the total length of edges, the longest first: three models of decreasing detail."""
LENS = Sensor(blur_px=0.8)
"""A sharper lens aliases: its stairs displace edges by more than the noise does"""
START_DEG, START_M = 1.0, 0.01
"""Sigma of the start's error about and along each axis."""
JITTER_PX, JITTER_DEG = 0.5, 0.1
TRIANGLE = np.triu_indices(6)


def measure(case: Case) -> dict[str, Any]:
    """All poses of one body; see `trend` and `wrong_starts`."""
    views, model = views_of(case["body"], case["rich"])
    rows = list(wrong_starts(case, views, model) if case["part"] == "wrong" else trend(case, views, model))
    return {"radius_m": model.radius_m, "edges": [m.size for m in levels(model)], "rows": rows}


@lru_cache(maxsize=len(NAMES))
def views_of(body: str, rich: bool) -> tuple[EdgeViews, EdgeModel]:
    target = edge_body(body, plain=not rich)
    return EdgeViews(target, RIG, 3, ViewOptions(sensor=LENS)), edge_model(target.mesh)


def levels(model: EdgeModel) -> list[EdgeModel]:
    """The model and two with fewer edges."""
    length = np.concatenate([model.lengths_m, _extents(model)])
    length[len(model.ends_G) :][~model.outlined] = 0.0
    order = np.argsort(-length, kind="stable")
    reached = np.cumsum(length[order]) / length.sum()
    return [model.only(order[: int(np.searchsorted(reached, share * (1.0 - 1e-9))) + 1]) for share in LEVELS]


def _extents(model: EdgeModel) -> Array:
    """Diagonals (parts,) of the boxes of smooth parts."""
    corners = np.asarray(model.surface.triangles)
    low = np.full((len(model.outlined), 3), np.inf)
    high = -low
    curved = model.part >= 0
    np.minimum.at(low, model.part[curved], corners[curved].min(axis=1))
    np.maximum.at(high, model.part[curved], corners[curved].max(axis=1))
    return np.asarray(np.linalg.norm(high - low, axis=1))


def poses_of(case: Case, model: EdgeModel) -> Array:
    """(poses, 4, 4) within the case's ranges; along an approach one attitude comes nearer."""
    count, near, far = case["poses"], case["near_m"], case["far_m"]
    if case["part"] != "approach":
        return random_poses(model.surface, RIG, count, case["seed"], (near, far))
    R = random_rotation(np.random.default_rng([case["seed"], 0xA99]))
    ranges_m = np.linspace(far, near, count)
    return np.array([make_pose(R, np.array([0.0, 0.0, z]) - R @ model.centre_G) for z in ranges_m])


def trend(case: Case, views: EdgeViews, model: EdgeModel) -> Iterator[dict[str, Any]]:
    """For each pose and level: the metric, and errors on images of that pose, a little moved."""
    o_G = model.centre_G
    models = levels(model)
    for number, X_RG in enumerate(poses_of(case, model)):
        rng = np.random.default_rng([case["seed"], 7, number])
        suns = random_suns(case["each"], case["seed"] + 1000 * number)
        truths = [jittered(X_RG, o_G, rng) for _ in suns]
        starts = perturbed(np.array(truths), o_G, case["seed"] + 1000 * number, START_DEG, START_M)
        images = [
            views.image(X, sun, 1000 * number + k)
            for k, (X, sun) in enumerate(zip(truths, suns, strict=True))
        ]
        for level, each in enumerate(models):
            known, parts = foreseen(each, RIG, X_RG)
            yield {
                "pose": number, "level": level, "points": known.points, "C": rounded(known.C[TRIANGLE]),
                "seen": len(known.unobservable) == 0, "parts": rounded(parts[:, *TRIANGLE]),
                "trials": [
                    _trial(track(each, RIG, image, start), true, o_G, image)
                    for image, start, true in zip(images, starts, truths, strict=True)
                ],
            }  # fmt: skip


def foreseen(model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> tuple[EdgeObservability, Array]:
    """The metric of a pose before there is an image, and its noise parts (3, 6, 6)."""
    points = clear_points(model, rig, X_RG, SPACING_PX)
    f = edge_motion(points, rig, X_RG, model.centre_G)
    known = observability(f, points.weight, model.radius_m)
    if len(points) == 0 or len(known.unobservable):
        return known, np.full((3, 6, 6), np.nan)
    sign = polarity(body_beside(points, model, rig, X_RG))
    return known, noise_parts(f, points.weight, points.feature, sign)


def jittered(X_RG: Array, o_G: Array, rng: np.random.Generator) -> Array:
    """Another position of the edges between the pixels."""
    step = np.zeros(6)
    step[:2] = rng.uniform(-1, 1, 2) * JITTER_PX * X_RG[2, 3] / RIG.focal_px
    step[3:] = np.deg2rad(JITTER_DEG) * rng.standard_normal(3)
    return moved(X_RG, step, o_G)


def _trial(tracked: TrackingResult, true: Array, o_G: Array, image: Grey) -> dict[str, Any]:
    """One fit: its error, its own statistics, and its noise parts."""
    complete = tracked.converged and len(tracked.information.unobservable) == 0
    shown = support(tracked, image)
    return {
        "ok": bool(complete), "error": rounded(pose_error(tracked.X_RG, true, o_G)),
        "off_px": rounded(off_px(tracked.points.p_G, tracked.X_RG, true)),
        "support": rounded(shown.as_features),
        "sigma_px": rounded(shown.sigma_px if np.isfinite(shown.sigma_px) else 99.0),
        "C": rounded(tracked.C[TRIANGLE]), "metric": rounded(_log_determinant(tracked)),
        "parts": rounded(parts_of(tracked).parts[0][:, *TRIANGLE]) if complete else None,
    }  # fmt: skip


def _log_determinant(tracked: TrackingResult) -> float:
    """Of C^-1 as the metric has it: every point counts, found or not."""
    if len(tracked.points) == 0:
        return 99.0
    known = observability(tracked.f, tracked.points.weight, tracked.information.radius_m)
    return float(-np.log(np.maximum(np.linalg.eigvalsh(known.C), 1e-9)).sum())


def off_px(p_G: Array, X_RG: Array, true: Array) -> float:
    """Displacement in the image of points (m, 3) at an estimated pose, root mean square; 999 px at most."""
    if len(p_G) == 0:
        return 999.0
    here, there = (RIG.project(transform_points(X, p_G))[:, :2] for X in (X_RG, true))
    return float(min(np.sqrt(np.mean(np.sum((here - there) ** 2, axis=1))), 999.0))


def wrong_starts(case: Case, views: EdgeViews, model: EdgeModel) -> Iterator[dict[str, Any]]:
    """Tracks from near the truth, and from poses that look alike: turned by quarters, moved aside."""
    o_G = model.centre_G
    suns = random_suns(case["poses"], case["seed"])
    for number, X_RG in enumerate(poses_of(case, model)):
        image = views.image(X_RG, suns[number], number)
        rng = np.random.default_rng([case["seed"], 11, number])
        for kind, start in _starts(X_RG, model, rng):
            tracked = track(model, RIG, image, start)
            yield {"pose": number, "kind": kind, "trial": _trial(tracked, X_RG, o_G, image)}


def _starts(X_RG: Array, model: EdgeModel, rng: np.random.Generator) -> Iterator[tuple[str, Array]]:
    """Named starts; all but the first kind are meant to be wrong."""
    o_G, R, radius_m = model.centre_G, X_RG[:3, :3], model.radius_m

    def off(shift: Array, turn: Array) -> Array:
        near = np.concatenate(
            [START_M * rng.standard_normal(3), np.deg2rad(START_DEG) * rng.standard_normal(3)]
        )
        return moved(moved(X_RG, np.concatenate([shift, turn]), o_G), near, o_G)

    none = np.zeros(3)
    for _ in range(6):
        yield "near", off(none, none)
    for axis in R.T:
        for angle in 90.0, 180.0, 270.0:
            yield f"turned {min(angle, 360.0 - angle):.0f}", off(none, np.deg2rad(angle) * axis)
    for axis in R.T:
        for share in -0.25, 0.25:
            yield "aside", off(share * radius_m * axis, none)
    for _ in range(3):
        turn = rng.standard_normal(3)
        yield "turned 20", off(none, np.deg2rad(20.0) * turn / np.linalg.norm(turn))


def rounded(values: Any) -> Any:
    """Numbers of seven digits for JSON; NaN and inf as null."""
    flat = np.asarray(values, dtype=np.float64)
    short = [float(f"{v:.6e}") if np.isfinite(v) else None for v in flat.reshape(-1)]
    return short[0] if flat.ndim == 0 else short


if __name__ == "__main__":
    command(main)
