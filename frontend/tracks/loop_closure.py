"""Merging of duplicate landmarks: separate tracks that belong to one landmark according to the motion.

Two landmarks are the same if the estimated motion puts them at the same position, no frame observes both, and
their descriptors are similar from similar directions. Merging closes loops, which determine how well the
inertia is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaincinv

from polhode.config.frontend_settings import GuidedMatching
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.tracks.tracks import Association, LandmarkMap, add_observations
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.estimate import InitialMotion

MAX_VIEW_ANGLE_DEG = 30.0
"""Largest change of viewing direction between descriptors of landmarks that may be one."""
AGREEMENT_CHI2 = float(2.0 * gammaincinv(1.5, 0.99))
"""Largest normalised squared distance between two estimates of one position: 99 % of chi-squared with three
degrees of freedom."""
POSITION_FLOOR_PX = 0.3
"""Uncertainty of a landmark's position beyond its observation noise, from poses and light, as an image
distance."""


@dataclass(frozen=True)
class _Views:
    """All observations of one landmark."""

    direction_G: Array
    """(n, 3)"""
    descriptors: Descriptors
    """(n, d)"""
    frames: Bools
    """(F,)"""


def merge_duplicates(
    frames: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    rig: RectifiedRig,
    config: GuidedMatching,
) -> Association:
    """The association with duplicate landmarks joined; unconnected frames are not considered."""
    model = LandmarkMap.empty(association.n_landmarks)
    connected = np.flatnonzero(motion.connected).tolist()
    if not connected:
        return association
    for k in connected:
        add_observations(model, frames[k], association.landmark[k], motion.X_RG[k], rig)
    range_m = float(np.median(np.concatenate([frames[k].p_R[:, 2] for k in connected])))
    first, second = _coincident(model, POSITION_FLOOR_PX * range_m / rig.focal_px)
    if len(first) == 0:
        return association
    views = _views(model, connected, len(frames), np.unique(np.concatenate([first, second])))
    distance = np.array(
        [
            _descriptor_distance(views[a], views[b])
            for a, b in zip(first.tolist(), second.tolist(), strict=True)
        ]
    )
    name = np.arange(association.n_landmarks, dtype=np.int64)

    def root(k: int) -> int:
        while name[k] != k:
            k = int(name[k])
        return k

    # the most similar pairs are joined first, never two that one frame observes
    for pair in np.argsort(distance, kind="stable").tolist():
        if not distance[pair] < config.max_distance:
            break
        a, b = root(int(first[pair])), root(int(second[pair]))
        if a != b and not np.any(views[a].frames & views[b].frames):
            name[b] = a
            views[a].frames[:] |= views[b].frames
    dense = (
        np.unique([root(k) for k in range(len(name))], return_inverse=True)[1].reshape(-1).astype(np.int64)
    )
    return Association(
        tuple(np.where(labels >= 0, dense[np.maximum(labels, 0)], -1) for labels in association.landmark)
    )


def _coincident(model: LandmarkMap, floor_m: float) -> tuple[Ints, Ints]:
    """Pairs of landmarks whose positions agree within their uncertainty."""
    placed = np.flatnonzero(np.isfinite(model.p_G).all(axis=1))
    if len(placed) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    p_G = model.p_G[placed]
    covariance = np.linalg.inv(model.information[placed]) + floor_m**2 * np.eye(3)
    widest = np.sqrt(2.0 * AGREEMENT_CHI2 * np.linalg.eigvalsh(covariance)[:, -1])
    # A few poorly determined landmarks must not make all landmarks neighbours.
    pairs = cKDTree(p_G).query_pairs(float(np.percentile(widest, 90.0)), output_type="ndarray")
    a, b = pairs.T
    gap = p_G[a] - p_G[b]
    whitened = np.linalg.solve(covariance[a] + covariance[b], gap[..., None])[..., 0]
    near = np.sum(gap * whitened, axis=1) < AGREEMENT_CHI2
    return placed[a[near]].astype(np.int64), placed[b[near]].astype(np.int64)


def _views(model: LandmarkMap, connected: Sequence[int], n_frames: int, landmarks: Ints) -> dict[int, _Views]:
    """All observations of each landmark."""
    label = np.concatenate(model.landmark)
    frame = np.concatenate([np.full(len(seen), k) for k, seen in zip(connected, model.landmark, strict=True)])
    direction_G, descriptors = np.concatenate(model.direction_G), np.concatenate(model.descriptors)
    order = np.argsort(label, kind="stable")
    start, stop = (np.searchsorted(label[order], landmarks, side=side) for side in ("left", "right"))
    views = {}
    for landmark, a, b in zip(landmarks.tolist(), start.tolist(), stop.tolist(), strict=True):
        own, shown = order[a:b], np.zeros(n_frames, dtype=bool)
        shown[frame[own]] = True
        views[landmark] = _Views(direction_G[own], descriptors[own], shown)
    return views


def _descriptor_distance(a: _Views, b: _Views) -> float:
    """Smallest descriptor distance of two landmarks over observations from similar directions.

    Infinite if no directions are similar, or one frame observes both.
    """
    if np.any(a.frames & b.frames):
        return float("inf")
    like = a.direction_G @ b.direction_G.T > np.cos(np.deg2rad(MAX_VIEW_ANGLE_DEG))
    if not like.any():
        return float("inf")
    similarity = float(np.max((a.descriptors @ b.descriptors.T)[like]))
    return float(np.sqrt(max(2.0 - 2.0 * similarity, 0.0)))
