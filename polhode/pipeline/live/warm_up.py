"""Compile what a pair needs before the first one comes: later ones would be dropped meanwhile."""

import cv2
import numpy as np

from polhode.backend.window import warm_up
from polhode.config import Config
from polhode.frontend.extract import extract_pair
from polhode.frontend.matching.pairs import PairMatch, match_pair
from polhode.frontend.rectification import RectifiedPair
from polhode.geometry.camera import RectifiedRig

STEP_PX = 2
"""That the square moves from the first pair to the second"""


def warm_up_stream(rig: RectifiedRig, config: Config) -> PairMatch | None:
    """Take two made-up pairs through extraction and matching, and a made-up body through a window.

    What is compiled stays for all streams. Returns the match of the two pairs.
    """
    warm_up(rig, config.backend)
    pairs = (_made_up_pair(rig, right_px) for right_px in (0, STEP_PX))
    features = [extract_pair(pair, rig, config.frontend) for pair in pairs]
    return match_pair(features, 0, 1, rig, config.frontend, config.seed)


def _made_up_pair(rig: RectifiedRig, right_px: int) -> RectifiedPair:
    """A square with texture that faces the cameras before a black sky, moved to the right.

    All its points have a disparity of 30 px beyond that of infinity.
    """
    size = rig.height_px, rig.width_px
    side = min(160, rig.height_px // 2, rig.width_px // 2)
    noise = np.random.default_rng(0).standard_normal((side, side))
    texture = cv2.GaussianBlur(noise, (0, 0), 2.0) + cv2.GaussianBlur(noise, (0, 0), 5.0)
    grey = np.clip(128.0 + 40.0 * texture / texture.std(), 20.0, 235.0).astype(np.uint8)
    left, mask = np.zeros(size, dtype=np.uint8), np.zeros(size, dtype=np.bool_)
    v, u = (size[0] - side) // 2, (size[1] - side) // 2
    place = slice(v, v + side), slice(u, u + side)
    left[place], mask[place] = grey, True
    to_right_px = right_px - 30 - round(rig.disparity_offset_px)
    return RectifiedPair(
        left=np.roll(left, right_px, axis=1),
        right=np.roll(left, to_right_px, axis=1),
        mask_left=np.roll(mask, right_px, axis=1),
        mask_right=np.roll(mask, to_right_px, axis=1),
    )
