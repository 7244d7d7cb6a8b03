"""The constants of the noise model in ``frontend.features.surface_features``, fitted to simulated scenes.

    python -m lab.frontend.feature_noise [CONFIG] [--scenes 24] [--check SEQ ...]
                                         [--surface-descriptor surface]

Neighbouring frames of scenes of the corpus are matched as in a run; the matches that pass the geometric check
are compared with the true motion. ``--check`` prints the mean squared ratio of errors to sigmas of sequences
with the present constants, for u and v and for disparity; 1 for consistent sigmas.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from scipy.optimize import minimize
from tyro.conf import Positional, arg

from lab.command import ROOT, Short, command, short_scene
from polhode.config.frontend_settings import Features, Frontend
from polhode.config.loader import load_config
from polhode.frontend.features.surface_features import (
    SurfaceFeatureMethod,
    confidence_logit,
    match_sigma,
    with_patch_size,
)
from polhode.frontend.matching.matchers import SoftmaxMatcher
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.frontend.rectification import make_rectifier, rectified_pair
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.dataset import open_sequence
from polhode.train.corpus import scene_folder, split
from polhode.train.descriptor.surface_points import plan_of

MAX_MOTION_ERROR_DEG = 2.0
"""Frame pairs with a larger error of the motion are omitted: their matches are wrong, not inaccurate
[deg]."""


@dataclass(frozen=True)
class MatchResiduals:
    """Errors of m matches of a scene."""

    residual_px: Array
    """(m, 3) u, v, disparity: b's point, transformed by the true motion, minus a's measurement"""
    sigma_px: Array
    """(m, 3) by ``match_sigma`` with its present constants"""
    sigma_ls_px: Array
    """(m, 2) sigma of the least squares of both features"""
    place_sigma_px: Array
    """(m, 2) sigma of both places according to the network"""
    logit: Array
    """(m,) of the confidence"""


def scene_residuals(folder: Path, frontend: Frontend) -> MatchResiduals | None:
    """Errors of the matches of a simulated sequence; None when no two frames are matched."""
    sequence, plan = open_sequence(folder), plan_of(folder)
    rectifier = make_rectifier(sequence.calibration)
    rig, config = rectifier.rig, with_patch_size(frontend, sequence, rectifier)
    method, match = SurfaceFeatureMethod(config), SoftmaxMatcher(config)
    frames = [method(rectified_pair(sequence, rectifier, k), rig) for k in range(len(sequence))]
    X_RG = [inverse_pose(plan.X_NC[k] @ rectifier.X_CR) @ plan.target.X_NG[k] for k in range(len(frames))]
    parts = []
    for k, (a, b) in enumerate(pairwise(frames)):
        found = match(a, b)
        if len(found.features) < MIN_INLIERS:
            continue
        i, j = found.features.T
        fit = ransac_rigid(a.uvd_px[i], a.p_R[i], b.p_R[j], rig, np.random.default_rng(k))
        X_AB = X_RG[k] @ inverse_pose(X_RG[k + 1])
        cosine = (np.trace(fit.X_RiRj[:3, :3].T @ X_AB[:3, :3]) - 1.0) / 2.0
        if fit.inlier.sum() < MIN_INLIERS or cosine < np.cos(np.deg2rad(MAX_MOTION_ERROR_DEG)):
            continue
        kept, confidence = found.features[fit.inlier], found.confidence[fit.inlier]
        i, j = kept.T
        assert a.sigma_ls_px is not None and b.sigma_ls_px is not None
        place = [np.zeros(len(f)) if f.place_sigma_px is None else f.place_sigma_px for f in (a, b)]
        parts.append((
            rig.project(transform_points(X_AB, b.p_R[j])) - a.uvd_px[i],
            match_sigma(a, b, kept, confidence),
            np.column_stack([a.sigma_ls_px[i], b.sigma_ls_px[j]]),
            np.column_stack([place[0][i], place[1][j]]),
            confidence_logit(confidence),
        ))  # fmt: skip
    return MatchResiduals(*(np.concatenate(each) for each in zip(*parts, strict=True))) if parts else None


def fit_noise(scenes: list[MatchResiduals], columns: list[int], by_place: bool) -> Array:
    """Floor [px], gain, and the two constants of the confidence: maximum likelihood of Gaussian residuals.

    Each scene has the same weight. The variance of a feature is floor^2 + gain * sigma_ls, or ``by_place``
    floor^2 + gain * place_sigma^2.
    """
    square = np.concatenate([np.mean(s.residual_px[:, columns] ** 2, axis=1) for s in scenes])
    share = np.concatenate([np.full(len(s.logit), 1.0 / len(s.logit)) for s in scenes])
    varying = np.concatenate(
        [(s.place_sigma_px**2 if by_place else s.sigma_ls_px).sum(axis=1) for s in scenes]
    )
    logit = np.concatenate([s.logit for s in scenes])

    def features_alone(b: Array) -> Array:
        return np.asarray(np.log(2.0 * np.exp(2.0 * b[0]) + np.exp(b[1]) * varying))

    def cost(log_variance: Array) -> float:
        return float(np.sum(share * (log_variance + square * np.exp(-log_variance))))

    alone = minimize(lambda b: cost(features_alone(b)), np.array([-2.0, 0.0]), method="Nelder-Mead").x
    base = features_alone(alone)
    more = minimize(lambda c: cost(base + c[0] + c[1] * logit), np.zeros(2), method="Nelder-Mead").x
    return np.concatenate([np.exp(alone), more])


def main(
    config: Positional[Path] = ROOT / "configs/train/features.yaml",
    scenes: Annotated[int, arg(help="Scenes of the corpus.")] = 24,
    check: Annotated[tuple[Path, ...], arg(help="Folders of polhode simulate.")] = (),
    surface_descriptor: Literal["network", "surface"] = "network",
    short: Short = False,
) -> None:
    """Print the constants, and the normalised variances."""
    frontend = Frontend(features=Features(method="polhode", surface_descriptor=surface_descriptor))
    if short:
        scenes, check = 0, (short_scene(),)
    train = load_config(config).train
    assert train is not None
    folders = [scene_folder(train.corpus, i) for i in split(train.corpus).training[:scenes]]
    found = [scene_residuals(folder, frontend) for folder in folders if folder.is_dir()]
    training = [scene for scene in found if scene is not None]
    if training:
        by_place = any(scene.place_sigma_px.any() for scene in training)
        for name, columns in (("u, v", [0, 1]), ("disparity", [2])):
            floor_px, gain, first, slope = fit_noise(training, columns, by_place and columns == [0, 1])
            print(f"{name}: floor {floor_px:.4f} px, gain {gain:.3f} px, confidence {first:.3f} {slope:.3f}")
    named = [("training", training)] if training else []
    for folder in check:
        scene = scene_residuals(folder, frontend)
        named += [(folder.name, [scene])] if scene is not None else []
    for name, those in named:
        ratio = np.concatenate([scene.residual_px / scene.sigma_px for scene in those]) ** 2
        uv, d = ratio[:, :2].mean(), ratio[:, 2].mean()
        print(f"{name}: {len(ratio)} matches; normalised variance of u, v {uv:.2f}, of disparity {d:.2f}")


if __name__ == "__main__":
    command(main)
