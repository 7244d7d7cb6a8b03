"""Whether the rows of left and right image agree: pitch and roll of the right camera, relative to the left.

After rectification with the stated calibration, a point has the same row in both images. If the right camera
is turned, its image of a point at (X, Y, 1) moves along the rows' order by

    f (pitch (1 + Y^2) - roll X + stretch Y - yaw X Y)

where pitch is a rotation about x (up is positive), roll one about the viewing direction (clockwise, as the
camera sees it) and stretch the relative error of its focal length. Pitch is thus an offset of all rows, roll
a slope along them. Yaw, which moves all disparities and so all ranges, is multiplied by X Y, a few
hundredths on a usual target: rows hardly show it. A camera that is displaced vertically looks like one with
a pitch as long as the target is at one distance.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.pipeline.checkout.check_table import Limits, limit_of, make_check
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.sample import Sample
from polhode.pipeline.checks.data_checks.rig_check import EXCHANGED_SHARE, MIN_MATCHES

REGIONS = 3
"""Across and down the image."""
MIN_IN_REGION = 15
CLEAR_SIGMAS = 5.0
"""A tilt that is smaller than so many of its standard deviations is no finding."""


@dataclass(frozen=True)
class RowFit:
    """n matches of all examined pairs, and the tilt that fits them."""

    uv_px: Array
    """(n, 2) in the rectified left image"""
    disparity_px: Array
    """(n,) of either sign"""
    offset_px: Array
    """(n,) row in the left image minus row in the right one"""
    residual_px: Array
    """(n,) of the fit"""
    good: Bools
    """(n,) no outlier"""
    tilt: Array
    """(3,) pitch [rad], roll [rad], stretch"""
    sigma: Array
    """(3,) of these"""
    sigma_yaw_rad: float
    """Of a yaw, if it were solved for as well"""


def design(rig: RectifiedRig, uv_px: Array, disparity_px: Array) -> Array:
    """(n, 4) derivatives of the offset by pitch, roll, stretch and yaw [px]."""
    x = (uv_px[:, 0] - disparity_px - rig.cx_px + rig.disparity_offset_px) / rig.focal_px
    y = (uv_px[:, 1] - rig.cy_px) / rig.focal_px
    return rig.focal_px * np.column_stack([-(1.0 + y * y), x, -y, x * y])


def fit_rows(sample: Sample, rig: RectifiedRig) -> RowFit | None:
    """Robust least squares over all examined pairs; None: there are too few matches.

    Each pair is one observation in the standard deviations: the errors of its matches have causes in common.
    """
    rows = [(k, pair.rows) for k, pair in enumerate(sample.pairs) if len(pair.rows.offset_px) >= MIN_MATCHES]
    if len(rows) < 3 or sum(len(each.offset_px) for _, each in rows) < 40:
        return None
    uv, d, y = (
        np.concatenate([getattr(each, name) for _, each in rows])
        for name in ("uv_px", "disparity_px", "offset_px")
    )
    pair = np.concatenate([np.full(len(each.offset_px), k) for k, each in rows])
    A, tilt, residual = design(rig, uv, d), np.zeros(3), y - np.median(y)
    for _ in range(5):
        good = np.abs(residual) <= 3.0 * max(1.4826 * float(np.median(np.abs(residual))), 0.05)
        tilt = np.linalg.lstsq(A[good, :3], y[good])[0]
        residual = y - A[:, :3] @ tilt

    def sigmas(A: Array, residual: Array) -> Array:
        """By the scatter between pairs, and at least those of independent errors."""
        inverse = np.linalg.pinv(A.T @ A)
        labels, index = np.unique(pair[good], return_inverse=True)
        score = np.zeros((len(labels), A.shape[1]))
        np.add.at(score, index, A * residual[:, None])
        among = len(labels) / max(len(labels) - 1, 1)
        grouped = np.diagonal(inverse @ (score.T @ score) @ inverse) * among
        return np.sqrt(np.maximum(grouped, np.diagonal(inverse) * float(np.var(residual))))

    with_yaw = y[good] - A[good] @ np.linalg.lstsq(A[good], y[good])[0]
    sigma = sigmas(A[good, :3], residual[good])
    return RowFit(uv, d, y, residual, good, tilt, sigma, float(sigmas(A[good], with_yaw)[3]))


def regions(fit: RowFit, rig: RectifiedRig, values: Array) -> tuple[Array, Ints]:
    """Median of values (n,) in each part (3, 3) of the image, rows from the top, and number of matches."""
    size = np.array([rig.width_px, rig.height_px]) / REGIONS
    at = np.clip((fit.uv_px // size).astype(np.int64), 0, REGIONS - 1)
    median, count = np.full((REGIONS, REGIONS), np.nan), np.zeros((REGIONS, REGIONS), dtype=np.int64)
    for row, column in np.ndindex(median.shape):
        here = fit.good & (at[:, 0] == column) & (at[:, 1] == row)
        count[row, column] = here.sum()
        median[row, column] = np.median(values[here]) if here.any() else np.nan
    return median, count


def tilt_checks(sample: Sample, rig: RectifiedRig, fit: RowFit | None) -> list[CheckoutCheck]:
    """Exchanged images, rows, pitch, roll, focal lengths, and parts of the image that differ.

    None of them is possible without a second camera.
    """
    if all(pair.right is None for pair in sample.pairs):
        return []
    counted = [pair.rows.disparity_px for pair in sample.pairs if len(pair.rows.disparity_px) >= MIN_MATCHES]
    behind = [float(np.mean(d < rig.disparity_offset_px)) > EXCHANGED_SHARE for d in counted]
    share, finding = None, "Left and right image have too little in common to say."
    if counted:
        share = 100.0 * float(np.mean(behind))
        finding = f"In {sum(behind)} of {len(counted)} pairs most points would be behind the cameras."
    exchanged = make_check("exchanged", share, finding)

    def angle(px: float, arm: float = 1.0) -> float:
        """That moves rows by so many pixels, at an arm of 1 / ``arm`` focal lengths [deg]."""
        return float(f"{np.rad2deg(arm * px / rig.focal_px):.3g}")

    warn_px, fail_px = limit_of("rows"), 0.8
    limits: dict[str, Limits] = {
        "rows": (warn_px, fail_px),
        "pitch": (angle(warn_px), angle(fail_px)),
        "roll": (angle(warn_px, 4.0), None),
        "focal lengths": (limit_of("focal lengths"), None),
        "region": (limit_of("region"), None),
    }
    if fit is None:
        count = sum(len(pair.rows.offset_px) for pair in sample.pairs)
        why = f"Left and right image have {count} matches in {len(sample.pairs)} pairs, too few to judge."
        advice = "Check that both cameras show the target in focus and that their images belong together."
        none = [make_check(key, None, why, limits=each, advice=advice) for key, each in limits.items()]
        return [exchanged, *none]
    checks = [exchanged]
    for (key, (limit, fail)), (value, sigma, finding) in zip(limits.items(), _values(fit, rig), strict=True):
        # limits are raised where the standard deviation would let chance cross them
        least = 0.0 if sigma is None else CLEAR_SIGMAS * sigma
        raised = [None if each is None else max(each, least) for each in (limit, fail)]
        checks.append(make_check(key, value, finding, limits=(raised[0], raised[1]), sigma=sigma))
    return checks


def _values(fit: RowFit, rig: RectifiedRig) -> list[tuple[float, float | None, str]]:
    """Value, sigma and finding of each check of the rows."""
    pitch, roll, stretch = np.rad2deg(fit.tilt[0]), np.rad2deg(fit.tilt[1]), 100.0 * fit.tilt[2]
    sigma_pitch, sigma_roll, sigma_stretch = *np.rad2deg(fit.sigma[:2]), 100.0 * fit.sigma[2]
    offset, residual = fit.offset_px[fit.good], fit.residual_px[fit.good]
    scatter = 1.4826 * float(np.median(np.abs(residual)))
    common = float(np.sqrt(np.mean((offset - residual) ** 2)))
    ahead = fit.disparity_px[fit.good] - rig.disparity_offset_px
    ahead = ahead[ahead > 0.5]
    range_m = rig.focal_px * rig.baseline_m / float(np.median(ahead)) if len(ahead) else 0.0
    yaw_mm, yaw_deg = 1e3 * np.deg2rad(0.1) * range_m**2 / rig.baseline_m, np.rad2deg(fit.sigma_yaw_rad)
    median, count = regions(fit, rig, fit.residual_px)
    enough = count >= MIN_IN_REGION
    worst = float(np.nanmax(np.abs(median[enough]))) if enough.any() else float("nan")
    rows = (
        f"Rows of left and right image differ by {np.median(offset):+.2f} px (median of {len(offset)} "
        f"matches), and by {common:.2f} px (root mean square) as a tilt explains it; the rest scatters by "
        f"{scatter:.2f} px."
    )
    up = (
        f"The right camera looks {abs(pitch):.3f} deg {'up' if pitch > 0 else 'down'} against its "
        f"calibration (sigma {sigma_pitch:.3f} deg), or lies {1e3 * abs(fit.tilt[0]) * range_m:.2g} mm off "
        f"vertically. A yaw would not show: these rows leave it open to {3 * yaw_deg:.2g} deg, and 0.1 deg "
        f"of it shifts the range by {yaw_mm:.2g} mm."
    )
    clockwise = (
        f"The right camera is turned {abs(roll):.3f} deg {'clockwise' if roll > 0 else 'anticlockwise'} "
        f"about its viewing direction (sigma {sigma_roll:.3f} deg)."
    )
    longer = (
        f"The right focal length is {abs(stretch):.2f} % {'longer' if stretch > 0 else 'shorter'} against "
        f"the left one than calibrated (sigma {sigma_stretch:.2f} %)."
    )
    parts = (
        f"{int(enough.sum())} of {REGIONS * REGIONS} parts of the image have {MIN_IN_REGION} matches or "
        "more; the largest median of what the tilt leaves there."
    )
    return [
        (common, None, rows),
        (abs(float(pitch)), float(sigma_pitch), up),
        (abs(float(roll)), float(sigma_roll), clockwise),
        (abs(float(stretch)), float(sigma_stretch), longer),
        (worst, None, parts),
    ]
