"""Scores of the surface network on bodies that it has not learned from.

Pairs of images of one body that differ in light alone, in pose alone, or in both. For each kind of pair:

- ``rank_1``: share of the common landmarks whose most similar descriptor, among all points of the other
  image, belongs to the right place;
- ``found``: share of the places that the network finds in the first image, on surface that the second one
  shows, near which it finds one there too; ``found_blobs``: the same of as many blobs;
- ``scatter_px``: median distance of the two, transformed by the true motion; ``scatter_blobs_px``;
- ``residual``: root mean square of their difference over its standard deviation, each axis;
  ``within_3_sigma``: share of the differences of at most three of them, 98.9 % for a Gaussian.

For single images: ``shadow_iou`` and ``highlight_iou``, intersection over union of the pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.frontend.features.keypoints import find_candidates
from polhode.frontend.networks.surface import DenseOutput, SurfaceNet, find_places, sample_rings
from polhode.geometry.lie import Array, transform_points
from polhode.train.descriptor.surface_points import near_rim
from polhode.train.surface.batches import Example, batch_of, draw_example
from polhode.train.surface.landmarks import MIN_COSINE, RIM_PX, KnownBody, cosine_to_camera, surface_at
from polhode.train.surface.lit_bodies import CAST_SHADOW, FACING_AWAY, HIGHLIGHT
from polhode.train.task import Batch

NAMES = ("light", "pose", "both")
"""What the images of a pair differ in."""
MAX_BODIES = 24
CROP_PX = 320
POINTS = 400
REPEAT_PX = 1.5
"""Largest distance of a place that is found again from the true one [px]."""


@dataclass(frozen=True)
class Trial:
    """One pair of images."""

    kind: str
    example: Example
    batch: Batch


def trials_of(bodies: Mapping[int, KnownBody], seed: int) -> list[Trial]:
    """Pairs of images, which depend only on bodies and seed."""
    rng = np.random.default_rng([seed, 0x7E57])
    trials = []
    for number in sorted(bodies)[:MAX_BODIES]:
        for k, kind in enumerate(NAMES):
            example = draw_example(bodies[number], rng, CROP_PX, np.eye(3)[k].tolist())
            if example is not None:
                trials.append(Trial(kind, example, batch_of([example], POINTS, rng)))
    return trials


def score_trials(network: SurfaceNet, trials: list[Trial]) -> dict[str, float]:
    """Means over the trials of each kind; see the module."""
    found: dict[str, list[float]] = {}
    device = next(network.parameters()).device
    with torch.no_grad():
        for trial in trials:
            batch = {name: value.to(device) for name, value in trial.batch.items()}
            dense = network.dense(batch["images"])
            values = {"rank_1": _rank_1(network, dense, batch)} | _repeated(dense, trial.example)
            values = {f"{name}_{trial.kind}": value for name, value in values.items()} | _light(dense, batch)
            for name, value in values.items():
                if np.isfinite(value):
                    found.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in sorted(found.items())}


def _rank_1(network: SurfaceNet, dense: DenseOutput, batch: Batch) -> float:
    rings = sample_rings(dense.channels, batch["owner"], batch["uv"], batch["affine"])
    described = network.describe(rings).descriptor
    m = len(batch["pair"])
    uv = torch.cat([batch["uv_b"], batch["uv_distractor"]])
    best = (described[:m] @ described[m:].T).argmax(dim=1)
    off = torch.linalg.vector_norm(uv[best] - batch["uv_b"], dim=1)
    return float((off < 3.0).float().mean())  # largest distance of a right match from the true place [px]


def _repeated(dense: DenseOutput, example: Example) -> dict[str, float]:
    """How places and blobs are found again."""
    body = example.known.body
    places, sigmas, blobs = [], [], []
    for side, (view, window) in enumerate(zip(example.views, example.windows, strict=True)):
        pose = body.pose_of(view)
        corner = np.s_[: window.side_v, : window.side_u]
        mask, grey = np.zeros(tuple(dense.score.shape[1:]), bool), np.zeros(dense.score.shape[1:], np.uint8)
        mask[corner] = (body.on_target(pose) & ~near_rim(body.depth_m[pose], RIM_PX))[window.part]
        grey[corner] = body.grey[view][window.part]
        # number of places that are found in an image, at most
        found = find_places(dense, side, torch.from_numpy(mask).to(dense.score.device), 500)
        places.append(found.uv_px.cpu().numpy().astype(np.float64))
        sigmas.append(found.log_sigma.exp().cpu().numpy().astype(np.float64))
        blob = Features(contrast_threshold=0.006, max_features=max(len(places[-1]), 50))
        blobs.append(find_candidates(grey, mask, blob).uv_px)
    share, off, sigma = _found_again(example, places, sigmas)
    share_blobs, off_blobs, _ = _found_again(example, blobs, [np.ones(len(each)) for each in blobs])
    return {
        "found": share,
        "found_blobs": share_blobs,
        "scatter_px": float(np.median(off)) if len(off) else np.nan,
        "scatter_blobs_px": float(np.median(off_blobs)) if len(off_blobs) else np.nan,
        "residual": float(np.sqrt(np.mean(np.minimum(off / sigma, 4.0) ** 2) / 2.0)) if len(off) else np.nan,
        "within_3_sigma": float(np.mean(off < 3.0 * sigma)) if len(off) else np.nan,
        "places": float(np.mean([len(each) for each in places])),
    }


def _found_again(example: Example, places: list[Array], sigmas: list[Array]) -> tuple[float, Array, Array]:
    """Share of the first side's places that are found again; distances and sigmas (k,) [px] of those."""
    body, (pose_a, pose_b) = example.known.body, example.poses
    corner_a, corner_b = (window.corner_px for window in example.windows)
    nothing = float("nan"), np.zeros(0), np.zeros(0)
    if min(map(len, places)) == 0:
        return nothing
    p_A = surface_at(body, pose_a, places[0] + corner_a).p_K
    p_B = transform_points(body.X_between(pose_b, pose_a), p_A)
    uv = body.rig(pose_b).project(p_B)[:, :2]
    inside = np.isfinite(uv).all(axis=1) & example.windows[1].has(np.nan_to_num(uv))
    at = surface_at(body, pose_b, np.where(inside[:, None], uv, 0.0))
    with np.errstate(invalid="ignore"):
        near = np.abs(at.p_K[:, 2] - p_B[:, 2]) < 2.0 * p_B[:, 2] / float(body.focal_px)
        there = inside & near & (cosine_to_camera(at) > MIN_COSINE)
    if not there.any():
        return nothing
    distance, nearest = cKDTree(places[1] + corner_b).query(uv[there])
    again = distance < REPEAT_PX
    sigma = np.hypot(sigmas[0][there][again], sigmas[1][nearest[again]])
    return float(again.mean()), distance[again], sigma


def _light(dense: DenseOutput, batch: Batch) -> dict[str, float]:
    """Intersection over union of shadows and of highlights."""
    guess, truth = dense.light.argmax(dim=1), batch["light"]
    on = truth < dense.light.shape[1]
    result = {}
    for name, kinds in (("shadow_iou", (CAST_SHADOW, FACING_AWAY)), ("highlight_iou", (HIGHLIGHT,))):
        of_kind = torch.tensor(kinds, device=truth.device)
        a, b = (torch.isin(each, of_kind) & on for each in (guess, truth))
        union = int((a | b).sum())
        result[name] = float(int((a & b).sum()) / union) if union > 50 else float("nan")
    return result
