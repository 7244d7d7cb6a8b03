"""Range images instead of a second camera: how much of the target they measure, and how noisy they are."""

from dataclasses import dataclass

import cv2
import numpy as np

from polhode.frontend.rectification import MeasuredDisparity
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.records import Bools

MAX_MISSING, FAIL_MISSING = 30.0, 90.0
"""Share of the target's pixels without a measurement [%]."""
MAX_NOISE_RATIO = 1.5
"""Scatter of the ranges about planes, over the standard deviation that is stated."""
MIN_WINDOWS = 50
"""Of nine measured pixels each, for the scatter to be stated."""


@dataclass(frozen=True)
class RangeQuality:
    """Of one frame."""

    missing: float
    """Share of the target's pixels without a measurement; NaN: there is no target"""
    noise_ratio: float
    """Scatter of single pixels, over what is stated; NaN: too few"""


def range_quality(measured: MeasuredDisparity, target: Bools) -> RangeQuality:
    """What the ranges of one frame show on the target (H, W).

    The scatter is that of the mask that annuls planes (Immerkaer, "Fast noise variance estimation", 1996), by
    its median, which edges do not move.
    """
    if not target.any():
        return RangeQuality(float("nan"), float("nan"))
    known = target & np.isfinite(measured.disparity_px)
    mask = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0])
    response = cv2.filter2D(np.where(known, measured.disparity_px, 0.0).astype(np.float64), -1, mask)
    whole = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    ratio = float("nan")
    if whole.sum() >= MIN_WINDOWS:
        # the squares of the mask add up to 36, and half of a normal law is within 0.6745 sigmas
        scatter = np.abs(np.asarray(response)[whole]) / 6.0 / measured.sigma_px[whole]
        ratio = float(np.median(scatter)) / 0.6745
    return RangeQuality(float(1.0 - known.sum() / target.sum()), ratio)


def range_image_checks(found: list[RangeQuality]) -> list[CheckoutCheck]:
    """Measured part of the target, and noise against what is stated."""
    missing = np.array([each.missing for each in found if np.isfinite(each.missing)])
    ratio = np.array([each.noise_ratio for each in found if np.isfinite(each.noise_ratio)])
    return [
        judged(
            "range",
            "target without a range",
            100.0 * float(np.median(missing)) if len(missing) else None,
            "%",
            MAX_MISSING,
            fail_limit=FAIL_MISSING,
            not_possible="FAIL",
            finding=f"From {100 * missing.min():.0f} to {100 * missing.max():.0f} % of the target's pixels "
            "have no measurement."
            if len(missing)
            else "No examined image shows the target.",
            advice="See whether the ranges belong to the pixels of the images, and whether the target is "
            "within the reach of the sensor; give masks if other things are taken for the target.",
        ),
        judged(
            "range",
            "noise of the ranges, over what is stated",
            float(np.median(ratio)) if len(ratio) else None,
            "",
            MAX_NOISE_RATIO,
            not_possible="WARN",
            finding=f"Single pixels scatter by {np.median(ratio):.2g} of the stated standard deviation."
            if len(ratio)
            else "Too few pixels with ranges lie side by side.",
            advice="Correct sigma_m and sigma_growth_per_m in range0/sensor.yaml, since sigmas and weights "
            "follow them; or scale_m, if the expected range is wrong by such a factor too.",
        ),
    ]
