"""The landmark map for association: landmarks located by a known motion, with all their observations."""

from dataclasses import dataclass, field

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.frontend import GuidedMatching
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.stereo import StereoFeatures
from polhode.lie import Array, inverse_pose, transform_points
from polhode.records import Ints

AXES_DEG = 50.0
"""Largest rotation between the axes of the same surface [deg]: the axes have errors of 5 to 15 degrees, and
the prediction may have similar ones."""


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
        same = ~(trace <= 1.0 + 2.0 * np.cos(np.deg2rad(AXES_DEG)))
        pair, observation = pair[same], observation[same]
    similarity = np.einsum(
        "nd,nd->n", np.concatenate(model.descriptors)[observation], features.descriptors[feature[pair]]
    )
    distance = np.full(len(feature), np.inf)
    np.minimum.at(distance, pair, np.sqrt(np.maximum(2.0 - 2.0 * similarity, 0.0)))
    return distance
