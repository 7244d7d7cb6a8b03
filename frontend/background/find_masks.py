"""The background of a sequence without masks, and the masks of its pairs.

Stereo, or ranges, find a background if a plane lies behind the target and stays where it is in N, or at
infinity, while the inspector moves as its poses say. A target that fills the image is no such plane: it
turns.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.frontend.background.background_image import (
    REACH_FRAMES,
    BackgroundImage,
    FirstLook,
    FirstLooks,
    background_images,
    frames_around,
)
from polhode.frontend.background.far_plane import (
    FarPlane,
    Image,
    border_matches,
    find_far_plane,
    plane_in_N,
    plane_seen_from,
    reduced_image,
    reduced_seen,
)
from polhode.frontend.background.near_layer import DARK_SKY_DN, near_layer, working_scale
from polhode.frontend.background.range_layer import near_range_layer, range_plane
from polhode.frontend.background.still_background import changed_layer, is_still, still_background
from polhode.frontend.found_masks import FoundMasks, MaskQuality, encoded
from polhode.frontend.rectification import Rectifier, frame_disparity
from polhode.frontend.segmentation import lit_border
from polhode.geometry.lie import Array
from polhode.records.dataset import StereoSequence
from polhode.runtime.processes import in_order

BLOCK = 128
"""Pairs that are examined before the masks of the first of them are finished; bounds the memory."""

MIN_AT_INFINITY = 0.15
"""Share of the matches along the border by which a pair shows a background at infinity, where no plane is
found"""
MIN_AGREEMENT, MAX_CONTRADICTED, MIN_FAR_SHARE = 0.8, 0.25, 0.5
MAX_AREA_RATIO = 1.6
"""Of the target's area to the median of the pairs around it,"""
AROUND = 3
"""so many before and after."""

Tick = Callable[[], None]
Masks = tuple[tuple[bytes, bytes], MaskQuality]


@dataclass(frozen=True)
class Background:
    """A plane m . p = 1 in N behind the target; m = 0: infinity."""

    m_N: Array
    """(3,) [1/m]"""
    still: tuple[BackgroundImage, BackgroundImage] | None = None
    """Its images, of cameras at rest, where no plane is found"""

    @property
    def at_infinity(self) -> bool:
        return not self.m_N.any()

    @property
    def description(self) -> str:
        """Where it is."""
        if self.still is not None:
            return "the same in all images"
        return (
            "at infinity"
            if self.at_infinity
            else f"in a plane {1.0 / float(np.linalg.norm(self.m_N)):.3g} m from the origin of N"
        )


def find_background(sequence: StereoSequence, rectifier: Rectifier) -> Background | None:
    """The background of a sequence; None: the sky is dark, masks are given, or no plane is found."""
    # pairs in which the background is looked for
    spread = np.unique(np.linspace(0, len(sequence) - 1, 8).round().astype(int)).tolist()
    frames = [k for k in spread if sequence.read_left(k)[1] is None]
    if not frames or sum(_is_bright(sequence, rectifier, k) for k in frames) < 0.5 * len(frames):
        return None
    planes, offset_px, at_infinity = dict[int, FarPlane](), rectifier.rig.disparity_offset_px, 0
    for k in frames:
        if sequence.has_ranges:
            plane = range_plane(frame_disparity(sequence, rectifier, k), offset_px)
        else:
            raw = sequence.read_pair(k)
            images = rectifier(raw.left, 0), rectifier(raw.right, 1)
            matches = border_matches(*images, offset_px, rectifier.seen)
            plane = find_far_plane(matches)
            at_infinity += matches.share_at_infinity >= MIN_AT_INFINITY
        if plane is not None:
            planes[k] = plane
    found = _common_background(sequence, rectifier, planes, len(frames))
    if found is None and at_infinity >= max(2.0, 0.5 * len(frames)):
        # a target that hides most of the border has planes of its own there, and they turn
        return Background(np.zeros(3))
    return _still(sequence, rectifier) if found is None else found


def _is_bright(sequence: StereoSequence, rectifier: Rectifier, k: int) -> bool:
    """Whether the border of a left image is not a dark sky: parts of it are brighter, or all of it is."""
    image, border = rectifier(sequence.read_left(k)[0], 0), rectifier.borders[0]
    # share of the border that is brighter than the sky
    return lit_border(image, border) > 0.1 or bool(np.median(image[border]) >= DARK_SKY_DN)


def _still(sequence: StereoSequence, rectifier: Rectifier) -> Background | None:
    """The background of cameras at rest, by what stays the same; None: they move, or nothing does."""
    # largest change of the camera's pose [rad, m] for a camera at rest
    if sequence.has_ranges or np.abs(sequence.X_NC - sequence.X_NC[0]).max() > 1e-6:
        return None
    # pairs, spread over the sequence, in which what stays the same is looked for
    scale, looks = working_scale(rectifier.rig.width_px), (list[Image](), list[Image]())
    for k in np.unique(np.linspace(0, len(sequence) - 1, 40).round().astype(int)).tolist():
        raw = sequence.read_pair(k)
        for side, image in enumerate((raw.left, raw.right)):
            looks[side].append(reduced_image(rectifier(image, side), scale))
    shown = [reduced_seen(each, scale) for each in rectifier.seen]
    left, right = (still_background(each, part) for each, part in zip(looks, shown, strict=True))
    if not (is_still(looks[0], left, shown[0]) and is_still(looks[1], right, shown[1])):
        return None
    return Background(np.zeros(3), (left, right))


def _common_background(
    sequence: StereoSequence, rectifier: Rectifier, planes: dict[int, FarPlane], examined: int
) -> Background | None:
    """The plane in N that most of the pairs show."""
    rig, size = rectifier.rig, (rectifier.rig.width_px, rectifier.rig.height_px)
    X_NR = sequence.X_NC @ rectifier.X_CR
    found = {k: plane_in_N(plane, rig, X_NR[k]) for k, plane in planes.items()}

    def same(m_N: Array, k: int) -> bool:
        off = plane_seen_from(m_N, rig, X_NR[k]).corners(*size) - planes[k].corners(*size)
        # largest difference of disparity, at a corner of the image, between planes that are the same
        return bool(np.abs(off).max() < 2.0)

    votes = Counter({k: sum(same(m_N, other) for other in planes) for k, m_N in found.items()})
    if not votes:
        return None
    best, count = votes.most_common(1)[0]
    if count < max(2.0, 0.5 * examined):  # of the examined pairs, those that show the plane
        return None
    return Background(np.mean([found[k] for k in planes if same(found[best], k)], axis=0))


def find_masks(
    sequence: StereoSequence,
    rectifier: Rectifier,
    background: Background,
    frames: Sequence[int],
    workers: int,
    tick: Tick,
) -> FoundMasks | None:
    """Masks of these pairs; None: nothing stands before the background. ``tick`` is called once per pair.

    First each pair is examined alone, then with the background that the pairs around it show. Ranges show the
    target at once.
    """
    found, pairs = list[Masks](), _Pairs(sequence, rectifier, background)
    if sequence.has_ranges or background.still is not None:
        for each in in_order(pairs.alone, frames, workers):
            found.append(each)
            tick()
    else:
        looks: dict[int, FirstLooks] = {}
        for start in range(0, len(frames), BLOCK):
            block = range(start, min(start + BLOCK, len(frames)))
            around = {n: frames_around(n, len(frames)) for n in block}
            missing = sorted({j for n in block for j in (n, *around[n])} - looks.keys())
            looked = in_order(pairs.first_looks, [frames[j] for j in missing], workers)
            looks |= dict(zip(missing, looked, strict=True))
            items = [(frames[n], looks[n], [(frames[j], looks[j]) for j in around[n]]) for n in block]
            for each in in_order(pairs.masks, items, workers):
                found.append(each)
                tick()
            looks = {j: look for j, look in looks.items() if j >= block.stop - 2 * REACH_FRAMES}
    # share of the image that the target covers in the median pair; less is no target
    if np.median([quality.area for _, quality in found]) < 5e-4:
        return None
    masks, quality = zip(*found, strict=True)
    return FoundMasks(dict(zip(frames, masks, strict=True)), dict(zip(frames, quality, strict=True)))


@dataclass(frozen=True)
class _Pairs:
    """What the workers need to find the masks of a pair by its number."""

    sequence: StereoSequence
    rectifier: Rectifier
    background: Background

    def images(self, k: int) -> tuple[Image, Image]:
        raw = self.sequence.read_pair(k)
        return self.rectifier(raw.left, 0), self.rectifier(raw.right, 1)

    def plane(self, k: int) -> FarPlane:
        X_NR = self.sequence.X_NC[k] @ self.rectifier.X_CR
        return plane_seen_from(self.background.m_N, self.rectifier.rig, X_NR)

    def alone(self, k: int) -> Masks:
        """By the ranges of the pair, or by what differs from the still background."""
        if self.background.still is None:
            layer = near_range_layer(frame_disparity(self.sequence, self.rectifier, k), self.plane(k))
        else:
            layer = changed_layer(*self.images(k), self.background.still, self.rectifier.seen)
        return (encoded(layer.left), encoded(layer.right)), layer.quality

    def first_looks(self, k: int) -> FirstLooks:
        images, shown = self.images(k), self.rectifier.seen
        layer, scale = (
            near_layer(*images, self.plane(k), seen=shown),
            working_scale(self.rectifier.rig.width_px),
        )
        left, right = (
            FirstLook(
                reduced_image(image, scale),
                (reduced_image(mask * np.uint8(255), scale) > 127) | ~reduced_seen(seen, scale),
            )
            for image, mask, seen in zip(images, (layer.left, layer.right), shown, strict=True)
        )
        return left, right

    def masks(self, item: tuple[int, FirstLooks, Sequence[tuple[int, FirstLooks]]]) -> Masks:
        """Of pair k, by its first looks and those of the pairs around it."""
        k, own, around = item
        X_NR, rig = self.sequence.X_NC @ self.rectifier.X_CR, self.rectifier.rig
        others, X_NS = [looks for _, looks in around], X_NR[[j for j, _ in around]]
        behind = background_images(own, others, self.background.m_N, rig, X_NR[k], X_NS)
        layer = near_layer(*self.images(k), self.plane(k), behind, self.rectifier.seen)
        return (encoded(layer.left), encoded(layer.right)), layer.quality


def doubtful_frames(found: FoundMasks) -> list[int]:
    """Pairs whose masks are doubtful: the images, the stereo matches or the neighbours disagree."""
    frames = sorted(found.quality)
    area = np.array([found.quality[k].area for k in frames])
    doubtful = []
    for n, k in enumerate(frames):
        quality = found.quality[k]
        around = float(np.median(area[max(n - AROUND, 0) : n + AROUND + 1]))
        steady = around / MAX_AREA_RATIO <= quality.area <= around * MAX_AREA_RATIO
        matched = quality.area == 0.0 or (
            quality.agreement >= MIN_AGREEMENT and quality.contradicted <= MAX_CONTRADICTED
        )
        if not (steady and matched and quality.far_share >= MIN_FAR_SHARE):
            doubtful.append(k)
    return doubtful
