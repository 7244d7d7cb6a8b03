"""Guided matching: frames that matching without prior motion did not connect are matched at their predicted
poses.

Connected frames keep their matches: each pair passed a geometric check, and they are more accurate than
matches from a search around predictions, since features on shaded surfaces drift with the light. An
unconnected frame is searched in wide windows around its predicted pose. It must pass a rigid fit of its own
before it counts as measured, so that a wrong prediction cannot confirm itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import GuidedMatching
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.matchers import DUSTBIN, TEMPERATURE
from polhode.frontend.matching.methods import mutual_best
from polhode.frontend.matching.pairs import PairMatch
from polhode.frontend.matching.ransac import fit_noisy, ransac_rigid, reprojection_error_px
from polhode.frontend.tracks.tracks import (
    Association,
    LandmarkMap,
    add_observations,
    descriptor_distance,
    viewing_direction,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.records.estimate import InitialMotion

MIN_INLIERS = 7
"""A frame with fewer consistent associations is not connected."""
GATE_FACTORS = (1.0, 1.0 / 3.0, 1.0 / 5.0)
"""Search radii in successive rounds, as the pose improves, relative to the first one."""


@dataclass(frozen=True)
class GuidedResult:
    """The new association and the poses that it is based on."""

    association: Association
    motion: InitialMotion


def consistent_matches(
    matches: Sequence[PairMatch],
    frames: Sequence[StereoFeatures],
    motion: InitialMotion,
    rig: RectifiedRig,
    gate_px: float,
) -> list[PairMatch]:
    """The matches between connected frames that agree with the motion within the gate."""
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
    """Match the unconnected frames to the landmarks, those nearest in time to a connected frame first.

    Landmarks are those of the association, located by the motion; a found frame adds its observations to
    them.
    """
    X_RG, connected = motion.X_RG.copy(), motion.connected.copy()
    labels = [known.copy() for known in association.landmark]
    waiting = [k for k in np.flatnonzero(~connected).tolist() if len(frames[k]) >= MIN_INLIERS]
    if not waiting or not np.any(connected):
        return GuidedResult(association, motion)
    model = LandmarkMap.empty(association.n_landmarks)
    known = np.flatnonzero(connected)
    for k in known.tolist():
        add_observations(model, frames[k], labels[k], X_RG[k], rig)
    for k in sorted(waiting, key=lambda frame: int(np.min(np.abs(known - frame)))):
        X_found, rng = X_RG[k], np.random.default_rng([seed, k])
        for share in GATE_FACTORS:
            # In a smaller window fewer other landmarks look similar, so more associations are unambiguous.
            # search radius around a predicted pose
            feature, landmark = _search(model, frames[k], X_found, rig, config, share * 25.0)
            if len(feature) < MIN_INLIERS:
                break
            p_R, p_G = frames[k].p_R[feature], model.p_G[landmark]
            fit = ransac_rigid(frames[k].uvd_px[feature], p_R, p_G, rig, rng)
            if fit.inlier.sum() < MIN_INLIERS:
                break
            X_found = fit_noisy(fit.X_RiRj, p_R, p_G, rig)
        else:
            X_RG[k], connected[k] = X_found, True
        if not connected[k]:
            continue
        # search radius around a pose that the frame's own features confirm
        feature, landmark = _search(model, frames[k], X_found, rig, config, 2.0)
        labels[k] = np.full(len(frames[k]), -1, dtype=np.int64)
        labels[k][feature] = landmark
        add_observations(model, frames[k], labels[k], X_found, rig)
    return GuidedResult(Association(tuple(labels)), InitialMotion(X_RG, connected))


def _search(
    model: LandmarkMap,
    features: StereoFeatures,
    X_RG: Array,
    rig: RectifiedRig,
    config: GuidedMatching,
    gate_px: float,
) -> tuple[Ints, Ints]:
    """Mutually best (feature, landmark) among those that agree in position, view and descriptor."""
    nothing = np.zeros(0, dtype=np.int64)
    direction_G = viewing_direction(features.p_R, X_RG)
    observed = np.concatenate(model.landmark)
    p_G = model.p_G
    placed = np.asarray(np.isfinite(p_G).all(axis=1), dtype=np.bool_)
    p_R = transform_points(X_RG, np.where(placed[:, None], p_G, 0.0))
    ahead: Bools = placed & np.asarray(p_R[:, 2] > 1e-3)
    uvd = np.where(ahead[:, None], rig.project(np.where(ahead[:, None], p_R, 1.0)), -1e6)
    # The window is narrower in disparity than in the image, since the depth is predicted better.
    squeeze = np.array([1.0, 1.0, max(1.0, min(4.0, gate_px / 6.0))])
    near = cKDTree(uvd * squeeze).query_ball_point(features.uvd_px * squeeze, gate_px)
    feature = np.repeat(np.arange(len(near), dtype=np.int64), [len(each) for each in near])
    landmark = np.fromiter((x for each in near for x in each), dtype=np.int64, count=len(feature))
    if len(feature) == 0:
        return nothing, nothing
    distance = descriptor_distance(model, observed, features, direction_G, feature, landmark, config, X_RG)
    largest = np.full(len(feature), config.max_distance)
    surface = features.on_surface[feature]
    if surface.any():
        distance[surface] = match_improbability(distance[surface], feature[surface], landmark[surface])
        # smallest probability of an accepted association of features with known surface axes
        largest[surface] = 1.0 - 0.01
    good = distance < largest
    pairs = np.stack([feature[good], landmark[good]], axis=1)
    feature, landmark = pairs[mutual_best(pairs, distance[good])].T
    return feature, landmark


def match_improbability(distance: Array, feature: Ints, landmark: Ints) -> Array:
    """One minus the probability (n,) that feature and landmark match, by a dual softmax over these pairs
    only.

    distance (n,): distance of their descriptors of unit length.
    """
    similarity = np.exp(-0.5 * distance**2 / TEMPERATURE)
    none = np.exp((DUSTBIN - 1.0) / TEMPERATURE)
    along_feature = np.bincount(feature, similarity) + none
    along_landmark = np.bincount(landmark, similarity) + none
    return np.asarray(1.0 - similarity**2 / (along_feature[feature] * along_landmark[landmark]))
