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

from polhode.camera import RectifiedRig
from polhode.lie import Array
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.pipeline.checkout.sample import Sample
from polhode.pipeline.data_checks.rig_check import EXCHANGED_SHARE, MIN_MATCHES
from polhode.records import Bools, Ints

MIN_ROWS = 40
"""Matches of all examined pairs together below which nothing is stated."""
MIN_PAIRS = 3
REGIONS = 3
"""Across and down the image."""
MIN_IN_REGION = 15
LEAST_SCATTER_PX = 0.05
MAX_ROW_PX, FAIL_ROW_PX = 0.3, 0.8
"""Root mean square of the rows' common offset: sound sequences have 0.06 at most, matching accepts 0.8."""
MAX_REGION_PX = 0.3
MAX_STRETCH = 0.003
"""Relative difference of the focal lengths."""
CLEAR = 5.0
"""A tilt that is smaller than so many of its standard deviations is no finding."""
CALIBRATE = "Calibrate the rig again, or give the right calibration with --rig."


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
    pitch_rad: float
    roll_rad: float
    stretch: float
    sigma: Array
    """(3,) of pitch [rad], roll [rad], stretch"""
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
    if len(rows) < MIN_PAIRS or sum(len(each.offset_px) for _, each in rows) < MIN_ROWS:
        return None
    uv, d, y = (
        np.concatenate([getattr(each, name) for _, each in rows])
        for name in ("uv_px", "disparity_px", "offset_px")
    )
    pair = np.concatenate([np.full(len(each.offset_px), k) for k, each in rows])
    A = design(rig, uv, d)
    solution, good = np.array([0.0, 0.0, 0.0]), np.ones(len(y), dtype=np.bool_)
    residual = y - np.median(y)
    for _ in range(5):
        good = np.abs(residual) <= 3.0 * max(1.4826 * float(np.median(np.abs(residual))), LEAST_SCATTER_PX)
        solution = np.linalg.lstsq(A[good, :3], y[good])[0]
        residual = y - A[:, :3] @ solution
    sigma = _sigma(A[good, :3], residual[good], pair[good])
    with_yaw = np.linalg.lstsq(A[good], y[good])[0]
    sigma_yaw = _sigma(A[good], y[good] - A[good] @ with_yaw, pair[good])[3]
    pitch, roll, stretch = map(float, solution)
    return RowFit(uv, d, y, residual, good, pitch, roll, stretch, sigma, float(sigma_yaw))


def _sigma(A: Array, residual: Array, pair: Ints) -> Array:
    """Standard deviations (k,) by the scatter between pairs, and at least those of independent errors."""
    inverse = np.linalg.pinv(A.T @ A)
    labels, index = np.unique(pair, return_inverse=True)
    score = np.zeros((len(labels), A.shape[1]))
    np.add.at(score, index, A * residual[:, None])
    among = len(labels) / max(len(labels) - 1, 1)
    grouped = np.diagonal(inverse @ (score.T @ score) @ inverse) * among
    independent = np.diagonal(inverse) * float(np.var(residual))
    return np.sqrt(np.maximum(grouped, independent))


def regions(fit: RowFit, rig: RectifiedRig, values: Array) -> tuple[Array, Ints]:
    """Median of values (n,) in each part (3, 3) of the image, rows from the top, and number of matches."""
    size = np.array([rig.width_px, rig.height_px]) / REGIONS
    at = np.clip((fit.uv_px // size).astype(np.int64), 0, REGIONS - 1)
    median = np.full((REGIONS, REGIONS), np.nan)
    count = np.zeros((REGIONS, REGIONS), dtype=np.int64)
    for row in range(REGIONS):
        for column in range(REGIONS):
            here = fit.good & (at[:, 0] == column) & (at[:, 1] == row)
            count[row, column] = here.sum()
            if here.any():
                median[row, column] = np.median(values[here])
    return median, count


def tilt_checks(sample: Sample, rig: RectifiedRig, fit: RowFit | None) -> list[CheckoutCheck]:
    """Exchanged images, rows, pitch, roll, focal lengths, and parts of the image that differ.

    None of them is possible without a second camera.
    """
    if all(pair.right is None for pair in sample.pairs):
        return []
    return [_exchanged(sample, rig), *_rows_checks(sample, rig, fit)]


def _exchanged(sample: Sample, rig: RectifiedRig) -> CheckoutCheck:
    counted = [pair.rows.disparity_px for pair in sample.pairs if len(pair.rows.disparity_px) >= MIN_MATCHES]
    negative = [float(np.mean(d < rig.disparity_offset_px)) > EXCHANGED_SHARE for d in counted]
    share = 100.0 * float(np.mean(negative)) if counted else None
    return judged(
        "rig",
        "pairs with left and right exchanged",
        share,
        "%",
        0.0,
        fail_limit=0.0,
        not_possible="WARN",
        finding=f"In {sum(negative)} of {len(counted)} pairs most points would be behind the cameras."
        if counted
        else "Left and right image have too little in common to say.",
        advice="Exchange cam0 and cam1, or correct T_BS in their sensor.yaml, if it is all pairs; else "
        "correct data.csv.",
    )


def _rows_checks(sample: Sample, rig: RectifiedRig, fit: RowFit | None) -> list[CheckoutCheck]:
    names = (
        ("vertical disparity", "px", MAX_ROW_PX, FAIL_ROW_PX),
        ("pitch of the right camera", "deg", _tilt_limit(rig, MAX_ROW_PX), _tilt_limit(rig, FAIL_ROW_PX)),
        ("roll of the right camera", "deg", _tilt_limit(rig, MAX_ROW_PX, 4.0), None),
        ("difference of the focal lengths", "%", 100.0 * MAX_STRETCH, None),
        ("vertical disparity beside the tilt, worst part of the image", "px", MAX_REGION_PX, None),
    )
    if fit is None:
        found = sum(len(pair.rows.offset_px) for pair in sample.pairs)
        why = f"Left and right image have {found} matches in {len(sample.pairs)} pairs, too few to judge."
        advice = "Check that both cameras show the target in focus and that their images belong together."
        return [
            judged(
                "rig",
                name,
                None,
                unit,
                limit,
                fail_limit=fail,
                finding=why,
                advice=advice,
                not_possible="WARN",
            )
            for name, unit, limit, fail in names
        ]
    values = _values(fit, rig)
    return [
        judged(
            "rig",
            name,
            value,
            unit,
            _clear(limit, sigma),
            fail_limit=_clear(fail, sigma),
            sigma=sigma,
            finding=finding,
            advice=advice,
        )
        for (name, unit, limit, fail), (value, sigma, finding, advice) in zip(names, values, strict=True)
    ]


def _clear(limit: float | None, sigma: float | None) -> float | None:
    """A limit, raised where the standard deviation would let chance cross it."""
    return limit if limit is None or sigma is None else max(limit, CLEAR * sigma)


def _tilt_limit(rig: RectifiedRig, px: float, arm: float = 1.0) -> float:
    """The angle [deg] that moves rows by so many pixels, at an arm of 1 / ``arm`` focal lengths."""
    return float(f"{np.rad2deg(arm * px / rig.focal_px):.3g}")


def _values(fit: RowFit, rig: RectifiedRig) -> list[tuple[float, float | None, str, str]]:
    """Value, sigma, finding and advice of each check."""
    pitch, roll = np.rad2deg([fit.pitch_rad, fit.roll_rad])
    sigma_pitch, sigma_roll = np.rad2deg(fit.sigma[:2])
    n, offset = int(fit.good.sum()), fit.offset_px[fit.good]
    middle = float(np.median(offset))
    scatter = 1.4826 * float(np.median(np.abs(fit.residual_px[fit.good])))
    common = float(np.sqrt(np.mean((offset - fit.residual_px[fit.good]) ** 2)))
    range_m = _range_m(fit, rig)
    vertical_mm, yaw_mm = (
        1e3 * abs(fit.pitch_rad) * range_m,
        1e3 * np.deg2rad(0.1) * range_m**2 / rig.baseline_m,
    )
    yaw_deg = float(np.rad2deg(fit.sigma_yaw_rad))
    median, count = regions(fit, rig, fit.residual_px)
    enough = count >= MIN_IN_REGION
    worst = float(np.nanmax(np.abs(median[enough]))) if enough.any() else float("nan")
    return [
        (
            common,
            None,
            f"Rows of left and right image differ by {middle:+.2f} px (median of {n} matches), and by "
            f"{common:.2f} px (root mean square) as a tilt explains it; the rest scatters by {scatter:.2f} "
            "px.",
            CALIBRATE,
        ),
        (
            abs(float(pitch)),
            float(sigma_pitch),
            f"The right camera looks {abs(pitch):.3f} deg {'up' if pitch > 0 else 'down'} against its "
            "calibration "
            f"(sigma {sigma_pitch:.3f} deg), or lies {vertical_mm:.2g} mm off vertically. A yaw would not "
            "show: "
            f"these rows leave it open to {3 * yaw_deg:.2g} deg, and 0.1 deg of it shifts the range by "
            f"{yaw_mm:.2g} mm.",
            CALIBRATE,
        ),
        (
            abs(float(roll)),
            float(sigma_roll),
            f"The right camera is turned {abs(roll):.3f} deg "
            f"{'clockwise' if roll > 0 else 'anticlockwise'} about "
            f"its viewing direction (sigma {sigma_roll:.3f} deg).",
            CALIBRATE,
        ),
        (
            100.0 * abs(fit.stretch),
            100.0 * float(fit.sigma[2]),
            f"The right focal length is {100 * abs(fit.stretch):.2f} % "
            f"{'longer' if fit.stretch > 0 else 'shorter'} "
            f"against the left one than calibrated (sigma {100 * fit.sigma[2]:.2f} %).",
            CALIBRATE,
        ),
        (
            worst,
            None,
            f"{int(enough.sum())} of {REGIONS * REGIONS} parts of the image have {MIN_IN_REGION} matches "
            "or more; the largest median of what the tilt leaves there.",
            "Look at the map in checkout.html, and calibrate again with the board in all parts of the image: "
            "the distortion does not fit.",
        ),
    ]


def _range_m(fit: RowFit, rig: RectifiedRig) -> float:
    """Median range of the matches in front of the camera [m]; 0: none are."""
    ahead = fit.disparity_px[fit.good] - rig.disparity_offset_px
    ahead = ahead[ahead > 0.5]
    return rig.focal_px * rig.baseline_m / float(np.median(ahead)) if len(ahead) else 0.0
