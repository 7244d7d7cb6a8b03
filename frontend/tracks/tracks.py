"""Tracks: matched features joined to landmarks over the whole sequence, at most one feature per frame.

The landmark map locates them by a known motion, with all their observations, for further association.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polhode.config.frontend_settings import GuidedMatching, Tracks
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points
from polhode.records.tracks import StereoTracks


@dataclass(frozen=True)
class Association:
    """The landmark that each feature of each frame observes; -1 for none."""

    landmark: tuple[Ints, ...]
    """per frame (n_k,)"""

    @property
    def n_landmarks(self) -> int:
        return max((int(labels.max(initial=-1)) for labels in self.landmark), default=-1) + 1


def join_matches(frames: Sequence[StereoFeatures], matches: Sequence[PairMatch]) -> Association:
    """Connected components of the match graph; of several features in one frame the one with most matches."""
    offset = np.concatenate([[0], np.cumsum([len(f) for f in frames])]).astype(np.int64)
    n = int(offset[-1])
    if not matches:
        return Association(tuple(np.full(len(f), -1, dtype=np.int64) for f in frames))
    a = np.concatenate([offset[m.i] + m.features[:, 0] for m in matches])
    b = np.concatenate([offset[m.j] + m.features[:, 1] for m in matches])
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    _, component = connected_components(graph, directed=False)
    links = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    frame_of = np.repeat(np.arange(len(frames)), np.diff(offset))
    # of one component in one frame, the feature with most matches
    order = np.lexsort((-links, frame_of, component))
    first = np.ones(len(order), dtype=bool)
    same = (component[order][1:] == component[order][:-1]) & (frame_of[order][1:] == frame_of[order][:-1])
    first[1:] = ~same
    used = np.zeros(n, dtype=bool)
    used[order] = first
    used &= links > 0
    label = np.full(n, -1, dtype=np.int64)
    label[used] = np.unique(component[used], return_inverse=True)[1].reshape(-1)
    return Association(tuple(label[offset[k] : offset[k + 1]] for k in range(len(frames))))


def to_tracks(
    frames: Sequence[StereoFeatures],
    association: Association,
    rig: RectifiedRig,
    timestamps_ns: Ints,
    X_NR: Array,
    config: Tracks,
    camera_sigma: tuple[float, float] = (0.0, 0.0),
) -> StereoTracks:
    """The measurements for the back end; camera_sigma: of the inspector's position [m] and attitude [rad]."""
    frame = np.concatenate([np.full(len(f), k, dtype=np.int64) for k, f in enumerate(frames)])
    label = np.concatenate(association.landmark)
    uvd = np.concatenate([f.uvd_px for f in frames])
    sigma = np.concatenate([f.sigma_px for f in frames])
    kept = _longest_tracks(label, frame, len(frames), config)
    used = (label >= 0) & np.isin(label, kept)
    _, landmark = np.unique(label[used], return_inverse=True)
    return StereoTracks(
        rig=rig,
        timestamps_ns=timestamps_ns,
        X_NR=X_NR,
        frame=frame[used],
        landmark=landmark.astype(np.int64).reshape(-1),
        uvd_px=uvd[used],
        sigma_px=sigma[used],
        sigma_camera_p_m=camera_sigma[0],
        sigma_camera_theta_rad=camera_sigma[1],
    )


def _longest_tracks(label: Ints, frame: Ints, n_frames: int, config: Tracks) -> Ints:
    """The longest tracks, as long as one of their frames has too few observations.

    Long tracks connect distant frames; many short tracks in a frame only cost time.
    """
    order = np.argsort(label, kind="stable")
    order = order[label[order] >= 0]
    landmarks, start = np.unique(label[order], return_index=True)
    members = np.split(frame[order], start[1:]) if len(landmarks) else []
    views = np.array([len(m) for m in members], dtype=np.int64)
    count = np.zeros(n_frames, dtype=np.int64)
    kept = []
    for index in np.argsort(-views, kind="stable").tolist():
        if views[index] < 3:  # number of frames in which a landmark must be seen
            break
        seen = members[index]
        if np.any(count[seen] < config.enough_per_frame):
            count[seen] += 1
            kept.append(landmarks[index])
    return np.array(kept, dtype=np.int64)


@dataclass
class LandmarkMap:
    """Landmarks and their observations; frames are added one after the other."""

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
    R_GS: list[Array] = field(default_factory=list)
    """per frame (n, 3, 3) axes of the surface; NaN where they are unknown"""

    @classmethod
    def empty(cls, n_landmarks: int) -> "LandmarkMap":
        return cls(np.zeros((n_landmarks, 3, 3)), np.zeros((n_landmarks, 3)))

    @property
    def p_G(self) -> Array:
        # Landmarks without observations in connected frames have no position: at infinity they match nothing.
        placed = np.trace(self.information, axis1=1, axis2=2) > 0.0
        p_G = np.full(self.information_p_G.shape, np.inf)
        p_G[placed] = np.linalg.solve(self.information[placed], self.information_p_G[placed][..., None])[
            ..., 0
        ]
        return p_G


def add_observations(
    model: LandmarkMap, features: StereoFeatures, labels: Ints, X_RG: Array, rig: RectifiedRig
) -> None:
    """Add the labelled observations of one frame: information-weighted positions, directions, descriptors."""
    used = labels >= 0
    p_R, landmark = features.p_R[used], labels[used]
    X_GR = inverse_pose(X_RG)
    J = X_GR[:3, :3] @ rig.triangulation_jacobian(p_R)
    information = np.linalg.inv((J * features.sigma_px[used, None, :] ** 2) @ np.swapaxes(J, 1, 2))
    p_G = transform_points(X_GR, p_R)
    np.add.at(model.information, landmark, information)
    np.add.at(model.information_p_G, landmark, (information @ p_G[..., None])[..., 0])
    unknown = np.full((len(features), 3, 3), np.nan)
    model.R_GS.append(X_GR[:3, :3] @ (unknown if features.R_RS is None else features.R_RS)[used])
    model.landmark.append(landmark)
    model.direction_G.append(viewing_direction(p_R, X_RG))
    model.descriptors.append(features.descriptors[used])


def viewing_direction(p_R: Array, X_RG: Array) -> Array:
    """Unit vectors (n, 3) in G from points towards the camera."""
    towards = -p_R / np.linalg.norm(p_R, axis=1, keepdims=True)
    return np.asarray(towards @ X_RG[:3, :3])


def descriptor_distance(
    model: LandmarkMap,
    observed: Ints,
    features: StereoFeatures,
    direction_G: Array,
    feature: Ints,
    landmark: Ints,
    config: GuidedMatching,
    X_RG: Array,
) -> Array:
    """Smallest descriptor distance of each (feature, landmark) over comparable observations of the landmark.

    Observations are comparable if their viewing directions are similar and, where known, the surface axes
    agree at the predicted pose.
    """
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
    if features.R_RS is not None:
        # The trace of R_a^T R_b gives the angle between the surface axes.
        R_GS = np.concatenate(model.R_GS)[observation]
        seen = X_RG[:3, :3].T @ features.R_RS[feature[pair]]
        trace = np.einsum("nij,nij->n", R_GS, seen)
        # The trace is NaN for features without surface axes.
        # largest rotation between the axes of the same surface [deg]: the axes have errors of 5 to 15
        # degrees, and the prediction may have similar ones
        same = ~(trace <= 1.0 + 2.0 * np.cos(np.deg2rad(50.0)))
        pair, observation = pair[same], observation[same]
    similarity = np.einsum(
        "nd,nd->n", np.concatenate(model.descriptors)[observation], features.descriptors[feature[pair]]
    )
    distance = np.full(len(feature), np.inf)
    np.minimum.at(distance, pair, np.sqrt(np.maximum(2.0 - 2.0 * similarity, 0.0)))
    return distance
