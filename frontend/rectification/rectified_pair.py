"""One stereo pair as every method of the front end sees it: rectified, with the target's masks."""

from dataclasses import dataclass

import cv2
import numpy as np

from polhode.dataset import StereoSequence
from polhode.frontend.rectification.rectify import Rectifier
from polhode.frontend.rectification.target import Image, target_mask
from polhode.records import Bools


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
    left, mask_left = _rectified(rectifier, 0, raw.left, raw.mask_left)
    right, mask_right = _rectified(rectifier, 1, raw.right, raw.mask_right)
    return RectifiedPair(left, right, mask_left, mask_right)


def rectified_left(sequence: StereoSequence, rectifier: Rectifier, k: int) -> tuple[Image, Bools]:
    """The left image of pair k and its mask alone."""
    return _rectified(rectifier, 0, *sequence.read_left(k))


def _rectified(rectifier: Rectifier, side: int, raw: Image, given: Bools | None) -> tuple[Image, Bools]:
    image, moved = rectifier(raw, side), None
    if given is not None:
        moved = rectifier((given * np.uint8(255)).astype(np.uint8), side, cv2.INTER_NEAREST) > 127
    return image, target_mask(image, moved)
