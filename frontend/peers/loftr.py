"""LoFTR: Sun et al., "LoFTR: Detector-free local feature matching with transformers", 2021 (Kornia).

LoFTR matches points of two images, not features. Tracks need features with an identity over all frames, so
each matched point is assigned to the nearest feature of its frame, as in the toolbox that followed Sarlin et
al., "From coarse to fine", 2019.
"""

from copy import deepcopy
from typing import Any

import numpy as np
import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg
from scipy.spatial import cKDTree

from polhode.config.frontend import Frontend
from polhode.frontend.features.keypoints import enlarge
from polhode.frontend.features.stereo import ImageCrop, StereoFeatures
from polhode.frontend.matching.methods import Matches, mutual_best
from polhode.frontend.peers.detectors import image_tensor
from polhode.frontend.peers.weights import fill, load_weights
from polhode.frontend.rectification.target import Crop
from polhode.lie import Array
from polhode.records import Ints

MAX_SNAP_PX = 2.0
"""Largest distance between a matched point and the feature that it is assigned to [px]."""
CELL_PX = 8
"""Side of LoFTR's coarse cells; the sides of its input are multiples of it."""


class LoftrMatcher:
    """``MatchMethod``: LoFTR on the crops of the left images; it needs ``StereoFeatures.picture``."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        settings: dict[str, Any] = deepcopy(default_cfg)
        settings["match_coarse"]["thr"] = config.pairs.min_confidence
        self._network = LoFTR(pretrained=None, config=settings)
        fill(self._network, load_weights("loftr", config.weights), "loftr", config.weights)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches of points that have a feature in both frames."""
        if a.picture is None or b.picture is None or min(len(a), len(b)) == 0:
            return Matches.none()
        with torch.inference_mode():
            found = self._network({"image0": self._input(a.picture), "image1": self._input(b.picture)})
        uv_a, uv_b = (
            self._in_image(found[f"keypoints{side}"].numpy(), picture)
            for side, picture in enumerate((a.picture, b.picture))
        )
        return snap(uv_a, uv_b, found["confidence"].numpy(), a, b, self._config.pairs.min_confidence)

    def _input(self, picture: ImageCrop) -> torch.Tensor:
        """The picture, stretched and enlarged, (1, 1, H, W) from 0 to 1."""
        height, width = picture.image.shape
        whole = Crop(0, 0, width, height)
        return image_tensor(enlarge(picture.image, whole, self._config.features).image, CELL_PX)

    def _in_image(self, uv: Array, picture: ImageCrop) -> Array:
        """Points (m, 2) of LoFTR, whose pixel centres are at halves, in the whole left image."""
        features = self._config.features
        zoom = float(np.clip(features.max_crop_px / max(picture.image.shape), 1.0, features.upsample))
        return np.asarray(uv.astype(np.float64) / zoom - 0.5 + np.array(picture.corner_px))


def snap(
    uv_a_px: Array, uv_b_px: Array, confidence: Array, a: StereoFeatures, b: StereoFeatures, threshold: float
) -> Matches:
    """Matched points (m, 2) of frames a and b as one-to-one matches of their features, most certain first."""
    pairs = np.stack([_nearest_feature(a, uv_a_px), _nearest_feature(b, uv_b_px)], axis=1)
    usable = (pairs >= 0).all(axis=1) & (confidence >= threshold)
    pairs, confidence = pairs[usable], confidence[usable]
    kept = mutual_best(pairs, -confidence)
    return Matches(pairs[kept], confidence[kept].astype(np.float64))


def _nearest_feature(frame: StereoFeatures, uv_px: Array) -> Ints:
    """Index (m,) of the feature at each point (m, 2); -1 where there is none."""
    distance, index = cKDTree(frame.uvd_px[:, :2]).query(uv_px.reshape(-1, 2))
    return np.where(distance <= MAX_SNAP_PX, index, -1).astype(np.int64)
