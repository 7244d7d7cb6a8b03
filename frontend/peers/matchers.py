"""Published matchers (by Kornia) as match methods: LightGlue and LoFTR.

LightGlue: Lindenberger, Sarlin and Pollefeys, "LightGlue: Local feature matching at light speed", 2023.
Kornia's class downloads its weights in the constructor if it is given the name of the features. Here it is
constructed from the configuration of those features instead, and the weights are loaded from a file.

LoFTR: Sun et al., "LoFTR: Detector-free local feature matching with transformers", 2021. It matches points of
two images, not features. Tracks need features with an identity over all frames, so each matched point is
assigned to the nearest feature of its frame, as in the toolbox that followed Sarlin et al., "From coarse to
fine", 2019.
"""

import re
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from kornia.feature import LightGlue, LoFTR
from kornia.feature.loftr.loftr import default_cfg
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.keypoints import enlarge
from polhode.frontend.features.stereo import ImageCrop, StereoFeatures
from polhode.frontend.matching.methods import Matches, mutual_best
from polhode.frontend.peers.detectors import image_tensor
from polhode.frontend.peers.weights import fill
from polhode.frontend.rectification import Crop
from polhode.geometry.lie import Array, Ints
from polhode.runtime.errors import InputError

FEATURES = {"rootsift": "sift", "disk": "disk", "aliked": "aliked", "xfeat": "xfeat"}
"""Name of a feature method -> Kornia's name of LightGlue's weights for it."""
MAX_SNAP_PX = 2.0
"""Largest distance between a matched point and the feature that it is assigned to [px]."""
CELL_PX = 8
"""Side of LoFTR's coarse cells; the sides of its input are multiples of it."""


class LightGlueMatcher:
    """``MatchMethod``: LightGlue with the weights that were trained for the feature method."""

    def __init__(self, config: Frontend) -> None:
        method = config.features.method
        if method not in FEATURES:
            raise InputError(
                f"frontend.pairs.method lightglue does not go with frontend.features.method {method}; "
                f"there are weights for {', '.join(FEATURES)}"
            )
        name = FEATURES[method]
        arguments = {key: value for key, value in LightGlue.features[name].items() if key != "weights"}
        arguments["filter_threshold"] = config.pairs.min_confidence
        # Without a name of features nothing is downloaded. Kornia documents None, but its type excludes it.
        self._network = LightGlue(features=None, **arguments)  # type: ignore[arg-type]
        fill(self._network, f"lightglue_{name}", config.weights, _kornia_name)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches with at least the configured confidence."""
        if min(len(a), len(b)) == 0:
            return Matches.none()
        spans = [np.ptp(frame.uvd_px[:, :2], axis=0) + 1.0 for frame in (a, b)]
        size = np.maximum(*spans)
        with torch.inference_mode():
            found = self._network({"image0": _side(a, size), "image1": _side(b, size)})
        index, confidence = found["matches"][0], found["scores"][0]
        return Matches(index.numpy().astype(np.int64), confidence.numpy().astype(np.float64))


def _side(frame: StereoFeatures, size_px: Array) -> dict[str, torch.Tensor]:
    """Input of LightGlue for one frame; positions are relative to the bounding box of the features."""
    uv = frame.uvd_px[:, :2]
    centred = uv - (uv.min(axis=0) + uv.max(axis=0)) / 2.0 + size_px / 2.0
    side = {
        "keypoints": torch.from_numpy(centred.astype(np.float32))[None],
        "descriptors": torch.from_numpy(frame.descriptors)[None],
        "image_size": torch.from_numpy(size_px.astype(np.float32))[None],
    }
    if frame.angle_rad is not None:
        side["scales"] = torch.from_numpy(frame.scale_px.astype(np.float32))[None]
        side["oris"] = torch.from_numpy(frame.angle_rad.astype(np.float32))[None]
    return side


def _kornia_name(name: str) -> str:
    """Published names of tensors -> Kornia's: ``self_attn.3.x`` becomes ``transformers.3.self_attn.x``."""
    return re.sub(r"^(self|cross)_attn\.(\d+)\.", r"transformers.\2.\1_attn.", name).removeprefix("matcher.")


class LoftrMatcher:
    """``MatchMethod``: LoFTR on the crops of the left images; it needs ``StereoFeatures.picture``."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        settings: dict[str, Any] = deepcopy(default_cfg)
        settings["match_coarse"]["thr"] = config.pairs.min_confidence
        self._network = LoFTR(pretrained=None, config=settings)
        fill(self._network, "loftr", config.weights)

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
