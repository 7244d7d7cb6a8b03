"""Exposure, focus and noise of the sample, how alike both cameras are, and what is around the target."""

from collections.abc import Callable, Iterable

import numpy as np

from polhode.geometry.lie import Array
from polhode.pipeline.checkout.check_table import make_check
from polhode.pipeline.checkout.image_quality import ImageQuality
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.sample import Sample

STRETCHED_TO = 230.0
"""Grey level to which feature detection stretches the brightest parts"""
NOT_SEEN = "No examined image shows the target."


def exposure_checks(sample: Sample) -> list[CheckoutCheck]:
    """Saturation, darkness, focus, motion blur, noise, differences between cameras and between frames."""
    images = [image for pair in sample.pairs for image in pair.images]
    dark = [not image.target_share > 0.0 for image in images]
    words = f"{sum(dark)} of {len(dark)} examined images show nothing brighter than the sky."
    saturated = _known(images, lambda image: 100.0 * image.saturated)
    bright = _known(images, lambda image: image.bright_level)
    edges = _known(images, lambda image: image.edge_px)
    noise = _known(images, lambda image: image.noise)
    stretched = _known(images, lambda image: image.noise * STRETCHED_TO / max(image.bright_level, 8.0))
    checks = [
        make_check("unseen", 100.0 * float(np.mean(dark)), words),
        _median_check("saturated", saturated, "Up to {high:.1f} % in one image.", NOT_SEEN),
        _median_check(
            "brightness", bright, "99.5th percentile of 255 levels; from {low:.0f} to {high:.0f}.", NOT_SEEN
        ),
        _median_check(
            "edges",
            edges,
            "From {low:.2f} to {high:.2f} px; sharp images have 0.5 to 0.9 px.",
            "No examined image has enough clear edges.",
        ),
        _motion_blur(images),
        _median_check(
            "noise",
            stretched,
            f"{_median(noise) or 0.0:.2g} grey levels in the images as recorded; from {{low:.2g}} to "
            "{high:.2g} after stretching.",
            "The target has no flat part, or is not seen.",
        ),
    ]
    if all(pair.right is not None for pair in sample.pairs):
        checks.insert(4, _focus_of_cameras(sample))
        gains = [_log_gain(pair.level_left, pair.level_right) for pair in sample.pairs]
        known = [gain for gain in gains if gain is not None]
        gain = float(np.median(known)) if known else None
        finding = "There are too few stereo features to compare."
        if gain is not None:
            finding = f"The right image is {np.exp(gain):.3g} times as bright at the same points."
        checks.append(make_check("gain", None if gain is None else _percent(gain), finding))
    jumps = []
    for pair, link in zip(sample.successive, sample.links, strict=True):
        if link is not None:
            levels = (sample.pairs[k].level_left[link.features[:, n]] for n, k in enumerate(pair))
            if (gain := _log_gain(*levels)) is not None:
                jumps.append(float(np.exp(gain)))
    finding = "No two examined frames match."
    if jumps:
        finding = (
            f"The same points become {min(jumps):.2f} to {max(jumps):.2f} times as bright, with light that "
            "moves over the surface as well."
        )
    largest = max((_percent(float(np.log(gain))) for gain in jumps), default=None)
    return [*checks, make_check("jumps", largest, finding)]


def _known(images: Iterable[ImageQuality], of: Callable[[ImageQuality], float]) -> Array:
    """Values of the images that show it."""
    values = np.array([of(image) for image in images])
    return np.asarray(values[np.isfinite(values)])


def _median(values: Array) -> float | None:
    return float(np.median(values)) if len(values) else None


def _median_check(key: str, values: Array, finding: str, otherwise: str) -> CheckoutCheck:
    """Of the median of values (n,); the finding names the least and the largest."""
    if not len(values):
        return make_check(key, None, otherwise)
    return make_check(key, _median(values), finding.format(low=values.min(), high=values.max()))


def _focus_of_cameras(sample: Sample) -> CheckoutCheck:
    left, right = (
        _median(_known((pair.images[side] for pair in sample.pairs), lambda image: image.edge_px))
        for side in (0, 1)
    )
    if not left or not right:
        return make_check("edges of cameras", None, "Not both images have enough clear edges.")
    finding = f"{left:.2f} px in the left image, {right:.2f} px in the right one."
    return make_check("edges of cameras", max(left / right, right / left), finding)


def _motion_blur(images: list[ImageQuality]) -> CheckoutCheck:
    widths = np.array([image.edge_by_direction_px for image in images])
    widths = widths[np.isfinite(widths).sum(axis=1) >= 3]
    if not len(widths):
        finding = "No examined image has clear edges in three directions."
        return make_check("edges by direction", None, finding)
    worst = (45 * np.nanargmax(widths, axis=1)).tolist()
    ratio = float(np.median(np.nanmax(widths, axis=1) / np.nanmin(widths, axis=1)))
    widest = max(set(worst), key=worst.count)
    finding = f"Edges are most often widest along {widest} deg in the image (0: along the rows)."
    return make_check("edges by direction", ratio, finding)


def _log_gain(before: Array, after: Array) -> float | None:
    """Logarithm of the ratio of the grey levels (n,) of the same points; None: too few are bright enough."""
    clear = np.minimum(before, after) > 5.0
    return float(np.median(np.log(after[clear] / before[clear]))) if clear.sum() >= 10 else None


def _percent(log_ratio: float) -> float:
    """How much brighter the brighter one is [%]."""
    return 100.0 * float(np.expm1(abs(log_ratio)))


def background_checks(sample: Sample) -> list[CheckoutCheck]:
    """Masks, brightness at the border and around the target, and targets that are cut off."""
    images = [image for pair in sample.pairs for image in pair.images]
    masked = np.array([given for pair in sample.pairs for given in pair.has_masks])
    border = 100.0 * np.array([image.border_bright for image in images])
    around = 100.0 * _known(images, lambda image: image.around_bright)
    touching = np.array([image.touches_border for image in images])
    doubtful = sample.doubtful_masks
    finding = f"{int(masked.sum())} of {len(masked)} examined images have a mask."
    if not masked.any():
        taken = "is brighter than a dark sky" if doubtful is None else "stands before the background"
        finding += f" The target is taken to be what {taken}."
    checks = [make_check("masks", 100.0 * float(masked.mean()) if masked.any() else None, finding)]
    if inverted := [each for pair in sample.pairs for each in pair.inverted_masks]:
        finding = f"{sum(inverted)} of {len(inverted)} masks cover the border and leave out something inside."
        checks.append(make_check("inverted masks", 100.0 * float(np.mean(inverted)), finding))
    if doubtful is not None:
        finding = f"{doubtful[0]} of {doubtful[1]} {sample.noun}, before a background that is not dark."
        advice = f"Give masks of the target in masks0/{'' if sample.has_ranges else ' and masks1/'}."
        name, share = f"{sample.noun} with doubtful segmentation masks", doubtful[0] / max(doubtful[1], 1)
        checks.append(make_check("doubtful masks", 100.0 * share, finding, name=name, advice=advice))
    limits, of_border = None, ": a background that is not dark is taken for the target."
    if bool(masked.all()) or sample.surroundings or doubtful is not None:
        limits = (None, None)
        of_border = "; masks are given or found, or dim surroundings are left out of the target."
    beside = "The target fills the image."
    if len(around):
        beside = f"Up to {around.max():.2g} % of the pixels beside the target, in small spots such as stars."
    finding = f"From {border.min():.0f} to {border.max():.0f} %{of_border}"
    cut = f"{int(touching.sum())} of {len(touching)} examined images."
    return [
        *checks,
        make_check("border", float(np.median(border)), finding, limits=limits),
        make_check("surroundings", _median(around), beside, limits=limits),
        make_check("leaving", 100.0 * float(touching.mean()), cut),
    ]
