"""How far the target is and how large it appears, and what stereo can measure there."""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.frontend.features.stereo import MAX_SHIFT_SHARE
from polhode.lie import Array
from polhode.pipeline.checkout.range_images import range_image_checks
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.pipeline.checkout.sample import Sample

MIN_FEATURES = 8
"""Of a pair, for its range to count."""
MIN_EXTENT_PX, FAIL_EXTENT_PX = 90.0, 30.0
"""Longer side of the target's bounding box."""
MIN_DISPARITY_PX, FAIL_DISPARITY_PX = 6.0, 1.5
MAX_DEPTH_SIGMA = 0.03
"""Standard deviation of the depth of one feature, over the size of the target."""
MAX_SHARE = 0.9
"""Of the largest shift that stereo matching searches."""
MAX_SHIFT_PERCENT = round(100.0 * MAX_SHARE * MAX_SHIFT_SHARE, 1)


def ranges_m(sample: Sample) -> Array:
    """(n,) ranges of all features of all pairs [m]."""
    found = [pair.features.p_R[:, 2] for pair in sample.pairs if len(pair.features) >= MIN_FEATURES]
    return np.concatenate(found) if found else np.zeros(0)


def range_checks(sample: Sample, rig: RectifiedRig) -> list[CheckoutCheck]:
    """Size of the target, disparities against what is searched, resolution of the depth; of range images
    their own quality."""
    z = ranges_m(sample)
    extent = [max(pair.left.extent_px) for pair in sample.pairs if max(pair.left.extent_px) > 0.0]
    extent_px = float(np.median(extent)) if extent else None
    ranges = [pair.ranges for pair in sample.pairs if pair.ranges is not None]
    of_sensor = range_image_checks(ranges) if ranges else _disparity(z, rig)
    return [_size(z, extent_px, rig), *of_sensor, _depth(sample, z, extent_px, rig)]


def _size(z: Array, extent_px: float | None, rig: RectifiedRig) -> CheckoutCheck:
    if extent_px is None:
        finding = "No examined image shows anything brighter than the sky."
    else:
        finding = f"The longer side of what is taken as the target has {extent_px:.0f} px"
        if len(z):
            finding += f", {extent_px * float(np.median(z)) / rig.focal_px:.3g} m at its median range"
        finding += "."
    return judged(
        "range",
        "size of the target",
        extent_px,
        "px",
        MIN_EXTENT_PX,
        fail_limit=FAIL_EXTENT_PX,
        at_least=True,
        finding=finding,
        not_possible="FAIL",
        advice="Go nearer or use a longer focal length, so that the target fills more of the image.",
    )


def _disparity(z: Array, rig: RectifiedRig) -> list[CheckoutCheck]:
    most = MAX_SHIFT_PERCENT
    if len(z) == 0:
        none = "No pair has enough stereo features to say how far the target is."
        advice = "See what the checks of the rig and of the images say."
        return [
            judged(
                "range",
                "smallest disparity",
                None,
                "px",
                MIN_DISPARITY_PX,
                fail_limit=FAIL_DISPARITY_PX,
                at_least=True,
                finding=none,
                advice=advice,
                not_possible="FAIL",
            ),
            judged(
                "range",
                "largest shift between the images",
                None,
                "% of the width",
                most,
                finding=none,
                advice=advice,
                not_possible="FAIL",
            ),
        ]
    near, middle, far = np.percentile(z, [2.0, 50.0, 98.0])
    scale = rig.focal_px * rig.baseline_m
    shift = float(np.percentile(np.abs(scale / z + rig.disparity_offset_px), 98.0))
    where = f"The features are {near:.3g} to {far:.3g} m away, their median {middle:.3g} m"
    return [
        judged(
            "range",
            "smallest disparity",
            scale / far,
            "px",
            MIN_DISPARITY_PX,
            fail_limit=FAIL_DISPARITY_PX,
            at_least=True,
            finding=f"{where}: disparities of {scale / far:.1f} to {scale / near:.1f} px.",
            advice="Go nearer, or use a longer baseline or focal length: range is poor at small disparities.",
        ),
        judged(
            "range",
            "largest shift between the images",
            100.0 * shift / rig.width_px,
            "% of the width",
            most,
            finding=f"Columns of one point differ by up to {shift:.0f} px; matching searches "
            f"{MAX_SHIFT_SHARE * rig.width_px:.0f} px.",
            advice="Stay farther away, use a shorter baseline, or turn the cameras towards the target: parts "
            "with larger shifts are lost to stereo matching.",
        ),
    ]


def _depth(sample: Sample, z: Array, extent_px: float | None, rig: RectifiedRig) -> CheckoutCheck:
    name, limit = "depth sigma of a feature over the size of the target", 100.0 * MAX_DEPTH_SIGMA
    if len(z) == 0 or extent_px is None:
        return judged(
            "range",
            name,
            None,
            "%",
            limit,
            finding="There are no features with a depth.",
            advice="See what the checks of the ranges and of the images say."
            if sample.has_ranges
            else "See what the checks of the rig and of the images say.",
            not_possible="WARN",
        )
    middle = float(np.median(z))
    sigma_px = float(np.median(np.concatenate([pair.features.sigma_px[:, 2] for pair in sample.pairs])))
    per_px = middle**2 / (rig.focal_px * rig.baseline_m)
    size = extent_px * middle / rig.focal_px
    if sample.has_ranges:
        finding = f"The depth of a feature at {middle:.3g} m, by the ranges around it, is known to "
    else:
        finding = (
            f"At {middle:.3g} m a pixel of disparity is {1e3 * per_px:.3g} mm of depth; a feature's "
            f"disparity is known to {sigma_px:.2f} px, its depth to "
        )
    return judged(
        "range",
        name,
        100.0 * per_px * sigma_px / size,
        "%",
        limit,
        finding=f"{finding}{1e3 * per_px * sigma_px:.2g} mm.",
        advice="Go nearer, or measure depth better: shape and rotation rest on depth that is small against "
        "its noise.",
    )
