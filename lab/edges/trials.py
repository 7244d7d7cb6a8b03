"""Images of a body near one pose, and starts of the tracker, which the benchmarks of tracking share."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lab.edges.views import (
    NAMES,
    SOLIDS,
    EdgeViews,
    edge_body,
    edge_rig,
    perturbed,
    random_poses,
    random_suns,
)
from polhode.config.scene_settings import Sensor
from polhode.files.images import Grey
from polhode.geometry.lie import Array, transform_points
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.observability_metric import moved

PLAIN = (*(name for name in SOLIDS if name != "satellite"), "free_flyer")
"""Bodies whose edges stand clear of each other"""
CROWDED = tuple(name for name in NAMES if name not in PLAIN)
"""Bodies with thin panels, bars, bevels and many small parts"""
RIG = edge_rig()
SHARES = {"all edges": 1.0, "three quarters": 0.75, "half": 0.5}
"""Of the total length of edges, the longest first: three models of decreasing detail"""
LENS = Sensor(blur_px=0.8)
"""A sharper lens aliases: its stairs displace edges by more than the noise does"""
START_DEG, START_M = 1.0, 0.01
"""Sigma of the start's error about and along each axis"""
JITTER_PX, JITTER_DEG = 0.5, 0.1
"""Of the pose from image to image"""


@dataclass(frozen=True)
class Trials:
    """Of one pose of one body."""

    views: EdgeViews
    whole: EdgeModel
    X_RG: Array
    """(4, 4) that something is expected of"""
    true_X_RG: Array
    """(n, 4, 4) of the images"""
    sun_R: Array
    """(n, 3) unit, towards the Sun"""
    start_X_RG: Array
    """(n, 4, 4)"""
    first: int
    """Number of the first image"""

    def __iter__(self) -> Iterator[tuple[Grey, Array, Array]]:
        """Image, true pose and start of each trial."""
        for k, (true, sun, start) in enumerate(zip(self.true_X_RG, self.sun_R, self.start_X_RG, strict=True)):
            yield self.views.image(true, sun, self.first + k), true, start


def trials_of(case: dict[str, Any]) -> Trials:
    """A case has body, pose (its number), poses, near_m, far_m, seed, images, and rich (its own surface)."""
    views, whole = views_of(case["body"], case["rich"])
    number, o_G = case["pose"], whole.centre_G
    ranges_m = (case["near_m"], case["far_m"])
    X_RG = random_poses(whole.surface, RIG, case["poses"], case["seed"], ranges_m)[number]
    rng = np.random.default_rng([case["seed"], 7, number])
    seed = case["seed"] + 1000 * number
    sun_R = random_suns(case["images"], seed)
    true_X_RG = np.array([_jittered(X_RG, o_G, rng) for _ in sun_R])
    start_X_RG = perturbed(true_X_RG, o_G, seed, START_DEG, START_M)
    return Trials(views, whole, X_RG, true_X_RG, sun_R, start_X_RG, 1000 * number)


@lru_cache(maxsize=len(NAMES))
def views_of(body: str, rich: bool) -> tuple[EdgeViews, EdgeModel]:
    """Of a body in matte grey, or with its own surface."""
    target = edge_body(body, plain=not rich)
    return EdgeViews(target, RIG, 3, LENS), edge_model(target.mesh)


def _jittered(X_RG: Array, o_G: Array, rng: np.random.Generator) -> Array:
    """Another position of the edges between the pixels."""
    step = np.zeros(6)
    step[:2] = rng.uniform(-1, 1, 2) * JITTER_PX * X_RG[2, 3] / RIG.focal_px
    step[3:] = np.deg2rad(JITTER_DEG) * rng.standard_normal(3)
    return moved(X_RG, step, o_G)


def models_of(model: EdgeModel) -> list[EdgeModel]:
    """The model and two with fewer edges; a smooth part is as long as the diagonal of its box."""
    corners, curved = np.asarray(model.surface.triangles), model.part >= 0
    low = np.full((len(model.outlined), 3), np.inf)
    high = -low
    np.minimum.at(low, model.part[curved], corners[curved].min(axis=1))
    np.maximum.at(high, model.part[curved], corners[curved].max(axis=1))
    length = np.concatenate([model.lengths_m, np.linalg.norm(high - low, axis=1) * model.outlined])
    order = np.argsort(-length, kind="stable")
    reached = np.cumsum(length[order]) / length.sum()
    shares = SHARES.values()
    return [model.only(order[: int(np.searchsorted(reached, share * (1.0 - 1e-9))) + 1]) for share in shares]


def off_px(p_G: Array, X_RG: Array, true: Array) -> float:
    """Displacement in the image of points (m, 3) at an estimated pose, root mean square; 999 px at most."""
    if len(p_G) == 0:
        return 999.0
    here, there = (RIG.project(transform_points(X, p_G))[:, :2] for X in (X_RG, true))
    return float(min(np.sqrt(np.mean(np.sum((here - there) ** 2, axis=1))), 999.0))


def rounded(values: Any) -> Any:
    """Numbers of seven digits for JSON; NaN and inf as null."""
    flat = np.asarray(values, dtype=np.float64)
    short = [float(f"{v:.6e}") if np.isfinite(v) else None for v in flat.reshape(-1)]
    return short[0] if flat.ndim == 0 else short
