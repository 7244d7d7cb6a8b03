"""Whether the images are those of the rig that the calibration describes: signs that need no truth.

A wrong rig moves the target as a whole, and the residuals of the motion hardly show it. The rows of both
images do: matches that ignore the epipolar constraint (``frontend/features/row_offsets``). Rows that differ
from some time on: one camera was knocked. Rows that differ with the speed at which the image moves: the
cameras look at different times. Disparities below zero: the images of the pair are exchanged.

Sideways, a knock changes disparities alone. Then everything is nearer and smaller, or farther and larger,
from some time on: what frames before and after it share does not fit together (``disparity_steps``).

What no image can show is in docs/robustness.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.lie import Array, inverse_pose, log_so3, transform_points
from polhode.pipeline.context import RunContext
from polhode.pipeline.data_checks.disparity_steps import disparity_steps, weighted_median
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Ints, MotionEstimate, StereoTracks

MIN_MATCHES = 8
"""A frame with fewer matches does not count."""
MIN_FRAMES = 4
"""Frames on either side of a step."""
CLEAR = 5.0
"""A step or a delay is significant above this number of standard deviations;"""
CLEAR_TURN = 4.0
"""and a turn of the rows, which is 2.4 at most on undisturbed sequences, above this one."""
LEAST_SCATTER_PX = 0.02
"""Of the rows' offsets within a frame"""
MAX_STEP_PX = 0.3
"""Of the median row: several times what a frame's median scatters."""
MAX_TURN = 1e-3
"""Of the rows' inclination [rad]: 0.06 degrees."""
MAX_DELAY_S = 4e-3
"""Between the cameras; far above the jitter of a trigger."""
MIN_DELAY_PX = 0.03
"""What a delay must displace rows by, in the root mean square, beside what a calibration can explain; less is
within the accuracy of a feature, and any slowly turning target makes a delay of it."""
MAX_SIDEWAYS, CLEAR_SIDEWAYS = 2e-3, 5.5
"""Of the angle between the cameras [rad], and in standard deviations: undisturbed sequences show 0.1 degrees
at 4.6 sigma at most."""
EXCHANGED_SHARE = 0.7
"""Share of negative disparities in a pair whose images are exchanged."""


@dataclass(frozen=True)
class Step:
    """The difference between the values before and after one place."""

    place: int
    """Index of the first value after it"""
    size: float
    """Median after it minus median before it"""
    sigma: float


def rig_checks(
    context: RunContext, features: Sequence[StereoFeatures], tracks: StereoTracks, estimate: MotionEstimate
) -> list[Check]:
    """Whether the calibration, and the pairing of the images, hold throughout.

    features: those of the first method, one a frame. Where range images take the place of a second camera,
    none of the checks is possible: its rows are missing, and its disparities are no angles.
    """
    lines = row_lines(features)
    return [
        _exchanged(context, features),
        _row_step(context, lines),
        _row_turn(context, lines),
        _late(context, features, estimate),
        _knocked_sideways(context, tracks, estimate),
    ]


def _exchanged(context: RunContext, features: Sequence[StereoFeatures]) -> Check:
    check = Check(name="pairs with negative disparities", limit=0.0, unit="pairs")
    limit = context.rig.disparity_offset_px
    judged = [
        (k, float(np.mean(each.rows.disparity_px < limit)))
        for k, each in enumerate(features)
        if each.rows is not None and len(each.rows.offset_px) >= MIN_MATCHES
    ]
    if not judged:
        return check
    negative = [k for k, share in judged if share > EXCHANGED_SHARE]
    first_s = context.time_s[negative[0]] if negative else 0.0
    return check.judged(
        len(negative),
        f"the images of {len(negative)} of {len(features)} pairs are exchanged, left for right (first at "
        f"{first_s:g} s): points would be behind the cameras; correct data.csv",
    )


@dataclass(frozen=True)
class RowLines:
    """How much lower the right image is in each frame, as a line along the rows."""

    middle_px: Array
    """(F,) at the middle of the frame's matches; NaN with too few"""
    slope: Array
    """(F,)"""
    sigma_middle_px: Array
    sigma_slope: Array


def row_lines(features: Sequence[StereoFeatures]) -> RowLines:
    """By least squares, twice more without outliers."""
    out = np.full((4, len(features)), np.nan)
    for k, each in enumerate(features):
        if each.rows is None or len(each.rows.offset_px) < MIN_MATCHES:
            continue
        y, x = each.rows.offset_px, each.rows.uv_px[:, 0] - np.mean(each.rows.uv_px[:, 0])
        A, line = np.column_stack([np.ones(len(x)), x]), np.array([np.median(y), 0.0])
        used = np.ones(len(x), dtype=np.bool_)
        for _ in range(3):
            residual = np.abs(y - A @ line)
            good = residual <= 3.0 * max(1.4826 * float(np.median(residual)), LEAST_SCATTER_PX)
            if good.sum() < MIN_MATCHES or np.ptp(x[good]) < MIN_MATCHES:
                break
            used, line = good, np.linalg.lstsq(A[good], y[good])[0]
        scatter = max(float(np.std((y - A @ line)[used])), LEAST_SCATTER_PX)
        out[:2, k] = line
        out[2:, k] = scatter * np.sqrt(np.diagonal(np.linalg.pinv(A[used].T @ A[used])))
    return RowLines(*out)


def _row_step(context: RunContext, lines: RowLines) -> Check:
    check = Check(name="rows of left and right image: step", limit=MAX_STEP_PX, unit="px")
    step = largest_step(lines.middle_px, lines.sigma_middle_px)
    if step is None:
        return check
    degrees = np.rad2deg(abs(step.size) / context.rig.focal_px)
    return check.judged(
        abs(step.size),
        f"the rows of the two images differ by {step.size:+.2f} px more from {context.time_s[step.place]:g} "
        f"s on, as if one camera had turned by {degrees:.2f} deg: the calibration does not hold throughout",
        max(MAX_STEP_PX, CLEAR * step.sigma),
    )


def _row_turn(context: RunContext, lines: RowLines) -> Check:
    check = Check(name="rows of left and right image: turn", limit=np.rad2deg(MAX_TURN), unit="deg")
    turn = largest_step(lines.slope, lines.sigma_slope)
    if turn is None:
        return check
    size, limit = np.rad2deg([abs(turn.size), max(MAX_TURN, CLEAR_TURN * turn.sigma)])
    return check.judged(
        size,
        f"the rows of the two images are inclined by {size:.2f} deg more from "
        f"{context.time_s[turn.place]:g} s on, as if one camera had turned about its axis: the calibration "
        "does not hold throughout",
        limit,
    )


def largest_step(values: Array, sigma: Array) -> Step | None:
    """The step whose two weighted medians fit values (n,) best, by absolute residuals in their sigmas (n,).

    NaN do not count; None where there are too few. The sigma is that of a difference of medians.
    """
    known = np.flatnonzero(np.isfinite(values))
    v, s = values[known], sigma[known]
    best, least = None, np.inf
    for n in range(MIN_FRAMES, len(known) - MIN_FRAMES + 1):
        medians = weighted_median(v[:n], s[:n]), weighted_median(v[n:], s[n:])
        residuals = np.abs(v - np.repeat(medians, (n, len(known) - n))) / s
        if residuals.sum() < least:
            least = float(residuals.sum())
            sides = (slice(None, n), slice(n, None))
            sigmas = [_sigma_of_median(residuals[side], s[side], residuals) for side in sides]
            best = Step(int(known[n]), medians[1] - medians[0], float(np.linalg.norm(sigmas)))
    return best


def _sigma_of_median(residuals: Array, sigma: Array, all_residuals: Array) -> float:
    """By the sigmas, or the scatter where it is larger; a few values may agree by chance, so at least that of
    all."""
    scatter = max(1.4826 * float(max(np.median(residuals), np.median(all_residuals))), 1.0)
    return 1.25 * scatter / float(np.sqrt(np.sum(1.0 / sigma**2)))


def _late(context: RunContext, features: Sequence[StereoFeatures], estimate: MotionEstimate) -> Check:
    check = Check(name="delay between the cameras", limit=1e3 * MAX_DELAY_S, unit="ms")
    found = camera_delay(context, features, estimate)
    if found is None:
        return check
    size, late = 1e3 * abs(found[0]), "late" if found[0] > 0 else "early"
    return check.judged(
        size,
        f"the right camera's images are {size:.0f} ms {late} (sigma {1e3 * found[1]:.1f} ms): the rows of "
        "the two images differ where the target moves, and distances and shape are wrong accordingly",
        1e3 * found.limit_s,
    )


class CameraDelay(NamedTuple):
    """Time of the right camera minus that of the left one."""

    seconds: float
    sigma_s: float
    speed_px_s: float
    """Scatter of the rows' velocities beside what a calibration can explain"""

    @property
    def limit_s(self) -> float:
        """A delay beyond it is a fault."""
        least_s = MIN_DELAY_PX / max(self.speed_px_s, 1e-9)
        return max(MAX_DELAY_S, CLEAR * self.sigma_s, least_s)


def camera_delay(
    context: RunContext, features: Sequence[StereoFeatures], estimate: MotionEstimate
) -> CameraDelay | None:
    """Time of the right camera minus that of the left one; None: nothing shows it.

    Least squares of the row offsets on the rows' velocities, which follow from the estimated motion. What an
    imperfect calibration explains is left out: offsets that depend on the place in the image, to second
    order, and on the disparity. The sigma treats each frame as one observation.
    """
    speed, offset, frame, place = [], [], [], []
    for k, each in enumerate(features):
        rows = each.rows
        if rows is None or len(rows.offset_px) < MIN_MATCHES:
            continue
        ahead = rows.disparity_px - context.rig.disparity_offset_px > 1.0
        uvd = np.column_stack([rows.uv_px, rows.disparity_px])[ahead]
        speed.append(_row_velocity(context, context.rig.triangulate(uvd), estimate, k))
        offset.append(rows.offset_px[ahead])
        frame.append(np.full(int(ahead.sum()), k))
        place.append(uvd)
    if not speed:
        return None
    return delay_by_rows(
        np.concatenate(speed), np.concatenate(offset), np.concatenate(frame), np.concatenate(place)
    )


def delay_by_rows(speed: Array, offset_px: Array, frame: Ints, uvd_px: Array) -> CameraDelay | None:
    """The delay, by offsets (n,) of rows and velocities (n,) along their order [px/s].

    frame (n,): what each is from; uvd_px (n, 3): where it is. None: too few, or the velocities hide it.
    """
    x, y, of = speed, offset_px, frame
    known = _calibration_terms(uvd_px)
    good = np.ones(len(x), dtype=np.bool_)
    for _ in range(4):
        if good.sum() < 10 * MIN_MATCHES:
            return None
        x0, y0 = (z - known @ np.linalg.lstsq(known[good], z[good])[0] for z in (x, y))
        if float(np.std(x0[good])) < 1e-3 * float(np.std(x[good])) + 1e-9:
            return None
        slope = float(np.sum(x0[good] * y0[good]) / np.sum(x0[good] ** 2))
        residual = y0 - slope * x0
        spread = 1.4826 * float(np.median(np.abs(residual[good])))
        good = np.abs(residual) < 3.0 * max(spread, 0.02)
    by_frame = np.bincount(of[good], x0[good] * residual[good])
    sigma_s = float(np.sqrt(np.sum(by_frame**2)) / np.sum(x0[good] ** 2))
    return CameraDelay(-slope, sigma_s, float(np.std(x0[good])))


def _calibration_terms(uvd_px: Array) -> Array:
    """Terms (n, 7) of the row offset that a wrong calibration causes at points (n, 3)."""
    scaled = (uvd_px - uvd_px.mean(axis=0)) / np.maximum(uvd_px.std(axis=0), 1e-9)
    u, v, d = scaled.T
    return np.column_stack([np.ones(len(u)), u, v, d, u * u, u * v, v * v])


def _row_velocity(context: RunContext, p_R: Array, estimate: MotionEstimate, k: int) -> Array:
    """Velocity (n,) along the rows' order [px/s] of points (n, 3) of the target, in the left image."""
    X_NR = context.X_NR
    p_N = transform_points(X_NR[k], p_R)
    v_N = estimate.v_N[k] + np.cross(estimate.R_NP[k] @ estimate.w_P[k], p_N - estimate.r_N[k])
    a, b = max(k - 1, 0), min(k + 1, len(X_NR) - 1)
    between, seconds = inverse_pose(X_NR[a]) @ X_NR[b], context.time_s[b] - context.time_s[a]
    camera_w, camera_v = log_so3(between[:3, :3]) / seconds, between[:3, 3] / seconds
    v_R = v_N @ X_NR[k][:3, :3] - camera_v - np.cross(camera_w, p_R)
    return np.asarray(context.rig.focal_px * (v_R[:, 1] - v_R[:, 2] * p_R[:, 1] / p_R[:, 2]) / p_R[:, 2])


def _knocked_sideways(context: RunContext, tracks: StereoTracks, estimate: MotionEstimate) -> Check:
    check = Check(name="disparities: step", limit=MAX_SIDEWAYS * context.rig.focal_px, unit="px")
    if context.sequence.has_ranges:
        return check
    noise = estimate.noise
    step_px, sigma_px = disparity_steps(tracks, (noise.pixel_sigma_px, noise.disparity_sigma_px))
    limit_px = np.maximum(MAX_SIDEWAYS * context.rig.focal_px, CLEAR_SIDEWAYS * sigma_px)
    excess = np.abs(step_px) / limit_px
    if not np.isfinite(excess).any():
        return check
    place = int(np.nanargmax(excess))
    degrees = np.rad2deg(abs(step_px[place]) / context.rig.focal_px)
    return check.judged(
        abs(step_px[place]),
        f"from {context.time_s[place + 1]:g} s on all disparities are {step_px[place]:+.2f} px different, "
        f"as if one camera had turned sideways by {degrees:.2f} deg: the calibration does not hold "
        "throughout",
        limit_px[place],
    )
