"""How far the target is and how large it appears, and what stereo, or range images, can measure there."""

import numpy as np

from polhode.frontend.features.epipolar_search import MAX_SHIFT_SHARE
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.pipeline.checkout.check_table import SEE_IMAGES, make_check
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.sample import Sample


def ranges_m(sample: Sample) -> Array:
    """(n,) ranges of all features of all pairs [m]."""
    found = [pair.features.p_R[:, 2] for pair in sample.pairs if len(pair.features) >= 8]
    return np.concatenate(found) if found else np.zeros(0)


def range_checks(sample: Sample, rig: RectifiedRig) -> list[CheckoutCheck]:
    """Size of the target, disparities against what is searched, resolution of the depth; of range images
    their own quality."""
    z, scale = ranges_m(sample), rig.focal_px * rig.baseline_m
    extent = [max(pair.left.extent_px) for pair in sample.pairs if max(pair.left.extent_px) > 0.0]
    extent_px = float(np.median(extent)) if extent else None
    finding = "No examined image shows anything brighter than the sky."
    if extent_px is not None:
        at = f", {extent_px * float(np.median(z)) / rig.focal_px:.3g} m at its median range" if len(z) else ""
        finding = f"The longer side of what is taken as the target has {extent_px:.0f} px{at}."
    checks = [make_check("size", extent_px, finding)]
    if sample.has_ranges:
        checks += _range_images(sample)
    elif len(z) == 0:
        none = "No pair has enough stereo features to say how far the target is."
        keys = ("smallest disparity", "largest disparity")
        checks += [make_check(key, None, none, advice=SEE_IMAGES) for key in keys]
    else:
        near, middle, far = np.percentile(z, [2.0, 50.0, 98.0])
        shift = float(np.percentile(np.abs(scale / z + rig.disparity_offset_px), 98.0))
        finding = (
            f"The features are {near:.3g} to {far:.3g} m away, their median {middle:.3g} m: disparities of "
            f"{scale / far:.1f} to {scale / near:.1f} px."
        )
        searched = (
            f"Columns of one point differ by up to {shift:.0f} px; matching searches "
            f"{MAX_SHIFT_SHARE * rig.width_px:.0f} px."
        )
        checks.append(make_check("smallest disparity", scale / far, finding))
        checks.append(make_check("largest disparity", 100.0 * shift / rig.width_px, searched))
    if len(z) == 0 or extent_px is None:
        advice = SEE_IMAGES.replace("rig", "ranges") if sample.has_ranges else SEE_IMAGES
        return [*checks, make_check("depth", None, "There are no features with a depth.", advice=advice)]
    middle = float(np.median(z))
    sigma_px = float(np.median(np.concatenate([pair.features.sigma_px[:, 2] for pair in sample.pairs])))
    per_px = middle**2 / scale
    finding = (
        f"At {middle:.3g} m a pixel of disparity is {1e3 * per_px:.3g} mm of depth; a feature's disparity is "
        f"known to {sigma_px:.2f} px, its depth to "
    )
    if sample.has_ranges:
        finding = f"The depth of a feature at {middle:.3g} m, by the ranges around it, is known to "
    value = 100.0 * per_px * sigma_px / (extent_px * middle / rig.focal_px)
    return [*checks, make_check("depth", value, f"{finding}{1e3 * per_px * sigma_px:.2g} mm.")]


def _range_images(sample: Sample) -> list[CheckoutCheck]:
    """Measured part of the target, and noise against what is stated."""
    found = [pair.ranges for pair in sample.pairs if pair.ranges is not None]
    missing = 100.0 * np.array([each.missing for each in found if np.isfinite(each.missing)])
    ratio = np.array([each.noise_ratio for each in found if np.isfinite(each.noise_ratio)])
    without, noise = "No examined image shows the target.", "Too few pixels with ranges lie side by side."
    if len(missing):
        span = f"{missing.min():.0f} to {missing.max():.0f}"
        without = f"From {span} % of the target's pixels have no measurement."
    if len(ratio):
        noise = f"Single pixels scatter by {np.median(ratio):.2g} of the stated standard deviation."
    return [
        make_check("missing ranges", float(np.median(missing)) if len(missing) else None, without),
        make_check("range noise", float(np.median(ratio)) if len(ratio) else None, noise),
    ]
