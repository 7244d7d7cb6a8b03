"""LoFTR: Sun et al., "LoFTR: Detector-free local feature matching with transformers", 2021 (Kornia).

It matches places of two images, not features. The tracks need features that keep their name from frame to
frame, so a match of places counts for the nearest feature at each end, as dense matches are joined into
tracks elsewhere (Sarlin et al., "From coarse to fine", 2019, the toolbox that followed it).
"""

from copy import deepcopy
from typing import Any

import cv2
import numpy as np
import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg
from scipy.spatial import cKDTree

from polhode.config.frontend import Frontend
from polhode.frontend.features.keypoints import stretch
from polhode.frontend.features.methods import Matches
from polhode.frontend.features.stereo import Picture, StereoFeatures
from polhode.frontend.peers.weights import fill, load_weights
from polhode.lie import Array
from polhode.records import Ints

REACH_PX = 2.0
"""A feature this far from the place that LoFTR matched is not what it matched [px]."""
GRID_PX = 8
"""LoFTR's coarse cells."""


class LoftrMatcher:
    """LoFTR on the crops of the left images; it needs ``StereoFeatures.picture``."""

    def __init__(self, config: Frontend) -> None:
        self._min_confidence = config.pairs.min_confidence
        self._zoom, self._longest = config.features.upsample, config.features.max_crop_px
        published: dict[str, Any] = deepcopy(default_cfg)
        published["match_coarse"]["thr"] = config.pairs.min_confidence
        self._network = LoFTR(pretrained=None, config=published)
        fill(self._network, load_weights("loftr", config.weights), "loftr", config.weights)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches of places that have a feature at both ends."""
        if a.picture is None or b.picture is None or min(len(a), len(b)) == 0:
            return Matches(np.zeros((0, 2), np.int64), np.zeros(0))
        zooms = [self._zoom_of(picture) for picture in (a.picture, b.picture)]
        with torch.inference_mode():
            found = self._network(
                {"image0": _tensor(a.picture, zooms[0]), "image1": _tensor(b.picture, zooms[1])}
            )
        places = [
            _in_image(found[f"keypoints{side}"].numpy(), frame.picture, zoom)
            for side, (frame, zoom) in enumerate(zip((a, b), zooms, strict=True))
        ]
        return snap(places[0], places[1], found["confidence"].numpy(), a, b, self._min_confidence)

    def _zoom_of(self, picture: Picture) -> float:
        return float(np.clip(self._longest / max(picture.image.shape), 1.0, self._zoom))


def snap(
    uv_a_px: Array, uv_b_px: Array, confidence: Array, a: StereoFeatures, b: StereoFeatures, least: float
) -> Matches:
    """Matched places (m, 2) of frames a and b as matches of their features, surest first, one a feature."""
    ends = [_nearest(frame, uv) for frame, uv in ((a, uv_a_px), (b, uv_b_px))]
    usable = (ends[0] >= 0) & (ends[1] >= 0) & (confidence >= least)
    order = np.flatnonzero(usable)[np.argsort(-confidence[usable], kind="stable")]
    pairs = np.stack([ends[0][order], ends[1][order]], axis=1)
    first = np.zeros((len(pairs), 2), dtype=bool)
    for side in (0, 1):
        first[np.unique(pairs[:, side], return_index=True)[1], side] = True
    kept = first.all(axis=1)
    return Matches(pairs[kept], confidence[order][kept].astype(np.float64))


def _nearest(frame: StereoFeatures, uv_px: Array) -> Ints:
    """Index (m,) of the feature at each place (m, 2); -1 where there is none."""
    distance, index = cKDTree(frame.uvd_px[:, :2]).query(uv_px.reshape(-1, 2))
    return np.where(distance <= REACH_PX, index, -1).astype(np.int64)


def _tensor(picture: Picture, zoom: float) -> torch.Tensor:
    """The picture, stretched and enlarged, (1, 1, H, W) from 0 to 1 with black sky to whole cells."""
    bright = stretch(picture.image)
    height, width = (round(side * zoom) for side in bright.shape)
    enlarged = cv2.resize(bright, (width, height), interpolation=cv2.INTER_CUBIC)
    whole = [-(-side // GRID_PX) * GRID_PX for side in (height, width)]
    padded = np.zeros(whole, np.float32)
    padded[:height, :width] = np.asarray(enlarged) / np.float32(255.0)
    return torch.from_numpy(padded)[None, None]


def _in_image(uv: Array, picture: Picture | None, zoom: float) -> Array:
    """LoFTR's coordinates (m, 2), half a pixel ahead of ours, in the whole left image."""
    assert picture is not None
    return np.asarray(uv.astype(np.float64) / zoom - 0.5 + np.array(picture.corner_px))
