"""One stereo pair as every method of the front end sees it: rectified, with the target's masks."""

from dataclasses import dataclass

import cv2
import numpy as np

from frontend.rectify import Rectifier
from frontend.target import Image, target_mask
from polhode.dataset import StereoSequence
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
    images = [rectifier(image, side) for side, image in enumerate((raw.left, raw.right))]
    masks = []
    for side, given in enumerate((raw.mask_left, raw.mask_right)):
        moved = None
        if given is not None:
            moved = rectifier((given * np.uint8(255)).astype(np.uint8), side, cv2.INTER_NEAREST) > 127
        masks.append(target_mask(images[side], moved))
    return RectifiedPair(images[0], images[1], masks[0], masks[1])
