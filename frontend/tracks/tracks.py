"""Tracks: matched features joined to landmarks over the whole sequence, at most one feature per frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polhode.camera import RectifiedRig
from polhode.config.frontend import Tracks
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.lie import Array
from polhode.records import Ints, StereoTracks


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
    keep = _one_per_frame(component, frame_of, links)
    label = np.where(keep & (links > 0), component, -1)
    return _relabel(label, offset)


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
        if views[index] < config.min_views:
            break
        seen = members[index]
        if np.any(count[seen] < config.enough_per_frame):
            count[seen] += 1
            kept.append(landmarks[index])
    return np.array(kept, dtype=np.int64)


def _one_per_frame(component: Ints, frame_of: Ints, links: Ints) -> Ints:
    """True for the feature with most matches among those of one component in one frame."""
    order = np.lexsort((-links, frame_of, component))
    first = np.ones(len(order), dtype=bool)
    same = (component[order][1:] == component[order][:-1]) & (frame_of[order][1:] == frame_of[order][:-1])
    first[1:] = ~same
    keep = np.zeros(len(order), dtype=bool)
    keep[order] = first
    return keep


def _relabel(label: Ints, offset: Ints) -> Association:
    """Labels 0..L-1 without gaps, per frame."""
    used = label >= 0
    dense = np.full(len(label), -1, dtype=np.int64)
    dense[used] = np.unique(label[used], return_inverse=True)[1].reshape(-1)
    return Association(tuple(dense[offset[k] : offset[k + 1]] for k in range(len(offset) - 1)))
