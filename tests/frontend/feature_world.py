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


def make_world(
    n_frames: int = 24, turn_deg: float = 30.0, points: int = 400, clutter: int = 15, seed: int = 0
) -> World:
    """A sphere of points 0.1 m in radius, 0.6 m away, seen from one side; noise of 0.3 and 0.1 px."""
    rng = np.random.default_rng(seed)
    p_G = rng.normal(size=(points, 3))
    p_G *= 0.1 / np.linalg.norm(p_G, axis=1, keepdims=True)
    base = _unit(rng.normal(size=(points, 128)))
    axis = np.array([0.1, 1.0, 0.2]) / np.linalg.norm([0.1, 1.0, 0.2])
    frames, poses, shown = [], [], []
    for k in range(n_frames):
        X_RG = make_pose(exp_so3(axis * np.deg2rad(turn_deg) * k), [0.002 * k, -0.001 * k, 0.6])
        p_R = transform_points(X_RG, p_G)
        facing = np.einsum("na,na->n", p_R - X_RG[:3, 3], -p_R) / np.linalg.norm(p_R, axis=1) > 0.04
        seen = np.flatnonzero(facing & (rng.uniform(size=points) < 0.7))
        uvd = RIG.project(p_R[seen]) + rng.normal(size=(len(seen), 3)) * [0.3, 0.3, 0.1]
        descriptors = _unit(base[seen] + 0.045 * rng.normal(size=(len(seen), 128)))
        junk = np.column_stack([rng.uniform([250, 180, 60], [390, 300, 80], (clutter, 3))])
        uvd = np.concatenate([uvd, junk])
        descriptors = np.concatenate([descriptors, _unit(rng.normal(size=(clutter, 128)))])
        order = rng.permutation(len(uvd))
        n = len(uvd)
        frames.append(
            StereoFeatures(
                uvd[order],
                np.tile([0.3, 0.3, 0.1], (n, 1)),
                RIG.triangulate(uvd[order]),
                np.full(n, 2.0),
                descriptors[order].astype(np.float32),
            )
        )
        poses.append(X_RG)
        shown.append(np.concatenate([seen, np.full(clutter, -1)])[order].astype(np.int64))
    return World(frames, np.array(poses), shown)


def purity(labels: list[Ints], shown: list[Ints], min_views: int = 2) -> float:
    """Share of the observations of real landmarks that show the landmark's most frequent point."""
    label, truth = np.concatenate(labels), np.concatenate(shown)
    right = total = 0
    for landmark in np.unique(label[label >= 0]):
        points = truth[label == landmark]
        if len(points) >= min_views:
            total += len(points)
            right += int(np.max(np.bincount(points + 1)))
    return right / total


def _unit(a: Array) -> Array:
    return np.asarray(a / np.linalg.norm(a, axis=-1, keepdims=True))
