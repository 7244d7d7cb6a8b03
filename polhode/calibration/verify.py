"""Whether a calibration holds for fresh images of a board: PASS, WARN or FAIL, with figures and limits.

The calibration stays as it is; only the poses of the boards are fitted, to both images of each pair. What is
left is judged as it is, and once more after the right camera was allowed to turn, and the focal lengths to
change: a rig that was knocked, or a lens that was touched, is named by what would mend it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from polhode.calibration.adjustment import Adjusted, CornerData, RigState, adjust
from polhode.calibration.boards import Board
from polhode.calibration.calibrate import (
    Views,
    find_views,
    leave_out_blurred,
    require_board,
    require_enough,
    rms_px,
)
from polhode.calibration.epipolar import common_corners, epipolar_px, rays
from polhode.calibration.image_pairs import SIDES, ImagePairs
from polhode.calibration.lenses import COEFFICIENTS, Lens
from polhode.calibration.result import RejectedImage, rejected_images
from polhode.calibration.start_values import board_poses
from polhode.geometry.lie import Array, Ints, inverse_pose, log_so3
from polhode.importers.calibrations.read_rig import read_rig
from polhode.importers.calibrations.rig import EQUIDISTANT, Camera, Rig, require_usable
from polhode.pipeline.checkout.result import CheckoutCheck, Verdict, judge, worst
from polhode.run_directory.summary_schema import StrictModel
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

EPIPOLAR_PX = (0.3, 0.8)
"""A check warns beyond the first and fails beyond the second, as polhode checkout has them: stereo matching
accepts rows that differ by 0.8 px"""
SIGMAS = 5.0
"""By so many standard deviations a change is more than what the images leave open"""


class VerificationResult(StrictModel):
    """The content of verification.json."""

    schema_: Literal["polhode-verification/1"] = Field("polhode-verification/1", alias="schema")
    status: Verdict
    """The worst of the checks"""
    calibration: tuple[str, ...]
    """Files or folder that were judged"""
    pairs: int
    checks: tuple[CheckoutCheck, ...]
    rejected: tuple[RejectedImage, ...]


@dataclass(frozen=True)
class Verified:
    """A calibration, judged."""

    result: VerificationResult
    views: Views
    state: RigState
    """The calibration, with the poses of the boards"""
    data: tuple[CornerData, CornerData]
    residuals: tuple[Array, ...]


def verify(
    pairs: ImagePairs, board: Board, paths: Sequence[Path], unit_m: float, progress: Progress
) -> Verified:
    """Judge the calibration in ``paths`` by images of a board.

    ``unit_m``: of T in OpenCV's files. Raises InputError: no calibration, NaN in it, exchanged cameras,
    images of another size or another board, too few of them.
    """
    rig = read_rig(paths, unit_m)
    if all(camera.size_px is not None for camera in rig.cameras):
        require_usable(rig)
    lenses = (lens_of(rig.left), lens_of(rig.right))
    X_10 = inverse_pose(rig.right.X_BC) @ rig.left.X_BC
    views = find_views(pairs, board, progress)
    _require_size(views, rig)
    require_board(views)
    leave_out_blurred(views)
    require_enough(views)
    with progress.stage("judging", 1) as advance:
        state, data = _place_boards(views, lenses, X_10, rig.left.source)
        fixed = np.zeros(state.shared, dtype=np.bool_)
        held = adjust(data, state, fixed, robust=True)
        checks = _checks(views, held, data)
        advance()
    result = VerificationResult(
        status=worst(checks),
        calibration=tuple(map(str, paths)),
        pairs=len(views.found[0].keys() & views.found[1].keys()),
        checks=tuple(checks),
        rejected=rejected_images(views),
    )
    return Verified(result, views, held.state, data, held.residuals)


def lens_of(camera: Camera) -> Lens:
    """The lens of a calibration of another program. Raises InputError for a model that has no equal here."""
    coefficients = np.array(camera.distortion, dtype=np.float64)
    if camera.model == EQUIDISTANT:
        return Lens("fisheye", np.array([*camera.intrinsics, *coefficients]))
    if coefficients[8:].any():
        raise InputError(
            f"{camera.source}: {len(coefficients)} distortion coefficients, with thin prism or tilt, cannot "
            "be judged; calibrate with 4, 5 or 8"
        )
    model: Literal["brown5", "brown8"] = "brown8" if coefficients[5:].any() else "brown5"
    values = np.zeros(len(COEFFICIENTS[model]))
    values[: min(len(values), len(coefficients))] = coefficients[: len(values)]
    return Lens(model, np.array([*camera.intrinsics, *values]))


def _require_size(views: Views, rig: Rig) -> None:
    for camera, each in enumerate(rig.cameras):
        width, height = views.size_px(camera)
        if each.size_px not in (None, (width, height)):
            stated = "x".join(map(str, each.size_px or ()))
            raise InputError(
                f"{each.source}: calibrated for images of {stated} px, but the {SIDES[camera]} ones have "
                f"{width}x{height}; give images of this rig"
            )


def _place_boards(
    views: Views, lenses: tuple[Lens, Lens], X_10: Array, source: str
) -> tuple[RigState, tuple[CornerData, CornerData]]:
    """The boards before the rig; pairs that contradict most others are left out.

    Raises InputError if the images have the right camera where the calibration has the left one.
    """
    consensus = views.consensus(lenses)
    seen, stated, exchanged = (X[:3, 3] for X in (consensus.X_10, X_10, inverse_pose(X_10)))
    half = 0.5 * np.linalg.norm(stated)
    if np.linalg.norm(seen - exchanged) < half < np.linalg.norm(seen - stated):
        raise InputError(
            f"{source}: the images fit this calibration only with left and right exchanged; exchange --left "
            "and --right, or the cameras of the calibration"
        )
    views.leave_out_spoiled(consensus)
    require_enough(views)
    data = (views.data(0), views.data(1))
    poses = board_poses(lenses[0], data[0], views.count)[0]
    others = inverse_pose(X_10) @ board_poses(lenses[1], data[1], views.count)[0]
    for k in range(views.count):
        if k not in views.found[0]:
            poses[k] = others[k]
    return RigState(lenses, poses, X_10), data


def _checks(views: Views, held: Adjusted, data: tuple[CornerData, CornerData]) -> list[CheckoutCheck]:
    state, residuals = held.state, held.residuals
    left, right = common_corners(data)
    error = epipolar_px(state, data[0].uv_px[left], data[1].uv_px[right])
    recalibrate = "Calibrate the rig again: polhode calibrate with these images, and more."
    return [
        _check(
            "reprojection error",
            rms_px(np.concatenate(residuals)),
            "px",
            (0.5, 1.0),
            f"Left {rms_px(residuals[0]):.3f} px, right {rms_px(residuals[1]):.3f} px rms, of the boards "
            "that fit both images best.",
            recalibrate,
        ),
        _check(
            "epipolar error",
            float(np.sqrt(np.nanmean(error**2))),
            "px",
            EPIPOLAR_PX,
            f"Of {len(left)} corners that both cameras see; mean {np.nanmean(error):+.3f} px.",
            recalibrate,
        ),
        _worst_part(views, residuals, data),
        _lengths(state, data, left, right),
        *_changes(held, data),
    ]


def _check(
    name: str,
    value: float,
    unit: str,
    limits: tuple[float, float],
    finding: str,
    advice: str,
    sigma: float | None = None,
) -> CheckoutCheck:
    """``limits``: beyond which it warns, and beyond which it fails."""
    limit, fail = limits
    return judge(
        "rig", name, value, unit, limit, fail_limit=fail, sigma=sigma, finding=finding, advice=advice
    )


def _worst_part(
    views: Views, residuals: Sequence[Array], data: tuple[CornerData, CornerData]
) -> CheckoutCheck:
    """The part of an image, of three times three, whose corners are off in common."""
    most, words = 0.0, "No part of the images has enough corners."
    for camera, (each, off) in enumerate(zip(data, residuals, strict=True)):
        share = each.uv_px / np.array(views.size_px(camera))
        cell = np.clip((share * 3).astype(int), 0, 2)
        for row, column in np.ndindex(3, 3):
            inside = (cell == [column, row]).all(axis=1)
            mean = np.median(off[inside], axis=0) if inside.sum() >= 20 else np.zeros(2)
            if np.linalg.norm(mean) > most:
                most = float(np.linalg.norm(mean))
                words = (
                    f"In the {SIDES[camera]} image, part {column + 1} of 3 from the left and {row + 1} of 3 "
                    f"from the top: {mean[0]:+.2f}, {mean[1]:+.2f} px in the median."
                )
    advice = "The lens is not as calibrated there: calibrate with boards in that part of the image."
    return _check("residual of the worst part of an image", most, "px", (0.3, 0.8), words, advice)


def _lengths(state: RigState, data: tuple[CornerData, CornerData], left: Ints, right: Ints) -> CheckoutCheck:
    """Distances on the board as both cameras measure them, against the true ones."""
    # points halfway between rays from 0 along a and from t along b
    a = rays(state.lenses[0], data[0].uv_px[left])
    b = rays(state.lenses[1], data[1].uv_px[right]) @ state.X_10[:3, :3]
    t = -state.X_10[:3, :3].T @ state.X_10[:3, 3]
    ab, at, bt = (a * b).sum(axis=1), a @ t, b @ t
    along_a, along_b = (at - ab * bt) / (1.0 - ab**2), (ab * at - bt) / (1.0 - ab**2)
    p = 0.5 * (along_a[:, None] * a + t + along_b[:, None] * b)
    view, on_board = data[0].view[left], data[0].p_B[left]
    ratios = []
    for k in np.unique(view):
        own = np.flatnonzero((view == k) & np.isfinite(p).all(axis=1))
        if len(own) < 4:
            continue
        # every corner with the one half the board away: long distances, each corner twice
        other = np.roll(own, len(own) // 2)
        seen = np.linalg.norm(p[own] - p[other], axis=1)
        true = np.linalg.norm(on_board[own] - on_board[other], axis=1)
        ratios.append(float(np.median(seen / true)))
    off = 100.0 * (float(np.median(ratios)) - 1.0) if ratios else float("nan")
    return _check(
        "error of lengths",
        abs(off),
        "%",
        (0.5, 2.0),
        f"Distances on the board are measured {off:+.2f} % off, in the median of {len(ratios)} pairs.",
        "Check the size of the squares of this board and of the one that was used to calibrate; if both are "
        "right, the baseline or the yaw of the right camera is not.",
        125.0 * float(np.std(ratios)) / np.sqrt(len(ratios)) if len(ratios) > 2 else None,
    )


def _changes(held: Adjusted, data: tuple[CornerData, CornerData]) -> list[CheckoutCheck]:
    """By how much the right camera is turned against its calibration, and how much the focal lengths are
    off."""
    state = held.state
    free = np.zeros(state.shared, dtype=np.bool_)
    free[-6:-3] = True
    found = adjust(data, state, free, robust=True)
    R = state.X_10[:3, :3]
    turn = np.degrees(log_so3(R @ found.state.X_10[:3, :3].T))
    # theta is in the left camera's frame, the turn in the right one's
    sigma = np.degrees(np.sqrt(np.diag(R @ found.covariance[-6:-3, -6:-3] @ R.T)))
    focal = float(state.lenses[1].values[:2].mean())
    checks = []
    # a roll moves what is a quarter of the focal length from the axis by a quarter as much
    for name, share, value, s in zip(
        ("pitch", "yaw", "roll"), (1.0, 1.0, 4.0), turn.tolist(), sigma.tolist(), strict=True
    ):
        warn, fail = (np.degrees(share * px / focal) for px in EPIPOLAR_PX)
        checks.append(
            _check(
                f"{name} of the right camera",
                abs(value),
                "deg",
                _beyond_noise(warn, fail, s),
                f"Turned by {value:+.4f} deg against the calibration.",
                "The rig was knocked, or is warmer than it was: fix the cameras, and calibrate.",
                s,
            )
        )
    starts = (0, state.sizes[0])
    for start in starts:
        free[start : start + 2] = True
    found = adjust(data, state, free, robust=True)
    for camera, start in enumerate(starts):
        before, after = (each.lenses[camera].values[:2] for each in (state, found.state))
        change = 100.0 * float((after / before - 1.0).mean())
        own = found.covariance[start : start + 2, start : start + 2]
        s = 100.0 * float(np.sqrt(own.sum()) / 2.0 / before.mean())
        checks.append(
            _check(
                f"focal length of the {SIDES[camera]} camera",
                abs(change),
                "%",
                _beyond_noise(0.3, 0.9, s),
                f"{change:+.3f} % from the calibration, fitted with the turn of the right camera.",
                "Focus or zoom was touched, or images are scaled: restore it, or calibrate.",
                s,
            )
        )
    return checks


def _beyond_noise(warn: float, fail: float, sigma: float) -> tuple[float, float]:
    """Limits of two digits, at least ``SIGMAS`` standard deviations."""
    limit, fail, least = (float(f"{each:.2g}") for each in (warn, fail, SIGMAS * sigma))
    return max(limit, least), max(fail, least)
