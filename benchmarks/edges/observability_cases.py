"""Trials of the edge tracker whose truth is known: what one body gives, from images of many poses."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.edges.edge_bodies import edge_body
from benchmarks.edges.edge_views import (
    EdgeViews,
    ViewOptions,
    edge_rig,
    perturbed,
    random_poses,
    random_rotation,
    random_suns,
)
from benchmarks.edges.tracking.against_sky import body_beside, polarity
from benchmarks.edges.tracking.calibrated_covariance import noise_parts, parts_of
from benchmarks.edges.tracking.residual import support
from benchmarks.edges.tracking.tracker import TrackingResult, track
from benchmarks.record import Case
from polhode.camera import RectifiedRig
from polhode.config.scene import Sensor
from polhode.lie import Array, make_pose, transform_points
from polhode.planning.edges.metric.edge_motion import edge_motion, moved, pose_error
from polhode.planning.edges.metric.metric import EdgeObservability, observability
from polhode.planning.edges.model.edge_model import EdgeModel, edge_model
from polhode.planning.edges.model.visible_edges import SPACING_PX, clear_points

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
    views, model = _views(case["body"], case["rich"])
    rows = list(wrong_starts(case, views, model) if case["part"] == "wrong" else trend(case, views, model))
    return {"radius_m": model.radius_m, "edges": [m.size for m in levels(model)], "rows": rows}


@lru_cache(maxsize=1)
def _views(body: str, rich: bool) -> tuple[EdgeViews, EdgeModel]:
    target = edge_body(body, plain=not rich)
    return EdgeViews(target, RIG, 3, ViewOptions(sensor=LENS, scattered=True)), edge_model(target.mesh)


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
    return np.array([make_pose(R, np.array([0.0, 0.0, z]) - R @ model.middle_G) for z in ranges_m])


def trend(case: Case, views: EdgeViews, model: EdgeModel) -> Iterator[dict[str, Any]]:
    """For each pose and level: the metric, and errors on images of that pose, a little moved."""
    o_G = model.middle_G
    models = levels(model)
    for number, X_RG in enumerate(poses_of(case, model)):
        rng = np.random.default_rng([case["seed"], 7, number])
        suns = random_suns(case["each"], case["seed"] + 1000 * number)
        truths = [_jittered(X_RG, o_G, rng) for _ in suns]
        starts = perturbed(np.array(truths), o_G, case["seed"] + 1000 * number, START_DEG, START_M)
        images = [
            views.image(X, sun, 1000 * number + k)
            for k, (X, sun) in enumerate(zip(truths, suns, strict=True))
        ]
        for level, each in enumerate(models):
            known, parts = foreseen(each, RIG, X_RG)
            yield {
                "pose": number, "level": level, "points": known.points, "C": _told(known.C[TRIANGLE]),
                "seen": len(known.unseen) == 0, "parts": _told(parts[:, *TRIANGLE]),
                "trials": [
                    _trial(track(each, RIG, image, start), true, o_G, image)
                    for image, start, true in zip(images, starts, truths, strict=True)
                ],
            }  # fmt: skip


def foreseen(model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> tuple[EdgeObservability, Array]:
    """The metric of a pose before there is an image, and its noise parts (3, 6, 6)."""
    points = clear_points(model, rig, X_RG, SPACING_PX)
    f = edge_motion(points, rig, X_RG, model.middle_G)
    known = observability(f, points.weight, model.radius_m)
    if len(points) == 0 or len(known.unseen):
        return known, np.full((3, 6, 6), np.nan)
    sign = polarity(body_beside(points, model, rig, X_RG))
    return known, noise_parts(f, points.weight, points.feature, sign)


def _jittered(X_RG: Array, o_G: Array, rng: np.random.Generator) -> Array:
    """Another place of the edges between the pixels."""
    step = np.zeros(6)
    step[:2] = rng.uniform(-1, 1, 2) * JITTER_PX * X_RG[2, 3] / RIG.focal_px
    step[3:] = np.deg2rad(JITTER_DEG) * rng.standard_normal(3)
    return moved(X_RG, step, o_G)


def _trial(tracked: TrackingResult, true: Array, o_G: Array, image: Array) -> dict[str, Any]:
    """One fit: its error, what it tells of itself, and what moved it off."""
    complete = tracked.converged and len(tracked.information.unseen) == 0
    shown = support(tracked, image)
    return {
        "ok": bool(complete), "error": _told(pose_error(tracked.X_RG, true, o_G)),
        "off_px": _told(off_px(tracked, true)), "support": _told(shown.as_features),
        "sigma_px": _told(shown.sigma_px if np.isfinite(shown.sigma_px) else 99.0),
        "C": _told(tracked.C[TRIANGLE]), "metric": _told(_log_determinant(tracked)),
        "parts": _told(parts_of(tracked).parts[0][:, *TRIANGLE]) if complete else None,
    }  # fmt: skip


def _log_determinant(tracked: TrackingResult) -> float:
    """Of C^-1 as the metric has it: every point counts, found or not."""
    if len(tracked.points) == 0:
        return 99.0
    known = observability(tracked.f, tracked.points.weight, tracked.information.radius_m)
    return float(-np.log(np.maximum(np.linalg.eigvalsh(known.C), 1e-9)).sum())


def off_px(tracked: TrackingResult, true: Array) -> float:
    """How far the model's points are from their true places in the image, root mean square; 999 at most."""
    p_G = tracked.points.p_G
    if len(p_G) == 0:
        return 999.0
    there = RIG.project(transform_points(true, p_G))[:, :2]
    return float(min(np.sqrt(np.mean(np.sum((tracked.points.uv_px - there) ** 2, axis=1))), 999.0))


def wrong_starts(case: Case, views: EdgeViews, model: EdgeModel) -> Iterator[dict[str, Any]]:
    """Tracks from near the truth, and from poses that look alike: turned by quarters, moved aside."""
    o_G = model.middle_G
    suns = random_suns(case["poses"], case["seed"])
    for number, X_RG in enumerate(poses_of(case, model)):
        image = views.image(X_RG, suns[number], number)
        rng = np.random.default_rng([case["seed"], 11, number])
        for kind, start in _starts(X_RG, model, rng):
            tracked = track(model, RIG, image, start)
            yield {"pose": number, "kind": kind, "trial": _trial(tracked, X_RG, o_G, image)}


def _starts(X_RG: Array, model: EdgeModel, rng: np.random.Generator) -> Iterator[tuple[str, Array]]:
    """Named starts; all but the first kind are meant to be wrong."""
    o_G, R, radius_m = model.middle_G, X_RG[:3, :3], model.radius_m

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


def _told(values: Any) -> Any:
    """Numbers of seven digits for JSON; NaN and inf as null."""
    flat = np.asarray(values, dtype=np.float64)
    short = [float(f"{v:.6e}") if np.isfinite(v) else None for v in flat.reshape(-1)]
    return short[0] if flat.ndim == 0 else short
