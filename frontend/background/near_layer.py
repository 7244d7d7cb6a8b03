"""Two layers in one pair: the background's plane, and what stands before it.

The right image is moved by the disparity of the background, so that the two images of the background
coincide. A pixel then belongs to the target if it differs from its background, and if it matches, at some
disparity of the target, a pixel of the other image that differs from its background too. The second condition
leaves out the part of the background that the other camera cannot see, because the target is in the way.

Where this is undecided, as on dark or plain surfaces, the outline is that of least contrast cost between what
is certain: GrabCut (Rother, Kolmogorov, Blake, "GrabCut", SIGGRAPH 2004), by OpenCV. It works on images of
about 320 columns; a guided filter (He, Sun, Tang, "Guided image filtering", PAMI 2013) brings the outline to
the edges of the whole image.
"""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.background.background_image import BackgroundImage
from polhode.frontend.background.far_plane import (
    REACH,
    FarPlane,
    Floats,
    Image,
    agreeing,
    border_ring,
    both_ways,
    matched_inside,
    reduced_image,
    reduced_seen,
    semi_global,
    textured,
)
from polhode.frontend.found_masks import MaskQuality
from polhode.frontend.segmentation import sky_level
from polhode.geometry.lie import Bools

Values = TypeVar("Values", bound=np.generic)

MAX_COST = 8.0
"""A pixel's cost under a layer, half its squared deviation in sigmas, is cut off here,"""
MAX_EVIDENCE = 5.5
"""and as evidence against the background here: less, so that a pixel that fits neither layer is background
which only one camera sees."""
TARGET_FIRST = 1.5
"""Cost in favour of the target where both layers fit: a hole in the target harms more than a wide outline."""
POSSIBLE = 6.0
"""A pixel's cost under the target is no more than this if it differs from the background, and so does the
point of the other image at the disparity around it."""
IMPOSSIBLE = 11.0
"""It is this if that point, and those so many pixels around it, show the background:"""
DEPTH_PX = 4
UNLIT = 2.0
"""Cost against it there where the image is as dark as its darkest tenth, in an image that shows dark sky."""
DARK_SKY_DN, NOT_DARK_PERCENT = 16.0, 5.0
"""Brightness below which a background is dark sky; the darkest of the border, as the target may reach it"""
SAME_COST = 2.0
"""Cost at which an image may differ from the background that other frames show, or not,"""
BY_TIME = (-4.0, 6.0)
"""and the evidence for the target that this gives, from the one to the other;"""
MAX_BY_STEREO = 2.0
"""stereo adds so much to it at most: the background that one camera alone sees may look like a match."""
CERTAIN = 3.0
"""Difference of costs from which on a pixel's layer is certain."""
CROP_PX = 16
ITERATIONS = 2
REFINED_PX, FLAT = 3, 1e-4
"""Radius of the final guided filter, and the variance of intensities (of 1) below which it averages."""


@dataclass(frozen=True)
class NearLayer:
    """The target in both images of a pair."""

    left: Bools
    """(H, W)"""
    right: Bools
    """(H, W)"""
    quality: MaskQuality


@dataclass(frozen=True)
class _Labels:
    """One image's layers at the working size."""

    target: Bools
    """(h, w)"""
    evidence: Floats
    """(h, w) cost of the background minus that of the target"""
    far: Floats
    """(h, w) cost of the background"""


def working_scale(width_px: int) -> int:
    """Pixels of an image for one in which layers are found."""
    return max(1, round(width_px / 320))  # width of the images in which layers are found


def near_layer(
    left: Image,
    right: Image,
    plane: FarPlane,
    behind: tuple[BackgroundImage, BackgroundImage] | None = None,
    seen: tuple[Bools, Bools] | None = None,
) -> NearLayer:
    """What stands before the background's plane in a rectified pair (H, W).

    behind: the background's images of both cameras at working size, where other frames show them; seen
    (H, W): what each camera shows; None: all.
    """
    scale = working_scale(left.shape[1])
    small, other = reduced_image(left, scale), reduced_image(right, scale)
    whole = np.ones(left.shape, dtype=bool)
    seen = seen or (whole, whole)
    shown, shown_right = (reduced_seen(each, scale) for each in seen)
    far, far_share, offset = _levelled(small, other, plane.reduced(scale), shown, shown_right)
    moved, inside = _moved(other, far)
    shown_moved = inside & (_moved(shown_right.astype(np.uint8), far)[0] > 0)
    inside &= shown & shown_moved
    # smallest disparity of the target beyond the background's, in those images
    there, back = both_ways(small, moved, 3, int(REACH * small.shape[1]))
    by_time = by_time_moved = None
    if behind is not None:
        by_time, in_right = (evidence_of_change(*each) for each in zip((small, other), behind, strict=True))
        v, u = np.mgrid[: far.shape[0], : far.shape[1]].astype(np.float32)
        by_time_moved = np.asarray(cv2.remap(in_right, u - far, v, cv2.INTER_LINEAR), np.float32)[:, ::-1]
    of_left = _labels(small, moved, there, back, shown, inside, by_time)
    of_moved = _labels(
        *(_flipped(moved), _flipped(small), _flipped(back), _flipped(there)),
        *(_flipped(shown_moved), _flipped(inside), by_time_moved),
    )
    right_target = of_moved.target[:, ::-1]
    quality = MaskQuality(
        area=float(of_left.target.mean()),
        agreement=_agreement(of_left.target, right_target, there),
        contradicted=_contradicted(of_left, right_target),
        far_share=far_share,
    )
    # the moved image's mask in the right image itself
    behind_it = FarPlane(plane.a, plane.b, plane.c + offset * scale).reduced(scale)
    v, u = np.mgrid[: small.shape[0], : small.shape[1]].astype(np.float32)
    columns = ((u + behind_it.b * v + behind_it.c) / (1.0 - behind_it.a)).astype(np.float32)
    target_right = cv2.remap(right_target.astype(np.uint8), columns, v, cv2.INTER_NEAREST) > 0
    left_target, target_right = refined(left, of_left.target, scale), refined(right, target_right, scale)
    return NearLayer(left_target & seen[0], target_right & seen[1], quality)


def _flipped(image: NDArray[Values]) -> NDArray[Values]:
    return np.ascontiguousarray(image[:, ::-1])


def _levelled(
    left: Image, right: Image, plane: FarPlane, shown: Bools, shown_right: Bools
) -> tuple[Floats, float, float]:
    """The background's disparity (h, w), corrected by a constant; share of the border that fits; it."""
    far = plane.at(left.shape[1], left.shape[0])
    moved, _ = _moved(right, far)
    found = semi_global(left, moved, -8, 16)
    seen = border_ring(shown) & textured(left) & matched_inside(far + found, shown, shown_right)
    if not seen.any():
        return far, 0.0, 0.0
    fits = seen & (np.abs(found) < 1.5)
    offset = float(np.median(found[fits])) if fits.sum() > 50 else 0.0
    return far + np.float32(offset), float(fits.sum() / seen.sum()), offset


def _moved(right: Image, far: Floats) -> tuple[Image, Bools]:
    """The right image with the background where the left one has it, and which pixels (h, w) it has."""
    v, u = np.mgrid[: far.shape[0], : far.shape[1]].astype(np.float32)
    columns = u - far
    moved = cv2.remap(right, columns, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.uint8), np.asarray((columns >= 0) & (columns <= far.shape[1] - 1))


def _labels(
    image: Image,
    other: Image,
    near: Floats,
    back: Floats,
    shown: Bools,
    inside: Bools,
    by_time: Floats | None,
) -> _Labels:
    """Layers of an image (h, w), of which the other one has the same background and is to the right.

    near: disparities of the target, were it everywhere; back: those of the other image; shown: what its
    camera sees; inside: what both do; by_time: what other frames say.
    """
    agrees = agreeing(near, back)
    evidence, far = _evidence(image, other, near, agrees, shown)
    if by_time is not None:
        evidence = np.where(by_time == 0.0, evidence, np.minimum(evidence, MAX_BY_STEREO) + by_time)
    far = np.where(inside, far, np.float32(0.0)).astype(np.float32)
    nothing = np.float32(-CERTAIN - 1.0)
    alone = np.where(agrees, np.float32(0.0), nothing)
    if by_time is not None:
        alone = np.where(by_time == 0.0, alone, by_time)
    evidence = np.where(shown, np.where(inside, evidence, alone), nothing).astype(np.float32)
    smooth = guided(image, evidence, 3, 1e-3)
    return _Labels(large_parts(filled(outline(image, smooth), evidence)), evidence, far)


def _evidence(image: Image, other: Image, near: Floats, agrees: Bools, shown: Bools) -> tuple[Floats, Floats]:
    """Cost of the background minus cost of the target, and cost of the background (h, w)."""
    height, width = image.shape
    v, u = np.mgrid[:height, :width].astype(np.float32)
    one, two = image.astype(np.float32), other.astype(np.float32)
    variance = _variance(one)
    far = _cost(one - two, np.maximum(variance, _variance(two)))
    known = np.isfinite(near)
    columns = u - np.nan_to_num(near)
    matched = cv2.remap(two, columns, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cost = np.where(known & (columns >= 0), _cost(one - matched, variance), MAX_COST)
    cost = np.where(agrees, cost, np.minimum(cost + 0.25 * MAX_COST, MAX_COST))

    def far_near(columns: Floats, reach_px: int) -> Floats:
        """Cost of the background (h, w) around a point of the other image."""
        largest = cv2.dilate(far, np.ones((3, 2 * reach_px + 1)))
        inside = np.clip(np.round(columns).astype(np.int64), 0, width - 1)
        return np.asarray(np.take_along_axis(largest, inside, axis=1))

    # The match must differ from its background, too.
    cost = np.maximum(cost, MAX_COST - far_near(columns, 1))
    # Where images of the target differ, as glossy and plain ones do, its neighbours tell where the match is.
    around = _spread(near, agrees & (cost < 0.25 * MAX_COST) & (far > CERTAIN))
    if around is not None:
        possible = (far > CERTAIN) & (far_near(u - around, 1) > CERTAIN)
        cost = np.where(possible, np.minimum(cost, POSSIBLE), cost)
        impossible = (cost >= MAX_COST) & (far_near(u - around, DEPTH_PX) < 0.5 * CERTAIN)
        cost = np.where(impossible, IMPOSSIBLE, cost)
    evidence = np.minimum(far, MAX_EVIDENCE) - cost + TARGET_FIRST
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.uint8)
    border = smooth[border_ring(shown)]
    if len(border) and np.percentile(border, NOT_DARK_PERCENT) >= DARK_SKY_DN:
        # no sky: what is dark is the target's shadow, though it fits the background, as dark in both images
        evidence = np.where(smooth < DARK_SKY_DN, np.maximum(evidence, 0.0), evidence)
    elif np.median(smooth[smooth <= np.percentile(smooth, 10)]) < DARK_SKY_DN:
        evidence = evidence - UNLIT * ((smooth < sky_level(smooth)) & (far < 1.0))
    return np.asarray(evidence, dtype=np.float32), far


def _spread(values: Floats, valid: Bools) -> Floats | None:
    """Those that are valid, and elsewhere the next one that is (h, w); None: none is."""
    if not valid.any():
        return None
    source = (~valid).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(source, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.zeros(int(labels.max()) + 1, dtype=np.float32)
    table[labels[valid]] = values[valid]
    return np.asarray(cv2.blur(table[labels], (9, 9)), dtype=np.float32)


def evidence_of_change(image: Image, behind: BackgroundImage) -> Floats:
    """Evidence (h, w) for the target, by what the image shows and the background would; 0: not known."""
    one = image.astype(np.float32)
    variance = np.maximum(_variance(one), _variance(behind.image)) + behind.spread**2
    evidence = np.clip(2.0 * (_cost(one - behind.image, variance) - SAME_COST), *BY_TIME)
    # A shadow on the target looks like the dark sky behind it.
    same = (one < DARK_SKY_DN) & (behind.image < DARK_SKY_DN) & (evidence < 0.0)
    return np.where(behind.known & ~same, evidence, 0.0).astype(np.float32)


def _variance(image: Floats) -> Floats:
    """Variance (h, w) of a pixel's difference to the same point in another image, by noise and position."""
    slope = np.abs(cv2.Scharr(image, cv2.CV_32F, 1, 0)) / 64.0
    steepest = cv2.dilate(slope, np.ones((3, 3)))
    # standard deviation of a pixel's difference between the images, without gradient [DN]
    # error of the position at which images are compared
    return np.asarray(1.5**2 + (0.5 * steepest) ** 2 + 0.002 * image, dtype=np.float32)


def _cost(difference: Floats, variance: Floats) -> Floats:
    squared = np.minimum(difference**2 / variance, 4.0 * MAX_COST).astype(np.float32)
    return np.asarray(np.minimum(cv2.blur(squared, (3, 3)) / 2.0, MAX_COST), dtype=np.float32)


def outline(image: Image, evidence: Floats) -> Bools:
    """The target (h, w) by GrabCut, from what is certain."""
    target = np.zeros(image.shape, dtype=bool)
    certain = evidence > CERTAIN
    if not certain.any():
        return target
    rows, columns = np.flatnonzero(certain.any(axis=1)), np.flatnonzero(certain.any(axis=0))
    box = (
        slice(max(int(rows[0]) - CROP_PX, 0), int(rows[-1]) + 1 + CROP_PX),
        slice(max(int(columns[0]) - CROP_PX, 0), int(columns[-1]) + 1 + CROP_PX),
    )
    part = evidence[box]
    labels = np.where(part > 0.0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[part > CERTAIN], labels[part < -CERTAIN] = cv2.GC_FGD, cv2.GC_BGD
    if not (part <= 0.0).any():
        target[box] = True
        return target
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 2.0))
    # grey levels for a unit of cost: GrabCut works on three channels, image, smoothed image and evidence
    third = np.clip(128.0 + 25.0 * part, 0.0, 255.0).astype(np.uint8)
    channels = cv2.merge([image[box], smooth[box], third])
    # GrabCut starts from random clusters.
    cv2.setRNGSeed(1)
    behind, before, no_box = np.zeros((1, 65)), np.zeros((1, 65)), (0, 0, 0, 0)
    cv2.grabCut(
        np.ascontiguousarray(channels), labels, no_box, behind, before, ITERATIONS, cv2.GC_INIT_WITH_MASK
    )
    target[box] = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return target


def filled(target: Bools, evidence: Floats) -> Bools:
    """Without holes (h, w) through which the background is not clearly seen."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~target).astype(np.uint8), connectivity=4)
    height, width = target.shape
    filled = target.copy()
    for label in range(1, count):
        u, v, w, h, _area = np.asarray(stats)[label]
        if u > 0 and v > 0 and u + w < width and v + h < height:
            hole = labels == label
            filled |= hole & bool(evidence[hole].mean() > -CERTAIN)
    return filled


def large_parts(target: Bools) -> Bools:
    """The large connected parts (h, w)."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(target.astype(np.uint8), connectivity=8)
    if count <= 1:
        return target
    area = np.asarray(stats)[1:, cv2.CC_STAT_AREA].astype(np.int64)
    # of the largest part of the target; smaller ones are dropped
    return np.isin(labels, 1 + np.flatnonzero(area >= max(25, 0.02 * area.max())))


def refined(image: Image, target: Bools, scale: int) -> Bools:
    """A mask of the working size at the full size (H, W), with the outline at the edges of the image."""
    height, width = image.shape
    wide = np.repeat(np.repeat(target.astype(np.float32), scale, axis=0), scale, axis=1)
    after = height - wide.shape[0], width - wide.shape[1]
    wide = np.asarray(cv2.copyMakeBorder(wide, 0, after[0], 0, after[1], cv2.BORDER_REPLICATE))
    if scale > 1:
        wide = np.asarray(cv2.blur(wide, (scale + 1 - scale % 2, scale + 1 - scale % 2)))
    return guided(image, wide, REFINED_PX, FLAT) >= 0.5


def guided(image: Image, values: Floats, radius: int, flat: float) -> Floats:
    """Values (h, w) averaged within a radius along the edges of an image (guided filter)."""
    guide, size = image.astype(np.float32) / np.float32(255.0), (2 * radius + 1, 2 * radius + 1)

    def mean(of: Floats) -> Floats:
        return np.asarray(cv2.blur(of, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    m, v = mean(guide), mean(values)
    variance = mean(guide * guide) - m * m
    slope = ((mean(guide * values) - m * v) / (variance + np.float32(flat))).astype(np.float32)
    return np.asarray(mean(slope) * guide + mean(v - slope * m), dtype=np.float32)


def _agreement(left: Bools, right: Bools, near: Floats) -> float:
    """Share of the left target's pixels (h, w), of those with a match, that match the right target."""
    columns = np.arange(left.shape[1]) - np.round(np.nan_to_num(near)).astype(np.int64)
    asked = left & np.isfinite(near) & (columns >= 0)
    if not asked.any():
        return float("nan")
    wide = cv2.dilate(right.astype(np.uint8), np.ones((1, 5))) > 0
    found = np.take_along_axis(wide, np.clip(columns, 0, left.shape[1] - 1), axis=1)
    return float(found[asked].mean())


def _contradicted(labels: _Labels, moved: Bools) -> float:
    """Area that neither target nor background explains, over that of the target.

    What differs from the background is the target in the left image or in the moved right one (h, w).
    """
    if not labels.target.any():
        return float("nan")
    differs = cv2.blur(labels.far, (5, 5)) > CERTAIN
    either = cv2.dilate((labels.target | moved).astype(np.uint8), np.ones((5, 5))) > 0
    clear = labels.target & (cv2.blur(labels.evidence, (5, 5)) < -CERTAIN)
    return float(((differs & ~either) | clear).sum() / labels.target.sum())
