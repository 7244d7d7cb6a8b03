"""Scores of the surface network on bodies outside the training set.

    python -m polhode.train.surface.scores configs/train/surface_test.yaml [--weights FILE]

scores weights on all bodies of a configuration, which are rendered if they are missing, and prints a table.
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from polhode.config.loader import load_config
from polhode.errors import InputError, RunFailure
from polhode.frontend.features.judgement import surface_network
from polhode.frontend.networks.surface import SurfaceNet
from polhode.lie import Array
from polhode.progress import Silent
from polhode.records import Bools
from polhode.train.corpus import required_train
from polhode.train.descriptor.scores import area_under_curve
from polhode.train.surface.batches import MAX_ANGLE_DEG, known_of, padded
from polhode.train.surface.lit_views import CAST_SHADOW, FACING_AWAY, HIGHLIGHT, SKY, LitViews, prepare_views

MIN_OF_EACH = 5
"""Points that are found, and that are not, of which a pair of images has at least so many."""
BINS = 10
"""Bins of the probability, of equal counts, in which it is compared with what became of the points."""


@dataclass(frozen=True)
class JudgedViews:
    """The network's output for all images of a body."""

    probability: Array
    """(N,) that a point is found in another image"""
    sigma_px: Array
    """(N,) scatter of its place, each axis"""
    light: Array
    """(V, H / 2, W / 2) most probable kind of light"""


def judge_views(network: SurfaceNet, views: LitViews) -> JudgedViews:
    """The judgement of all points of a body, in evaluation mode."""
    device = next(network.parameters()).device
    images = torch.from_numpy(padded(views.grey)[:, None].astype(np.float32)).to(device)
    owner = torch.from_numpy(views.view.astype(np.int64)).to(device)
    uv = torch.from_numpy(views.uv_px.astype(np.float32)).to(device)
    known = known_of(views, np.arange(len(views.view))).to(device)
    with torch.no_grad():
        judged, light = network(images, owner, uv, known)
    return JudgedViews(
        torch.sigmoid(judged.reliability).cpu().numpy().astype(np.float64),
        judged.log_sigma.exp().cpu().numpy().astype(np.float64),
        light.argmax(dim=1).cpu().numpy(),
    )


def score(network: SurfaceNet, bodies: Mapping[int, LitViews]) -> dict[str, float]:
    """Means over the bodies.

    ``auc``: probability, within an image, that a point which another image finds is judged better than one
    which it does not; ``auc_light`` and ``auc_pose`` for pairs that differ in their light alone, and in their
    pose; ``auc_sharpness``: the same by the sharpness of the texture alone, for comparison. ``calibration``:
    mean difference between the probability and the share that is found. ``normalised_variance``: of the
    places of matches; 1 if the sigmas are right; ``beyond_3_sigma``: share of the matches that are off by
    more on either axis. ``shadow_iou``, ``highlight_iou``: area of the masks that is right, over that of
    truth and mask together.
    """
    judged = {i: judge_views(network, views) for i, views in bodies.items()}
    scores: dict[str, float] = {}
    for name, kinds in {"auc": (True, False), "auc_light": (True,), "auc_pose": (False,)}.items():
        scores[name] = _mean([_auc(bodies[i], judged[i].probability, kinds) for i in bodies])
    scores["auc_sharpness"] = _mean(
        [_auc(views, -views.sigma_ls_px, (True, False)) for views in bodies.values()]
    )
    scores["calibration"] = _calibration(bodies, judged)
    normalised = np.concatenate([_normalised(bodies[i], judged[i].sigma_px) for i in bodies])
    if len(normalised):
        scores["normalised_variance"] = float(np.mean(normalised**2))
        scores["beyond_3_sigma"] = float(np.mean(np.abs(normalised).max(axis=1) > 3.0))
    scores["shadow_iou"] = _overlap(bodies, judged, (CAST_SHADOW, FACING_AWAY))
    scores["highlight_iou"] = _overlap(bodies, judged, (HIGHLIGHT,))
    return scores


def counted(views: LitViews) -> Bools:
    """Sightings (M,) that are compared: those of training."""
    return np.asarray(views.angle_rad < np.deg2rad(MAX_ANGLE_DEG))


def _auc(views: LitViews, value: Array, kinds: tuple[bool, ...]) -> float:
    """Mean over the pairs of images whose poses are the same (True) or not (False); NaN if there is none."""
    use = counted(views)
    a, b = views.view[views.point], views.other
    use &= np.isin(views.pose[a] == views.pose[b], kinds)
    areas = []
    key = a * len(views.grey) + b
    for each in np.unique(key[use]):
        here = np.flatnonzero(use & (key == each))
        found = views.match[here] >= 0
        if MIN_OF_EACH <= found.sum() <= len(found) - MIN_OF_EACH:
            areas.append(area_under_curve(value[views.point[here]], found))
    return _mean(areas)


def _calibration(bodies: Mapping[int, LitViews], judged: Mapping[int, JudgedViews]) -> float:
    use = {i: counted(views) for i, views in bodies.items()}
    said = np.concatenate([judged[i].probability[views.point[use[i]]] for i, views in bodies.items()])
    found = np.concatenate([views.match[use[i]] >= 0 for i, views in bodies.items()])
    order = np.argsort(said, kind="stable")
    parts = [part for part in np.array_split(order, BINS) if len(part)]
    return _mean([float(abs(said[part].mean() - found[part].mean())) for part in parts])


def _normalised(views: LitViews, sigma_px: Array) -> Array:
    """Offsets (m, 2) of the matches over their standard deviations."""
    use = counted(views) & (views.match >= 0)
    sigma = np.hypot(sigma_px[views.point[use]], sigma_px[views.match[use]])
    return np.asarray(views.off_px[use] / sigma[:, None])


def _overlap(
    bodies: Mapping[int, LitViews], judged: Mapping[int, JudgedViews], kinds: tuple[int, ...]
) -> float:
    """Intersection over union of masks of kinds of light, of all bodies together."""
    both = either = 0
    for i, views in bodies.items():
        truth = padded(views.light)[:, ::2, ::2]
        on_target = truth != SKY
        # padding is no target either
        on_target[:, (views.light.shape[1] + 1) // 2 :] = False
        on_target[:, :, (views.light.shape[2] + 1) // 2 :] = False
        true, said = (np.isin(each, kinds) & on_target for each in (truth, judged[i].light))
        both, either = both + int((true & said).sum()), either + int((true | said).sum())
    return both / max(either, 1)


def _mean(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else 0.5


def main(arguments: Sequence[str] | None = None) -> None:
    """Score weights of the surface network on the bodies of a configuration."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.surface.scores", description=main.__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("--weights", type=Path, help="weights file; default: the shipped weights")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    try:
        train = required_train(load_config(options.config).train, options.config)
        network = surface_network(options.weights)
        bodies = prepare_views(train.corpus, train.surface, Silent(), options.workers)
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    rows = {str(i): score(network, {i: views}) for i, views in bodies.items()}
    rows["all"] = score(network, bodies)
    names = list(rows["all"])
    print(f"| body | {' | '.join(names)} |\n|{' --- |' * (len(names) + 1)}")
    for name, values in rows.items():
        print(f"| {name} | {' | '.join(f'{values[n]:.3f}' if n in values else '' for n in names)} |")


if __name__ == "__main__":
    main()
