"""Association with a known motion: lost frames are looked for where the motion puts them.

Frames that blind matching has connected keep their matches: those passed a geometric check pair by pair, and
are truer than what a search around predictions adds, since shaded features drift with the light. A frame that
blind matching lost is searched in wide windows around its predicted pose and must pass a rigid fit of its own
before it counts as measured, so that a wrong prediction is not locked in.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from frontend.features import Descriptors
from frontend.pairs import PairMatch
from frontend.ransac import fit_rigid, ransac_rigid, reprojection_error_px
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
    """Landmarks and their observations while frames are added."""

    information: Array
    """(L, 3, 3)"""
    information_p_G: Array
    """(L, 3)"""
    landmark: list[Ints] = field(default_factory=list)
    """per frame (n,)"""
    direction_G: list[Array] = field(default_factory=list)
    """per frame (n, 3)"""
    descriptors: list[Descriptors] = field(default_factory=list)
    """per frame (n, 128)"""

    @classmethod
    def empty(cls, n_landmarks: int) -> "_Map":
        return cls(np.zeros((n_landmarks, 3, 3)), np.zeros((n_landmarks, 3)))

    @property
    def p_G(self) -> Array:
        # Landmarks of frames that are not connected have no place yet: far away they match nothing.
        placed = np.trace(self.information, axis1=1, axis2=2) > 0.0
        p_G = np.full(self.information_p_G.shape, np.inf)
        p_G[placed] = np.linalg.solve(self.information[placed], self.information_p_G[placed][..., None])[
            ..., 0
        ]
        return p_G


def consistent_matches(
    matches: Sequence[PairMatch],
    frames: Sequence[StereoFeatures],
    motion: InitialMotion,
    rig: RectifiedRig,
    gate_px: float,
) -> list[PairMatch]:
    """The matches between connected frames whose points the motion moves onto each other within the gate."""
    kept = []
    for match in matches:
        if not (motion.connected[match.i] and motion.connected[match.j]):
            continue
        X_RiRj = motion.X_RG[match.i] @ inverse_pose(motion.X_RG[match.j])
        p_Ri = transform_points(X_RiRj, frames[match.j].p_R[match.features[:, 1]])
        error = reprojection_error_px(p_Ri, frames[match.i].uvd_px[match.features[:, 0]], rig)
        good: Bools = error < gate_px
        if good.any():
            kept.append(replace(match, features=match.features[good]))
    return kept


def reconnect(
    frames: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    rig: RectifiedRig,
    config: GuidedMatching,
    seed: int,
) -> GuidedResult:
    """Look for the frames that are not connected, nearest to a connected one first.

    Landmarks are those of the association, placed by the motion; a found frame adds its observations to them.
    """
    X_RG, connected = motion.X_RG.copy(), motion.connected.copy()
    labels = [known.copy() for known in association.landmark]
    waiting = [k for k in np.flatnonzero(~connected).tolist() if len(frames[k]) >= config.min_inliers]
    if not waiting or not np.any(connected):
        return GuidedResult(association, motion)
    model = _Map.empty(association.n_landmarks)
    for k in np.flatnonzero(connected).tolist():
        _enter(model, frames[k], labels[k], X_RG[k], rig)
    for k in sorted(waiting, key=lambda frame: _distance_to(frame, motion.connected)):
        X_found = _relocalise(model, frames[k], X_RG[k], rig, config, np.random.default_rng([seed, k]))
        if X_found is None:
            continue
        X_RG[k], connected[k] = X_found, True
        feature, landmark = _search(model, frames[k], X_found, rig, config, config.fine_gate_px)
        labels[k] = np.full(len(frames[k]), -1, dtype=np.int64)
        labels[k][feature] = landmark
        _enter(model, frames[k], labels[k], X_found, rig)
    return GuidedResult(Association(tuple(labels)), InitialMotion(X_RG, connected))


def _distance_to(k: int, connected: Bools) -> int:
    known = np.flatnonzero(connected)
    return int(np.min(np.abs(known - k))) if len(known) else 0


def _relocalise(
    model: _Map,
    features: StereoFeatures,
    X_RG: Array,
    rig: RectifiedRig,
    config: GuidedMatching,
    rng: np.random.Generator,
) -> Array | None:
    """Measured pose of a frame near its predicted one, or None when too few landmarks agree."""
    feature, landmark = _search(model, features, X_RG, rig, config, config.coarse_gate_px)
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
    X_RG: Array,
    rig: RectifiedRig,
    config: GuidedMatching,
    gate_px: float,
) -> tuple[Ints, Ints]:
    """Mutually best (feature, landmark) among those that agree in place, view and descriptor."""
    nothing = np.zeros(0, dtype=np.int64)
    direction_G = _viewing_direction(features.p_R, X_RG)
    observed = np.concatenate(model.landmark)
    p_G = model.p_G
    placed = np.asarray(np.isfinite(p_G).all(axis=1), dtype=np.bool_)
    p_R = transform_points(X_RG, np.where(placed[:, None], p_G, 0.0))
    ahead: Bools = placed & np.asarray(p_R[:, 2] > 1e-3)
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


def _enter(model: _Map, features: StereoFeatures, labels: Ints, X_RG: Array, rig: RectifiedRig) -> None:
    """Add one frame's labelled observations: information-weighted positions, directions, descriptors."""
    used = labels >= 0
    p_R, landmark = features.p_R[used], labels[used]
    X_GR = inverse_pose(X_RG)
    J = X_GR[:3, :3] @ rig.triangulation_jacobian(p_R)
    information = np.linalg.inv((J * features.sigma_px[used, None, :] ** 2) @ np.swapaxes(J, 1, 2))
    p_G = transform_points(X_GR, p_R)
    np.add.at(model.information, landmark, information)
    np.add.at(model.information_p_G, landmark, (information @ p_G[..., None])[..., 0])
    model.landmark.append(landmark)
    model.direction_G.append(_viewing_direction(p_R, X_RG))
    model.descriptors.append(features.descriptors[used])
