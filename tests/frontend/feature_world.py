"""A tumbling cloud of points with descriptors: stereo features whose truth is known, without images."""

from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, exp_so3, make_pose, transform_points

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)


@dataclass(frozen=True)
class World:
    frames: list[StereoFeatures]
    X_RG: Array
    """(F, 4, 4) truth"""
    shown: list[Ints]
    """per frame, the true point of each feature; -1 for clutter"""


def make_world(n_frames: int = 24, turn_deg: float = 30.0, points: int = 400, clutter: int = 15) -> World:
    """A sphere of points 0.1 m in radius, 0.6 m away, seen from one side; noise of 0.3 and 0.1 px."""
    rng = np.random.default_rng(0)
    p_G = 0.1 * unit(rng.normal(size=(points, 3)))
    base = unit(rng.normal(size=(points, 128)))
    axis = np.array([0.1, 1.0, 0.2]) / np.linalg.norm([0.1, 1.0, 0.2])
    frames, poses, shown = [], [], []
    for k in range(n_frames):
        X_RG = make_pose(exp_so3(axis * np.deg2rad(turn_deg) * k), [0.002 * k, -0.001 * k, 0.6])
        p_R = transform_points(X_RG, p_G)
        facing = np.einsum("na,na->n", p_R - X_RG[:3, 3], -p_R) / np.linalg.norm(p_R, axis=1) > 0.04
        seen = np.flatnonzero(facing & (rng.uniform(size=points) < 0.7))
        uvd = RIG.project(p_R[seen]) + rng.normal(size=(len(seen), 3)) * [0.3, 0.3, 0.1]
        descriptors = unit(base[seen] + 0.045 * rng.normal(size=(len(seen), 128)))
        uvd = np.concatenate([uvd, rng.uniform([250, 180, 60], [390, 300, 80], (clutter, 3))])
        descriptors = np.concatenate([descriptors, unit(rng.normal(size=(clutter, 128)))])
        order, n = rng.permutation(len(uvd)), len(uvd)
        uvd, sigma = uvd[order], np.tile([0.3, 0.3, 0.1], (n, 1))
        looks = descriptors[order].astype(np.float32)
        frames.append(StereoFeatures(uvd, sigma, RIG.triangulate(uvd), np.full(n, 2.0), looks))
        poses.append(X_RG)
        shown.append(np.concatenate([seen, np.full(clutter, -1)])[order].astype(np.int64))
    return World(frames, np.array(poses), shown)


def first_features(features: StereoFeatures, count: int, width: int = 128) -> StereoFeatures:
    """The first ``count`` of them, with descriptors of some width, and without axes."""
    f, n = features, count
    return StereoFeatures(f.uvd_px[:n], f.sigma_px[:n], f.p_R[:n], f.scale_px[:n], f.descriptors[:n, :width])


def purity(labels: list[Ints], shown: list[Ints]) -> float:
    """Share of the observations of real landmarks that show the landmark's most frequent point."""
    label, truth = np.concatenate(labels), np.concatenate(shown)
    right = total = 0
    for landmark in np.unique(label[label >= 0]):
        points = truth[label == landmark]
        if len(points) >= 2:
            total += len(points)
            right += int(np.max(np.bincount(points + 1)))
    return right / total


def unit(a: Array) -> Array:
    return np.asarray(a / np.linalg.norm(a, axis=-1, keepdims=True))
