"""Exposure, focus and noise of the sample, how alike both cameras are, and what is around the target."""

from collections.abc import Callable

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
    two = all(pair.right is not None for pair in sample.pairs)
    dark = [not image.target_share > 0.0 for image in images]
    saturated = _known(images, lambda image: 100.0 * image.saturated)
    bright = _known(images, lambda image: image.bright_level)
    edges = _known(images, lambda image: image.edge_px)
    noise = _known(images, lambda image: image.noise)
    stretched = _known(images, lambda image: image.noise * STRETCHED_TO / max(image.bright_level, 8.0))
    return [
        make_check(
            "unseen",
            100.0 * float(np.mean(dark)),
            f"{sum(dark)} of {len(dark)} examined images show nothing brighter than the sky.",
        ),
        make_check(
            "saturated",
            _median(saturated),
            f"Up to {saturated.max():.1f} % in one image." if len(saturated) else NOT_SEEN,
        ),
        make_check(
            "brightness",
            _median(bright),
            f"99.5th percentile of 255 levels; from {bright.min():.0f} to {bright.max():.0f}."
            if len(bright)
            else NOT_SEEN,
        ),
        make_check(
            "edges",
            _median(edges),
            f"From {edges.min():.2f} to {edges.max():.2f} px; sharp images have 0.5 to 0.9 px."
            if len(edges)
            else "No examined image has enough clear edges.",
        ),
        *([_focus_of_cameras(sample)] if two else []),
        _motion_blur(images),
        make_check(
            "noise",
            _median(stretched),
            f"{_median(noise):.2g} grey levels in the images as recorded; from {stretched.min():.2g} to "
            f"{stretched.max():.2g} after stretching."
            if len(noise)
            else "The target has no flat part, or is not seen.",
        ),
        *([_gain(sample)] if two else []),
        _jumps(sample),
    ]


def _known(images: list[ImageQuality], of: Callable[[ImageQuality], float]) -> Array:
    """Values of the images that show it."""
    values = np.array([of(image) for image in images])
    return np.asarray(values[np.isfinite(values)])


def _median(values: Array) -> float | None:
    return float(np.median(values)) if len(values) else None


def _focus_of_cameras(sample: Sample) -> CheckoutCheck:
    left, right = (
        _median(_known([pair.images[side] for pair in sample.pairs], lambda image: image.edge_px))
        for side in (0, 1)
    )
    return make_check(
        "edges of cameras",
        max(left / right, right / left) if left and right else None,
        f"{left:.2f} px in the left image, {right:.2f} px in the right one."
        if left is not None and right is not None
        else "Not both images have enough clear edges.",
    )


def _motion_blur(images: list[ImageQuality]) -> CheckoutCheck:
    widths = np.array([image.edge_by_direction_px for image in images])
    widths = widths[np.isfinite(widths).sum(axis=1) >= 3]
    if not len(widths):
        finding = "No examined image has clear edges in three directions."
        return make_check("edges by direction", None, finding)
    worst = (45 * np.nanargmax(widths, axis=1)).tolist()
    return make_check(
        "edges by direction",
        float(np.median(np.nanmax(widths, axis=1) / np.nanmin(widths, axis=1))),
        f"Edges are most often widest along {max(set(worst), key=worst.count)} deg in the image (0: along "
        "the rows).",
    )


def _log_gain(before: Array, after: Array) -> float | None:
    """Logarithm of the ratio of the grey levels (n,) of the same points; None: too few are bright enough."""
    clear = np.minimum(before, after) > 5.0
    return float(np.median(np.log(after[clear] / before[clear]))) if clear.sum() >= 10 else None


def _gain(sample: Sample) -> CheckoutCheck:
    gains = [_log_gain(pair.level_left, pair.level_right) for pair in sample.pairs]
    found = [gain for gain in gains if gain is not None]
    if not found:
        return make_check("gain", None, "There are too few stereo features to compare.")
    gain = float(np.median(found))
    finding = f"The right image is {np.exp(gain):.3g} times as bright at the same points."
    return make_check("gain", _percent(gain), finding)


def frame_gains(sample: Sample) -> list[float | None]:
    """(m,) ratio of brightness of the same points, later over earlier, of each successive pair."""
    out: list[float | None] = []
    for pair, link in zip(sample.successive, sample.links, strict=True):
        gain = None
        if link is not None:
            gain = _log_gain(*(sample.pairs[k].level_left[link.features[:, n]] for n, k in enumerate(pair)))
        out.append(None if gain is None else float(np.exp(gain)))
    return out


def _jumps(sample: Sample) -> CheckoutCheck:
    gains = [gain for gain in frame_gains(sample) if gain is not None]
    return make_check(
        "jumps",
        max((_percent(float(np.log(gain))) for gain in gains), default=None),
        f"The same points become {min(gains):.2f} to {max(gains):.2f} times as bright, with light that moves "
        "over the surface as well."
        if gains
        else "No two examined frames match.",
    )


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
    known_target = bool(masked.all()) or sample.surroundings or doubtful is not None
    finding = f"{int(masked.sum())} of {len(masked)} examined images have a mask."
    if not masked.any():
        taken = "is brighter than a dark sky" if doubtful is None else "stands before the background"
        finding += f" The target is taken to be what {taken}."
    checks = [make_check("masks", 100.0 * float(masked.mean()) if masked.any() else None, finding)]
    if doubtful is not None:
        checks.append(
            make_check(
                "doubtful masks",
                100.0 * doubtful[0] / max(doubtful[1], 1),
                f"{doubtful[0]} of {doubtful[1]} {sample.noun}, before a background that is not dark.",
                name=f"{sample.noun} with doubtful segmentation masks",
                advice=f"Give masks of the target in masks0/{'' if sample.has_ranges else ' and masks1/'}.",
            )
        )
    of_border = (
        "; masks are given or found, or dim surroundings are left out of the target."
        if known_target
        else ": a background that is not dark is taken for the target."
    )
    unlimited = (None, None) if known_target else None
    return [
        *checks,
        make_check(
            "border",
            float(np.median(border)),
            f"From {border.min():.0f} to {border.max():.0f} %{of_border}",
            limits=unlimited,
        ),
        make_check(
            "surroundings",
            _median(around),
            f"Up to {around.max():.2g} % of the pixels beside the target, in small spots such as stars."
            if len(around)
            else "The target fills the image.",
            limits=unlimited,
        ),
        make_check(
            "leaving",
            100.0 * float(touching.mean()),
            f"{int(touching.sum())} of {len(touching)} examined images.",
        ),
    ]
