"""Association with a known motion: every feature is compared with the landmarks that should be there.

Given the target's pose in each frame, measured or predicted, landmarks are grown frame by frame. A
frame whose pose is only predicted is searched in wide windows and must pass a rigid fit of its own
before it counts as measured, so that a wrong prediction is not locked in.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from frontend.ransac import fit_rigid, ransac_rigid
from frontend.stereo import StereoFeatures
from frontend.tracks import Association
from polhode.camera import RectifiedRig
from polhode.config.frontend import GuidedMatching
from polhode.lie import Array, inverse_pose, transform_points
from polhode.records import Bools, InitialMotion, Ints


@dataclass(frozen=True)
class GuidedResult:
    """The new association and the poses that it was made with."""

    association: Association
    motion: InitialMotion


@dataclass
class _Map:
    """Landmarks and their observations while they grow."""

    information: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    information_p_G: Array = field(default_factory=lambda: np.zeros((0, 3)))
    landmark: list[Ints] = field(default_factory=list)
    direction_G: list[Array] = field(default_factory=list)
    descriptors: list[np.ndarray[tuple[int, ...], np.dtype[np.float32]]] = field(default_factory=list)

    @property
    def p_G(self) -> Array:
        return np.asarray(np.linalg.solve(self.information, self.information_p_G[..., None])[..., 0])


def associate(
    frames: Sequence[StereoFeatures],
    motion: InitialMotion,
    rig: RectifiedRig,
    config: GuidedMatching,
    seed: int,
) -> GuidedResult:
    """Landmark of every feature of every frame, from scratch, given the motion.

    Measured frames come first, in order of time; then the predicted ones, nearest to a measured one first.
    """
    X_RG, connected = motion.X_RG.copy(), motion.connected.copy()
    labels: list[Ints] = [np.full(len(f), -1, dtype=np.int64) for f in frames]
    model = _Map()
    for k in np.flatnonzero(connected).tolist():
        labels[k] = _associate_frame(model, frames[k], X_RG[k], rig, config)
    waiting = [k for k in np.flatnonzero(~connected).tolist() if len(frames[k]) >= config.min_inliers]
    for k in sorted(waiting, key=lambda frame: _distance_to(frame, motion.connected)):
        X_found = _relocalise(model, frames[k], X_RG[k], rig, config, np.random.default_rng([seed, k]))
        if X_found is not None:
            X_RG[k], connected[k] = X_found, True
            labels[k] = _associate_frame(model, frames[k], X_found, rig, config)
    return GuidedResult(Association(tuple(labels)), InitialMotion(X_RG, connected))


def _distance_to(k: int, connected: Bools) -> int:
    known = np.flatnonzero(connected)
    return int(np.min(np.abs(known - k))) if len(known) else 0


def _associate_frame(
    model: _Map, features: StereoFeatures, X_RG: Array, rig: RectifiedRig, config: GuidedMatching
) -> Ints:
    """Assign one measured frame's features and enter them into the map; unmatched ones become landmarks."""
    labels = np.full(len(features), -1, dtype=np.int64)
    if len(features) == 0:
        return labels
    direction = _viewing_direction(features.p_R, X_RG)
    feature, landmark = _search(model, features, direction, X_RG, rig, config, config.fine_gate_px)
    labels[feature] = landmark
    new = labels < 0
    labels[new] = len(model.information) + np.arange(new.sum())
    _enter(model, features, labels, direction, X_RG, rig)
    return labels


def _relocalise(
    model: _Map,
    features: StereoFeatures,
    X_RG: Array,
    rig: RectifiedRig,
    config: GuidedMatching,
    rng: np.random.Generator,
) -> Array | None:
    """Measured pose of a frame near its predicted one, or None when too few landmarks agree."""
    direction = _viewing_direction(features.p_R, X_RG)
    feature, landmark = _search(model, features, direction, X_RG, rig, config, config.coarse_gate_px)
    if len(feature) < config.min_inliers:
        return None
    p_R, p_G = features.p_R[feature], model.p_G[landmark]
    fit = ransac_rigid(features.uvd_px[feature], p_R, p_G, rig, 300, 2.0, rng)
    if fit.inlier.sum() < config.min_inliers:
        return None
    return fit_rigid(p_R[fit.inlier], p_G[fit.inlier])


def _viewing_direction(p_R: Array, X_RG: Array) -> Array:
    """Unit vectors (n, 3) in G from points towards the camera."""
    towards = -p_R / np.linalg.norm(p_R, axis=1, keepdims=True)
    return np.asarray(towards @ X_RG[:3, :3])


def _search(
    model: _Map,
    features: StereoFeatures,
    direction_G: Array,
    X_RG: Array,
    rig: RectifiedRig,
    config: GuidedMatching,
    gate_px: float,
) -> tuple[Ints, Ints]:
    """Mutually best (feature, landmark) among those that agree in place, view and descriptor."""
    nothing = np.zeros(0, dtype=np.int64)
    if not model.landmark:
        return nothing, nothing
    observed = np.concatenate(model.landmark)
    p_R = transform_points(X_RG, model.p_G)
    ahead = p_R[:, 2] > 1e-3
    uvd = np.where(ahead[:, None], rig.project(np.where(ahead[:, None], p_R, 1.0)), -1e6)
    # The disparity's window is narrower than the image's: a landmark does not change its depth unseen.
    squeeze = np.array([1.0, 1.0, max(1.0, min(4.0, gate_px / 6.0))])
    near = cKDTree(uvd * squeeze).query_ball_point(features.uvd_px * squeeze, gate_px)
    feature, landmark = _flatten(near)
    if len(feature) == 0:
        return nothing, nothing
    distance = _descriptor_distance(model, observed, features, direction_G, feature, landmark, config)
    good = distance < config.max_distance
    return _mutual_best(feature[good], landmark[good], distance[good])


def _flatten(near: Sequence[Sequence[int]]) -> tuple[Ints, Ints]:
    """Neighbour lists -> pairs (feature, landmark)."""
    counts = np.array([len(n) for n in near])
    feature = np.repeat(np.arange(len(near)), counts)
    landmark = np.fromiter((x for n in near for x in n), dtype=np.int64, count=int(counts.sum()))
    return feature.astype(np.int64), landmark


def _descriptor_distance(
    model: _Map,
    observed: Ints,
    features: StereoFeatures,
    direction_G: Array,
    feature: Ints,
    landmark: Ints,
    config: GuidedMatching,
) -> Array:
    """Smallest descriptor distance of each pair over the landmark's observations from a like direction."""
    order = np.argsort(observed, kind="stable")
    start = np.searchsorted(observed[order], landmark, side="left")
    count = np.searchsorted(observed[order], landmark, side="right") - start
    pair = np.repeat(np.arange(len(feature)), count)
    within = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
    observation = order[np.repeat(start, count) + within]
    directions = np.concatenate(model.direction_G)[observation]
    cosine = np.sum(directions * direction_G[feature[pair]], axis=1)
    like = cosine > np.cos(np.deg2rad(config.max_view_angle_deg))
    pair, observation = pair[like], observation[like]
    similarity = np.einsum(
        "nd,nd->n", np.concatenate(model.descriptors)[observation], features.descriptors[feature[pair]]
    )
    distance = np.full(len(feature), np.inf)
    np.minimum.at(distance, pair, np.sqrt(np.maximum(2.0 - 2.0 * similarity, 0.0)))
    return distance


def _mutual_best(feature: Ints, landmark: Ints, distance: Array) -> tuple[Ints, Ints]:
    order = np.argsort(distance, kind="stable")
    feature, landmark = feature[order], landmark[order]
    first_f = np.zeros(len(order), dtype=bool)
    first_f[np.unique(feature, return_index=True)[1]] = True
    first_l = np.zeros(len(order), dtype=bool)
    first_l[np.unique(landmark, return_index=True)[1]] = True
    both = first_f & first_l
    return feature[both], landmark[both]


def _enter(
    model: _Map, features: StereoFeatures, labels: Ints, direction_G: Array, X_RG: Array, rig: RectifiedRig
) -> None:
    """Add one frame's observations: information-weighted positions, directions, descriptors."""
    X_GR = inverse_pose(X_RG)
    J = X_GR[:3, :3] @ rig.triangulation_jacobian(features.p_R)
    information = np.linalg.inv((J * features.sigma_px[:, None, :] ** 2) @ np.swapaxes(J, 1, 2))
    p_G = transform_points(X_GR, features.p_R)
    grown = int(labels.max()) + 1 - len(model.information)
    if grown > 0:
        model.information = np.concatenate([model.information, np.zeros((grown, 3, 3))])
        model.information_p_G = np.concatenate([model.information_p_G, np.zeros((grown, 3))])
    np.add.at(model.information, labels, information)
    np.add.at(model.information_p_G, labels, (information @ p_G[..., None])[..., 0])
    model.landmark.append(labels)
    model.direction_G.append(direction_G)
    model.descriptors.append(features.descriptors)
