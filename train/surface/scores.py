"""Scores of the surface network on bodies that it has not learned from.

    python -m polhode.train.surface.scores CONFIG WEIGHTS [WEIGHTS ...] [--more K]

compares weights on the same pairs of the configuration's held-out bodies, or of those of its K-th further
corpus.

Pairs of images of one body that differ in light alone, in pose alone, or in both. For each kind of pair:

- ``rank_1``: share of the common landmarks whose most similar descriptor, among all points of the other
  image, belongs to the right place;
- ``own_albedo``, of shapes with several albedos: share of the landmarks that are more similar to themselves
  in the other image than to the same place there under another albedo;
- ``found``: share of the places that the network finds in the first image, on surface that the second one
  shows, near which it finds one there too; ``found_blobs``: the same of as many blobs;
- ``scatter_px``: median distance of the two, transformed by the true motion; ``scatter_blobs_px``;
- ``residual``: root mean square of their difference over its standard deviation, each axis;
  ``within_3_sigma``: share of the differences of at most three of them, 98.9 % for a Gaussian.

For single images: ``shadow_iou`` and ``highlight_iou``, intersection over union of the pixels.
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.config.loader import load_config
from polhode.frontend.features.keypoints import find_candidates
from polhode.frontend.features.landmark_places import find_places
from polhode.frontend.networks.surface import DenseOutput, SurfaceNet, sample_rings
from polhode.frontend.networks.weights import load_weights
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Silent
from polhode.train.corpus import required_train
from polhode.train.surface.batches import Example, KnownBody, batch_of, draw_example
from polhode.train.surface.known_bodies import NEXT_ALBEDO, corpus_of, prepare_bodies
from polhode.train.surface.landmarks import MIN_COSINE, near_rim, surface_at
from polhode.train.surface.lit_bodies import CAST_SHADOW, FACING_AWAY, HIGHLIGHT
from polhode.train.task import Batch

NAMES = ("light", "pose", "both")
"""What the images of a pair differ in."""
PAIRS_PER_BODY = 1
MAX_BODIES = 24
CROP_PX = 320
POINTS = 400
MAX_ERROR_PX = 3.0
"""Largest distance of a right match from the true place [px]."""
REPEAT_PX = 1.5
"""Largest distance of a place that is found again from the true one [px]."""
PLACES = 500
"""Number of places that are found in an image, at most."""


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
            for _ in range(PAIRS_PER_BODY):
                example = draw_example(bodies[number], rng, CROP_PX, np.eye(3)[k])
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
            values = _told_apart(network, dense, batch) | _repeated(dense, trial)
            for name, value in values.items():
                if np.isfinite(value):
                    found.setdefault(f"{name}_{trial.kind}", []).append(value)
            for name, value in _light(dense, batch).items():
                if np.isfinite(value):
                    found.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in sorted(found.items())}


def _told_apart(network: SurfaceNet, dense: DenseOutput, batch: Batch) -> dict[str, float]:
    """How descriptors tell points apart."""
    rings = sample_rings(dense.channels, batch["owner"], batch["uv"], batch["affine"])
    described = network.describe(rings).descriptor
    m = len(batch["pair"])
    uv = torch.cat([batch["uv_b"], batch["uv_distractor"]])
    best = (described[:m] @ described[m : m + len(uv)].T).argmax(dim=1)
    off = torch.linalg.vector_norm(uv[best] - batch["uv_b"], dim=1)
    found = {"rank_1": float((off < MAX_ERROR_PX).float().mean())}
    if "other" in batch:
        first, second = described[batch["other"]], described[m + batch["other"]]
        nearer = (first * second).sum(dim=1) > (first * described[m + len(uv) :]).sum(dim=1)
        found["own_albedo"] = float(nearer.float().mean())
    return found


def _repeated(dense: DenseOutput, trial: Trial) -> dict[str, float]:
    """How places and blobs are found again."""
    example = trial.example
    body = example.known.body
    places, sigmas, blobs = [], [], []
    for side in (0, 1):
        view, window = example.views[side], example.windows[side]
        pose = body.pose_of(view)
        part = np.s_[window.v0 : window.v0 + window.side_v, window.u0 : window.u0 + window.side_u]
        mask = np.zeros(tuple(dense.score.shape[1:]), bool)
        mask[: window.side_v, : window.side_u] = (
            np.isfinite(body.depth_m[pose]) & ~near_rim(body.depth_m[pose])
        )[part]
        found = find_places(dense, side, torch.from_numpy(mask).to(dense.score.device), PLACES)
        places.append(found.uv_px.cpu().numpy().astype(np.float64))
        sigmas.append(found.log_sigma.exp().cpu().numpy().astype(np.float64))
        grey = np.zeros(mask.shape, np.uint8)
        grey[: window.side_v, : window.side_u] = body.grey[view][part]
        count = max(len(places[-1]), 50)
        blobs.append(
            find_candidates(grey, mask, Features(contrast_threshold=0.006, max_features=count)).uv_px
        )
    share, off, sigma = _found_again(example, places, sigmas)
    share_blobs, off_blobs, _ = _found_again(example, blobs, [np.ones(len(each)) for each in blobs])
    residual = np.sqrt(np.mean(np.minimum(off / sigma, 4.0) ** 2) / 2.0) if len(off) else np.nan
    return {
        "found": share,
        "found_blobs": share_blobs,
        "scatter_px": float(np.median(off)) if len(off) else np.nan,
        "scatter_blobs_px": float(np.median(off_blobs)) if len(off_blobs) else np.nan,
        "residual": float(residual),
        "within_3_sigma": float(np.mean(off < 3.0 * sigma)) if len(off) else np.nan,
        "places": float(np.mean([len(each) for each in places])),
    }


def _found_again(example: Example, places: list[Array], sigmas: list[Array]) -> tuple[float, Array, Array]:
    """Share of the first side's places that are found again; distances and sigmas (k,) [px] of those."""
    body = example.known.body
    poses = [body.pose_of(view) for view in example.views]
    corner = [np.array([w.u0, w.v0], float) for w in example.windows]
    nothing = np.zeros(0)
    if min(map(len, places)) == 0:
        return float("nan"), nothing, nothing
    p_A, _ = surface_at(body, poses[0], places[0] + corner[0])
    p_B = transform_points(body.X_KG[poses[1]] @ inverse_pose(body.X_KG[poses[0]]), p_A)
    uv = p_B[:, :2] / p_B[:, 2:] * float(body.focal_px) + body.centre_of_part_px(poses[1])
    inside = np.isfinite(uv).all(axis=1) & example.windows[1].has(np.nan_to_num(uv))
    there = np.full(len(uv), False)
    surface, normal = surface_at(body, poses[1], np.where(inside[:, None], uv, 0.0))
    px_m = p_B[:, 2] / float(body.focal_px)
    cosine = -np.einsum("nk,nk->n", normal, surface) / np.maximum(np.linalg.norm(surface, axis=1), 1e-9)
    with np.errstate(invalid="ignore"):
        there = inside & (np.abs(surface[:, 2] - p_B[:, 2]) < 2.0 * px_m) & (cosine > MIN_COSINE)
    if not there.any():
        return float("nan"), nothing, nothing
    distance, nearest = cKDTree(places[1] + corner[1]).query(uv[there])
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the scores of weights on the held-out bodies of a configuration."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.surface.scores", description=main.__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("weights", type=Path, nargs="+")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--more", type=int, default=0, metavar="K", help="of the K-th entry of surface.more")
    options = parser.parse_args(arguments)
    try:
        config = load_config(options.config)
        train = required_train(config.train, options.config)
        corpus, surface = corpus_of(train, options.more)
        bodies = prepare_bodies(corpus, surface, Silent(), options.workers)
        trials = trials_of(
            {i: known for i, known in bodies.items() if corpus.is_validation(i % NEXT_ALBEDO)}, config.seed
        )
        found = []
        for path in options.weights:
            network = SurfaceNet()
            load_weights(network, path)
            found.append(score_trials(network, trials))
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    for name in found[0]:
        print(f"{name:22} " + "  ".join(f"{scores[name]:.3f}" for scores in found))


if __name__ == "__main__":
    main()
