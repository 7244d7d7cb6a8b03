"""Masks of the target that were found in the images of a sequence.

They are compressed, a kilobyte or two each, so that those of a long sequence fit in memory and can be sent to
other processes.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Bools, Ints


@dataclass(frozen=True)
class MaskQuality:
    """How far the masks of one pair can be trusted."""

    area: float
    """Share of the left image"""
    agreement: float
    """Of the target's pixels in the left image, the share that match it in the right one; nan: none"""
    contradicted: float
    """Area that neither background nor target explains, over that of the target; nan: none"""
    far_share: float
    """Of the border's matched pixels, the share that lies in the background's plane"""


@dataclass(frozen=True)
class FoundMasks:
    """Masks in the rectified images of some pairs of a sequence."""

    encoded: Mapping[int, tuple[bytes, bytes]]
    """Index of the pair -> left and right mask, as PNG"""
    quality: Mapping[int, MaskQuality]

    def part(self, frames: Ints) -> "FoundMasks":
        """The masks of some of the pairs (n,), which are numbered from 0."""
        old = list(enumerate(frames.tolist()))
        return FoundMasks(
            {n: self.encoded[k] for n, k in old if k in self.encoded},
            {n: self.quality[k] for n, k in old if k in self.quality},
        )

    def masks(self, k: int) -> tuple[Bools, Bools] | None:
        """Left and right mask (H, W) of pair k; None: it was not examined."""
        found = self.encoded.get(k)
        return None if found is None else (decoded(found[0]), decoded(found[1]))

    def mask(self, k: int, side: int) -> Bools | None:
        """Mask (H, W) of pair k; side 0 left, 1 right."""
        found = self.encoded.get(k)
        return None if found is None else decoded(found[side])


def encoded(mask: Bools) -> bytes:
    """A mask (H, W) as the bytes of a PNG of one bit per pixel."""
    flags = [cv2.IMWRITE_PNG_BILEVEL, 1]
    return cv2.imencode(".png", mask.astype(np.uint8) * np.uint8(255), flags)[1].tobytes()


def decoded(content: bytes) -> Bools:
    """The mask (H, W) of such bytes."""
    raw: NDArray[np.uint8] = np.frombuffer(content, dtype=np.uint8)
    return np.asarray(cv2.imdecode(raw, cv2.IMREAD_GRAYSCALE)) > 0
