"""The background of a camera at rest: what stays the same from image to image, plain or not, of any shape.

A plain wall or cloth has no texture by which stereo could find its plane. A pixel of it has, whenever the
target is elsewhere, one and the same value, while what it shows of the target varies: the background is the
value of most support, the mode of the pixel's history (Stauffer, Grimson, "Adaptive background mixture models
for real-time tracking", CVPR 1999, keep several).
"""

from collections.abc import Sequence

import cv2
import numpy as np

from polhode.frontend.background.background_image import BackgroundImage
from polhode.frontend.background.far_plane import Floats, Image, border_ring, reduced_image, reduced_seen
from polhode.frontend.background.near_layer import (
    CERTAIN,
    NearLayer,
    evidence_of_change,
    filled,
    guided,
    large_parts,
    outline,
    refined,
    working_scale,
)
from polhode.frontend.found_masks import MaskQuality
from polhode.geometry.lie import Bools

MIN_IMAGES = 12
SUPPORT, MIN_SUPPORT = 0.25, 6
"""Share and number of the images in which a pixel shows the background, at least: fewer agree by chance;"""
MAX_WIDTH_DN = 5.0
"""range within which its values then lie."""


def still_background(images: Sequence[Image], shown: Bools) -> BackgroundImage:
    """The background of images (h, w) of one camera at rest, where a quarter of them agree.

    Their exposures are levelled by the border. shown (h, w): what the camera shows.
    """
    border = np.array([float(image[border_ring(shown)].mean()) for image in images])
    gains = np.median(border) / np.maximum(border, 1.0)
    levelled = [image * np.float32(gain) for image, gain in zip(images, gains, strict=True)]
    values = np.sort(np.stack(levelled, axis=-1), axis=-1)
    count = values.shape[-1]
    support = max(MIN_SUPPORT, int(np.ceil(SUPPORT * count)))
    if count < MIN_IMAGES:
        nothing = np.zeros(values.shape[:2], dtype=np.float32)
        return BackgroundImage(nothing, nothing, np.zeros(values.shape[:2], dtype=bool))
    width = values[..., support - 1 :] - values[..., : count - support + 1]
    at = np.argmin(width, axis=-1)[..., None]
    narrowest = np.take_along_axis(width, at, axis=-1)[..., 0]
    image = np.take_along_axis(values, at, axis=-1)[..., 0] + 0.5 * narrowest
    known = narrowest <= MAX_WIDTH_DN
    # The range of so many values is two to three of their standard deviations.
    return BackgroundImage(image.astype(np.float32), (0.5 * narrowest).astype(np.float32), known)


def is_still(images: Sequence[Image], still: BackgroundImage, shown: Bools) -> bool:
    """Whether the border of images (h, w) stays the same, and what changes is a part of them."""
    ring = border_ring(shown)
    # share of the border that must stay the same: a target that fills the image does not
    if still.known[ring].mean() < 0.9:
        return False
    changed = [float((_evidence(image, still, shown) > 0.0)[shown].mean()) for image in images]
    # share of the image that may differ from the background, in the median image
    return float(np.median(changed)) <= 0.6


def changed_layer(
    left: Image,
    right: Image,
    still: tuple[BackgroundImage, BackgroundImage],
    seen: tuple[Bools, Bools],
) -> NearLayer:
    """What differs from the background in a rectified pair (H, W); seen (H, W): what each camera shows."""
    scale = working_scale(left.shape[1])
    targets, masks, unexplained, border = [], [], [], []
    for image, behind, part in zip((left, right), still, seen, strict=True):
        small, shown = reduced_image(image, scale), reduced_seen(part, scale)
        evidence = _evidence(small, behind, shown)
        target = large_parts(filled(outline(small, guided(small, evidence, 3, 1e-3)), evidence))
        targets.append(target)
        masks.append(refined(image, target, scale) & part)
        around = cv2.dilate(target.astype(np.uint8), np.ones((5, 5))) > 0
        unexplained.append(float((cv2.blur(evidence, (5, 5)) > CERTAIN)[~around].sum()))
        ring = border_ring(shown)
        border.append(float((evidence[ring] < 0.0).mean()))
    area = float(targets[0].mean())
    quality = MaskQuality(
        area=area,
        agreement=_common_rows(*targets),
        contradicted=max(unexplained) / float(targets[0].sum()) if area > 0.0 else float("nan"),
        far_share=min(border),
    )
    return NearLayer(masks[0], masks[1], quality)


def _evidence(image: Image, still: BackgroundImage, shown: Bools) -> Floats:
    """For the target (h, w), by the difference to the background at the image's exposure."""
    ring = border_ring(shown) & still.known
    own, other = float(image[ring].sum()), float(still.image[ring].sum())
    gain = np.float32(own / other) if own > 0.0 and other > 0.0 else np.float32(1.0)
    found = evidence_of_change(image, BackgroundImage(still.image * gain, still.spread, still.known))
    # evidence for the target where the background is never seen
    found = np.where(still.known, found, np.float32(1.0))
    return np.where(shown, found, np.float32(-CERTAIN - 1.0)).astype(np.float32)


def _common_rows(left: Bools, right: Bools) -> float:
    """Rows in which both cameras show the target, over those in which one does: rows are epipolar lines."""
    one, two = left.any(axis=1), right.any(axis=1)
    either = int((one | two).sum())
    return float((one & two).sum() / either) if either else float("nan")
