"""Images to stereo features and depth maps: every pair of the sequence, in parallel processes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from frontend.depth import compute_depth
from frontend.features import detect, no_key_points
from frontend.parallel import in_order
from frontend.rectify import Rectifier
from frontend.stereo import StereoFeatures, match_stereo
from frontend.target import Image, target_crop, target_mask
from polhode.config.frontend import Frontend
from polhode.dataset import StereoSequence
from polhode.records import Bools, DepthMap

Tick = Callable[[], None]


@dataclass(frozen=True)
class RectifiedPair:
    """One rectified stereo pair with the target's mask in each image."""

    left: Image
    right: Image
    mask_left: Bools
    mask_right: Bools


def rectified_pair(sequence: StereoSequence, rectifier: Rectifier, k: int) -> RectifiedPair:
    """Read, rectify and mask pair k."""
    raw = sequence.read_pair(k)
    images = [rectifier(image, side) for side, image in enumerate((raw.left, raw.right))]
    masks = []
    for side, given in enumerate((raw.mask_left, raw.mask_right)):
        moved = None
        if given is not None:
            moved = rectifier((given * np.uint8(255)).astype(np.uint8), side, cv2.INTER_NEAREST) > 127
        masks.append(target_mask(images[side], moved))
    return RectifiedPair(images[0], images[1], masks[0], masks[1])


def stereo_features(pair: RectifiedPair, rectifier: Rectifier, config: Frontend) -> StereoFeatures:
    """Stereo measurements of one rectified pair; none when the target is out of sight."""
    crops = (target_crop(pair.mask_left), target_crop(pair.mask_right))
    points = [
        detect(image, mask, crop, config.features) if crop is not None else no_key_points()
        for image, mask, crop in zip(
            (pair.left, pair.right), (pair.mask_left, pair.mask_right), crops, strict=True
        )
    ]
    return match_stereo(pair.left, pair.right, points[0], points[1], rectifier.rig, config.stereo)


@dataclass(frozen=True)
class _FeatureJob:
    sequence: StereoSequence
    rectifier: Rectifier
    config: Frontend

    def __call__(self, k: int) -> StereoFeatures:
        return stereo_features(rectified_pair(self.sequence, self.rectifier, k), self.rectifier, self.config)


@dataclass(frozen=True)
class _DepthJob:
    sequence: StereoSequence
    rectifier: Rectifier
    config: Frontend
    disparity_ranges_px: Sequence[tuple[float, float] | None]

    def __call__(self, k: int) -> DepthMap:
        pair = rectified_pair(self.sequence, self.rectifier, k)
        rig, span = self.rectifier.rig, self.disparity_ranges_px[k]
        return compute_depth(pair.left, pair.right, pair.mask_left, rig, self.config.depth, span)


def extract_features(
    sequence: StereoSequence, rectifier: Rectifier, config: Frontend, workers: int, tick: Tick
) -> list[StereoFeatures]:
    """Stereo features of every pair, in the order of the sequence. ``tick`` is called once per pair."""
    features: list[StereoFeatures] = []
    for found in in_order(_FeatureJob(sequence, rectifier, config), len(sequence), workers):
        features.append(found)
        tick()
    return features


def extract_depth(
    sequence: StereoSequence,
    rectifier: Rectifier,
    config: Frontend,
    disparity_ranges_px: Sequence[tuple[float, float] | None],
    workers: int,
) -> Iterator[DepthMap]:
    """Depth map of every pair, in order; disparity_ranges_px: per pair, what the sparse map predicts."""
    return in_order(_DepthJob(sequence, rectifier, config, disparity_ranges_px), len(sequence), workers)
