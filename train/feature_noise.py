"""Estimation of the constants of ``frontend.features.surface_features`` from simulated scenes, and their
validation.

    python -m polhode.train.feature_noise configs/train/features.yaml [--scenes 24] [--check SEQUENCE ...]
                                           [--surface-descriptor surface]

SEQUENCE: folders of ``polhode simulate``. Neighbouring frames are matched as in a run. The matches that pass
the geometric check are compared with the true motion.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from polhode.config.frontend_settings import Features, Frontend
from polhode.config.loader import load_config
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import (
    SurfaceFeatureMethod,
    confidence_logit,
    match_sigma,
    with_patch_size,
)
from polhode.frontend.matching.matchers import SoftmaxMatcher
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.frontend.rectification import Rectifier, make_rectifier, rectified_pair
from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.dataset.sequence import SCENE_FILE
from polhode.train.corpus import scene_folder, split

MAX_MOTION_ERROR_DEG = 2.0
"""Frame pairs with a larger error of the motion are omitted: their matches are wrong, not inaccurate
[deg]."""


@dataclass(frozen=True)
class MatchResiduals:
    """Errors of the matches of one scene that passed the geometric check."""

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
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    X_RG = true_poses(folder, rectifier)
    config = with_patch_size(frontend, sequence, rectifier)
    method, match = SurfaceFeatureMethod(config), SoftmaxMatcher(config)
    pairs = [rectified_pair(sequence, rectifier, k) for k in range(len(sequence))]
    frames = [method(pair, rectifier.rig) for pair in pairs]
    parts = []
    for k in range(len(frames) - 1):
        a, b = frames[k], frames[k + 1]
        found = match(a, b)
        if len(found.features) < MIN_INLIERS:
            continue
        agreed = _true_residuals(
            a, b, found.features, rectifier, config, X_RG[k] @ inverse_pose(X_RG[k + 1]), k
        )
        if agreed is None:
            continue
        part, passed = agreed
        chosen, confidence = found.features[passed], found.confidence[passed]
        sigma_ls, place = (
            np.column_stack([of(a)[chosen[:, 0]], of(b)[chosen[:, 1]]]) for of in (_sigma_ls, _place_sigma)
        )
        logit = confidence_logit(confidence)
        parts.append((part, match_sigma(a, b, chosen, confidence), sigma_ls, place, logit))
    return MatchResiduals(*(np.concatenate(each) for each in zip(*parts, strict=True))) if parts else None


def true_poses(folder: Path, rectifier: Rectifier) -> list[Array]:
    """X_RG (4, 4) of each frame."""
    path = folder / SCENE_FILE
    if not path.is_file():
        raise InputError(f"{path} is missing: give a folder of polhode simulate")
    config = load_config(path)
    assert config.scene is not None  # the file that ``simulate`` wrote
    plan = plan_sequence(config.scene, config.seed)
    X_NR = [X_NC @ rectifier.X_CR for X_NC in plan.X_NC]
    # The true motion extends beyond the last image.
    return [inverse_pose(X) @ plan.target.X_NG[k] for k, X in enumerate(X_NR)]


def _true_residuals(
    a: StereoFeatures,
    b: StereoFeatures,
    pairs: Ints,
    rectifier: Rectifier,
    config: Frontend,
    X_AB: Array,
    seed: int,
) -> tuple[Array, Ints] | None:
    """Errors (m, 3) of the matches that pass the geometric check, and their indices (m,)."""
    i, j = pairs.T
    rig = rectifier.rig
    rng = np.random.default_rng(seed)
    fit = ransac_rigid(a.uvd_px[i], a.p_R[i], b.p_R[j], rig, rng)
    turn = (np.trace(fit.X_RiRj[:3, :3].T @ X_AB[:3, :3]) - 1.0) / 2.0
    if fit.inlier.sum() < MIN_INLIERS or turn < np.cos(np.deg2rad(MAX_MOTION_ERROR_DEG)):
        return None
    residual = rig.project(transform_points(X_AB, b.p_R[j])) - a.uvd_px[i]
    return residual[fit.inlier], np.flatnonzero(fit.inlier)


def _sigma_ls(features: StereoFeatures) -> Array:
    assert features.sigma_ls_px is not None
    return features.sigma_ls_px


def _place_sigma(features: StereoFeatures) -> Array:
    if features.place_sigma_px is None:
        return np.zeros(len(features))
    return features.place_sigma_px


@dataclass(frozen=True)
class NoiseConstants:
    """Constants of one of the components."""

    floor_px: float
    gain_px: float
    confidence: tuple[float, float]


def fit_noise(
    scenes: Sequence[MatchResiduals], columns: Sequence[int], by_place: bool = False
) -> NoiseConstants:
    """Maximum likelihood of zero-mean Gaussian residuals, each scene with the same weight.

    The variance of a feature is floor^2 + gain * sigma_ls, or ``by_place`` floor^2 + gain * place_sigma^2.
    """
    square = np.concatenate([np.mean(s.residual_px[:, columns] ** 2, axis=1) for s in scenes])
    share = np.concatenate([np.full(len(s.logit), 1.0 / len(s.logit)) for s in scenes])
    known = [s.place_sigma_px**2 if by_place else s.sigma_ls_px for s in scenes]
    varying = np.sum(np.concatenate(known), axis=1)
    logit = np.concatenate([s.logit for s in scenes])

    def features_alone(b: Array) -> Array:
        return np.asarray(np.log(2.0 * np.exp(2.0 * b[0]) + np.exp(b[1]) * varying))

    def cost(log_variance: Array) -> float:
        return float(np.sum(share * (log_variance + square * np.exp(-log_variance))))

    alone = minimize(lambda b: cost(features_alone(b)), np.array([-2.0, 0.0]), method="Nelder-Mead").x
    base = features_alone(alone)
    more = minimize(lambda c: cost(base + c[0] + c[1] * logit), np.zeros(2), method="Nelder-Mead").x
    return NoiseConstants(float(np.exp(alone[0])), float(np.exp(alone[1])), (float(more[0]), float(more[1])))


def normalised_variance(scene: MatchResiduals) -> tuple[float, float]:
    """Mean squared ratio of errors to sigmas, for u and v and for disparity; 1 for consistent sigmas."""
    square = (scene.residual_px / scene.sigma_px) ** 2
    return float(np.mean(square[:, :2])), float(np.mean(square[:, 2]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the constants, and the normalised variance of the named scenes with the present ones."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.feature_noise", description=__doc__)
    parser.add_argument("config", type=Path, metavar="CONFIG", help="configuration with the corpus, YAML")
    parser.add_argument("--scenes", type=int, default=24, help="number of training scenes")
    parser.add_argument("--check", type=Path, nargs="*", default=[], metavar="SEQUENCE")
    parser.add_argument("--surface-descriptor", choices=("network", "surface"), default="network")
    options = parser.parse_args(arguments)
    features = Features(method="polhode", surface_descriptor=options.surface_descriptor)
    try:
        _execute(options.config, options.scenes, options.check, Frontend(features=features))
    except InputError as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")


def _execute(config: Path, count: int, checked: Sequence[Path], frontend: Frontend) -> None:
    section = load_config(config).train
    if section is None:
        raise InputError(f"{config} has no corpus: give a configuration for polhode train")
    if count:
        training = split(section.corpus).training
        folders = [scene_folder(section.corpus, i) for i in training[:count]]
        found = [scene_residuals(folder, frontend) for folder in folders if folder.is_dir()]
        scenes = [scene for scene in found if scene is not None]
        print(f"{len(scenes)} training scenes, {sum(len(s.logit) for s in scenes)} matches")
        by_place = any(scene.place_sigma_px.any() for scene in scenes)
        for name, columns in (("u, v", (0, 1)), ("disparity", (2,))):
            fitted = fit_noise(scenes, columns, by_place and columns == (0, 1))
            first, slope = fitted.confidence
            print(f"{name}: floor {fitted.floor_px:.4f} px, gain {fitted.gain_px:.3f} px", end=", ")
            print(f"confidence {first:.3f} {slope:.3f}")
        _print_normalised_variance("training", scenes)
    named = [(folder.name, scene_residuals(folder, frontend)) for folder in checked]
    tested = [(name, scene) for name, scene in named if scene is not None]
    for name, scene in tested:
        _print_normalised_variance(name, [scene])
    if tested:
        _print_normalised_variance("all of these", [scene for _, scene in tested])


def _print_normalised_variance(name: str, scenes: Sequence[MatchResiduals]) -> None:
    count = [len(scene.logit) for scene in scenes]
    variance = np.array([normalised_variance(scene) for scene in scenes])
    pooled = np.average(variance, axis=0, weights=count)
    by_scene = variance.mean(axis=0)
    print(
        f"{name}: {sum(count)} matches; normalised variance of u, v {pooled[0]:.2f}, of disparity "
        f"{pooled[1]:.2f}; each scene alike {by_scene[0]:.2f}, {by_scene[1]:.2f}"
    )


if __name__ == "__main__":
    main()
