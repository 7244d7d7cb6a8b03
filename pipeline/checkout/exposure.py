"""Exposure, focus and noise: what the images of the sample show, and how alike both cameras are."""

from collections.abc import Callable

import numpy as np

from polhode.lie import Array
from polhode.pipeline.checkout.image_quality import ImageQuality
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.pipeline.checkout.sample import Sample

MAX_SATURATED, FAIL_SATURATED = 10.0, 40.0
"""Share of the target's pixels [%]."""
MIN_BRIGHT, FAIL_BRIGHT = 60.0, 15.0
"""99.5th percentile of the target [grey levels of 8 bits]; below 8 features are not detected."""
MAX_EDGE_PX, FAIL_EDGE_PX = 1.2, 3.0
"""Sharp images have 0.6 to 0.8; a Gaussian of 1 px makes it 1.0 to 1.2, one of 2 px 1.7 to 1.9."""
MAX_CAMERA_RATIO = 1.3
"""Between the two cameras."""
MAX_DIRECTION_RATIO = 1.8
"""Between directions: a surface whose texture has a direction reaches 1.7."""
MAX_NOISE = 6.0
"""After the contrast is stretched as feature detection does it [grey levels]."""
STRETCHED_TO = 230.0
MAX_GAIN = 15.0
"""Difference of brightness between the cameras [%]."""
MAX_JUMP = 250.0
"""Change of brightness of the same points between successive frames [%]: under a single lamp or the Sun a
turn of 30 degrees alone makes up to 190."""
MIN_POINTS = 10
MAX_UNSEEN, FAIL_UNSEEN = 10.0, 60.0
"""Share of the images in which no target is seen [%]."""
DARK_LEVEL = 5.0
"""Mean of a patch below which its brightness is not compared."""


def exposure_checks(sample: Sample) -> list[CheckoutCheck]:
    """Saturation, darkness, focus, motion blur, noise, differences between cameras and between frames."""
    images = [image for pair in sample.pairs for image in pair.images]
    two = all(pair.right is not None for pair in sample.pairs)
    return [
        _unseen(images),
        _saturated(images),
        _dark(images),
        _edges(images),
        *([_cameras_focus(sample)] if two else []),
        _streaks(sample),
        _noise(images),
        *([_gain(sample)] if two else []),
        _jumps(sample),
    ]


def _median(images: list[ImageQuality], of: Callable[[ImageQuality], float]) -> tuple[float | None, Array]:
    """Median over the images that show it, and all their values."""
    values = np.array([of(image) for image in images])
    values = values[np.isfinite(values)]
    return (float(np.median(values)), values) if len(values) else (None, values)


NOT_SEEN = "No examined image shows the target."


def _unseen(images: list[ImageQuality]) -> CheckoutCheck:
    dark = [not image.target_share > 0.0 for image in images]
    return judged(
        "images",
        "images without a target",
        100.0 * float(np.mean(dark)),
        "%",
        MAX_UNSEEN,
        fail_limit=FAIL_UNSEEN,
        finding=f"{sum(dark)} of {len(dark)} examined images show nothing brighter than the sky.",
        advice="Expose longer, or leave such frames out; the motion is bridged over them by the dynamics "
        "alone.",
    )


def _saturated(images: list[ImageQuality]) -> CheckoutCheck:
    middle, values = _median(images, lambda image: 100.0 * image.saturated)
    return judged(
        "images",
        "saturated part of the target",
        middle,
        "%",
        MAX_SATURATED,
        fail_limit=FAIL_SATURATED,
        finding=f"Up to {values.max():.1f} % in one image." if len(values) else NOT_SEEN,
        not_possible="WARN",
        advice="Expose for a shorter time: saturated surface has no texture, and depth there is guessed.",
    )


def _dark(images: list[ImageQuality]) -> CheckoutCheck:
    middle, values = _median(images, lambda image: image.bright_level)
    return judged(
        "images",
        "brightest parts of the target",
        middle,
        "grey levels",
        MIN_BRIGHT,
        fail_limit=FAIL_BRIGHT,
        at_least=True,
        not_possible="FAIL",
        finding=f"99.5th percentile of 255 levels; from {values.min():.0f} to {values.max():.0f}."
        if len(values)
        else NOT_SEEN,
        advice="Expose longer or use more gain; for 16-bit images state 'bits' in sensor.yaml.",
    )


def _edges(images: list[ImageQuality]) -> CheckoutCheck:
    middle, values = _median(images, lambda image: image.edge_px)
    return judged(
        "images",
        "width of edges",
        middle,
        "px",
        MAX_EDGE_PX,
        fail_limit=FAIL_EDGE_PX,
        not_possible="WARN",
        finding=f"From {values.min():.2f} to {values.max():.2f} px; sharp images have 0.5 to 0.9 px."
        if len(values)
        else "No examined image has enough clear edges.",
        advice="Focus the lenses, and expose for a shorter time if it is worst along one direction.",
    )


def _cameras_focus(sample: Sample) -> CheckoutCheck:
    left, right = (
        _median([pair.images[side] for pair in sample.pairs], lambda image: image.edge_px)[0]
        for side in (0, 1)
    )
    known = left is not None and right is not None
    ratio = max(left / right, right / left) if left and right else None
    return judged(
        "images",
        "width of edges, one camera against the other",
        ratio,
        "",
        MAX_CAMERA_RATIO,
        finding=f"{left:.2f} px in the left image, {right:.2f} px in the right one."
        if known
        else "Not both images have enough clear edges.",
        advice="Focus the camera with the wider edges again, or clean its lens.",
    )


def _streaks(sample: Sample) -> CheckoutCheck:
    ratios, worst = [], []
    for pair in sample.pairs:
        for image in pair.images:
            width = np.array(image.edge_by_direction_px)
            if np.isfinite(width).sum() >= 3:
                ratios.append(float(np.nanmax(width) / np.nanmin(width)))
                worst.append(45 * int(np.nanargmax(width)))
    return judged(
        "images",
        "width of edges, widest against sharpest direction",
        float(np.median(ratios)) if ratios else None,
        "",
        MAX_DIRECTION_RATIO,
        finding=f"Edges are most often widest along {max(set(worst), key=worst.count)} deg in the image "
        "(0: along the rows)."
        if worst
        else "No examined image has clear edges in three directions.",
        advice="Expose for a shorter time: the target moves during the exposure, or a camera vibrates.",
    )


def _noise(images: list[ImageQuality]) -> CheckoutCheck:
    middle, values = _median(images, lambda image: image.noise * STRETCHED_TO / max(image.bright_level, 8.0))
    raw = _median(images, lambda image: image.noise)[0]
    return judged(
        "images",
        "noise after the contrast is stretched",
        middle,
        "grey levels",
        MAX_NOISE,
        not_possible="PASS",
        finding=f"{raw:.2g} grey levels in the images as recorded; from {values.min():.2g} to "
        f"{values.max():.2g} "
        "after stretching."
        if raw is not None
        else "The target has no flat part, or is not seen.",
        advice="Expose longer instead of using gain, or average: noise hides weak texture.",
    )


def _gain(sample: Sample) -> CheckoutCheck:
    found = []
    for pair in sample.pairs:
        clear = np.minimum(pair.level_left, pair.level_right) > DARK_LEVEL
        if clear.sum() >= MIN_POINTS:
            found.append(float(np.median(np.log(pair.level_right[clear] / pair.level_left[clear]))))
    gain = float(np.median(found)) if found else None
    return judged(
        "images",
        "brightness of the right image against the left",
        None if gain is None else _percent(gain),
        "%",
        MAX_GAIN,
        finding=f"The right image is {np.exp(gain):.3g} times as bright at the same points."
        if gain is not None
        else "There are too few stereo features to compare.",
        advice="Set both cameras to the same exposure and gain.",
    )


def frame_gains(sample: Sample) -> list[float | None]:
    """(m,) ratio of brightness of the same points, later over earlier, of each successive pair."""
    out: list[float | None] = []
    for (i, j), link in zip(sample.successive, sample.links, strict=True):
        ratio = None
        if link is not None:
            before, after = (sample.pairs[k].level_left[link.features[:, n]] for n, k in enumerate((i, j)))
            clear = np.minimum(before, after) > DARK_LEVEL
            if clear.sum() >= MIN_POINTS:
                ratio = float(np.exp(np.median(np.log(after[clear] / before[clear]))))
        out.append(ratio)
    return out


def _jumps(sample: Sample) -> CheckoutCheck:
    gains = [gain for gain in frame_gains(sample) if gain is not None]
    size = [_percent(float(np.log(gain))) for gain in gains]
    return judged(
        "images",
        "change of brightness between successive frames",
        max(size, default=None),
        "%",
        MAX_JUMP,
        finding=f"The same points become {min(gains):.2f} to {max(gains):.2f} times as bright, with light "
        "that "
        "moves over the surface as well."
        if gains
        else "No two examined frames match.",
        advice="Switch off automatic exposure and gain, or accept fewer matches across each jump.",
    )


def _percent(log_ratio: float) -> float:
    """How much brighter the brighter one is [%]."""
    return 100.0 * float(np.expm1(abs(log_ratio)))
