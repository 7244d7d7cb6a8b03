"""Whether the images are those of the rig that the calibration describes: signs that need no truth.

A wrong rig moves the target as a whole, and the residuals of the motion hardly show it. The rows of both
images do: matches that ignore the epipolar constraint (``frontend/features/epipolar_search``). Rows that
differ from some time on: one camera was knocked. Rows that differ with the speed at which the image moves:
the cameras look at different times. Disparities below zero: the images of the pair are exchanged.

Sideways, a knock changes disparities alone. Then everything is nearer and smaller, or farther and larger,
from some time on: what frames before and after it share does not fit together (``disparity_steps``).

What no image can show is in docs/trust.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from polhode.frontend.features.epipolar_search import RowOffsets
from polhode.frontend.features.stereo import StereoFeatures
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose, log_so3, transform_points
from polhode.pipeline.checks.data_checks.disparity_steps import disparity_steps, weighted_median
from polhode.pipeline.context import RunContext
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, make_check
from polhode.run_directory.summary_schema import Check

MIN_MATCHES = 8
"""A frame with fewer matches does not count."""
MIN_STRETCHES = 6
"""Of frames, of which the scatter of a delay is taken."""
MIN_FRAMES = 4
"""Frames on either side of a step."""
CLEAR_SIGMAS = 5.0
"""A step of the rows or of the roll, or a delay, is significant above this number of standard deviations."""
LEAST_PX, OF_VIEW_PX, VIEW_RAD = 0.1, 0.25, 0.5
"""Rows that a delay must displace: what the distortion of a good calibration may leave, and what matches on a
shaded surface differ by with the direction of a camera, alike until the target has turned by VIEW_RAD."""
MAX_ALIKE = 0.9
"""Largest correlation of successive frames that is believed"""
MIN_SCATTER_PX = 0.02
"""Of the rows' offsets within a frame"""
EXCHANGED_SHARE = 0.7
"""Share of negative disparities in a pair whose images are exchanged."""

Matches = Sequence[RowOffsets | None]
"""Matches across rows of each frame; None: too few"""


def rig_checks(
    context: RunContext, features: Sequence[StereoFeatures], tracks: StereoTracks, estimate: MotionEstimate
) -> list[Check]:
    """Whether the calibration, and the pairing of the images, hold throughout.

    features: those of the first method, one a frame. Where range images take the place of a second camera,
    none of the checks is possible: its rows are missing, and its disparities are no angles.
    """
    rig, time_s, focal_px = context.rig, context.time_s, context.rig.focal_px
    matches = [
        each.rows if each.rows is not None and len(each.rows.offset_px) >= MIN_MATCHES else None
        for each in features
    ]
    behind = np.array([
        np.nan if rows is None else np.mean(rows.disparity_px < rig.disparity_offset_px) for rows in matches
    ])  # fmt: skip
    exchanged = np.flatnonzero(behind > EXCHANGED_SHARE)
    checks = [
        make_check(
            "exchanged images",
            None if np.isnan(behind).all() else len(exchanged),
            pairs=len(matches),
            first_s=time_s[exchanged[0]] if len(exchanged) else 0.0,
        )
    ]
    middle_px, slope, sigma_middle_px, sigma_slope = row_lines(matches)
    for key, step, unit in (
        ("step of rows", largest_step(middle_px, sigma_middle_px), 1.0),
        ("step of roll", largest_step(slope, sigma_slope), np.rad2deg(1.0)),
    ):
        if step is None:
            checks.append(make_check(key, None))
            continue
        limit = max(CHECK_TABLE[key].limit or 0.0, unit * (CLEAR_SIGMAS * step.sigma))
        degrees = np.rad2deg(abs(step.size) / focal_px)
        facts = {"step_px": step.size, "from_s": time_s[step.place], "degrees": degrees}
        checks.append(make_check(key, unit * abs(step.size), limit, **facts))
    delay = camera_delay(context, matches, estimate)
    if delay is None:
        checks.append(make_check("camera delay", None))
    else:
        late, size_ms = "late" if delay.seconds > 0 else "early", 1e3 * abs(delay.seconds)
        facts = {"late": late, "sigma_ms": 1e3 * delay.sigma_s}
        checks.append(make_check("camera delay", size_ms, 1e3 * delay.limit_s, **facts))
    # of the angle between the cameras; undisturbed sequences show 0.1 degrees at 4.6 sigma at most
    key, noise, least_px = "step of disparities", estimate.noise, 2e-3 * focal_px
    if not context.sequence.has_ranges:
        step_px, sigma_px = disparity_steps(tracks, (noise.pixel_sigma_px, noise.disparity_sigma_px))
        limit_px = np.maximum(least_px, 5.5 * sigma_px)
        excess = np.abs(step_px) / limit_px
        if np.isfinite(excess).any():
            place = int(np.nanargmax(excess))
            degrees = np.rad2deg(abs(step_px[place]) / focal_px)
            facts = {"step_px": step_px[place], "from_s": time_s[place + 1], "degrees": degrees}
            return [*checks, make_check(key, abs(step_px[place]), limit_px[place], **facts)]
    return [*checks, make_check(key, None, least_px)]


def row_lines(matches: Matches) -> Array:
    """(4, F) how much lower the right image is in each frame, as a line along the rows: offset [px] at the
    middle of the frame's matches and slope, and the sigmas of both; NaN with too few.

    By least squares, twice more without outliers.
    """
    out = np.full((4, len(matches)), np.nan)
    for k, rows in enumerate(matches):
        if rows is None:
            continue
        y, x = rows.offset_px, rows.uv_px[:, 0] - np.mean(rows.uv_px[:, 0])
        A, line = np.column_stack([np.ones(len(x)), x]), np.array([np.median(y), 0.0])
        used = np.ones(len(x), dtype=np.bool_)
        for _ in range(3):
            residual = np.abs(y - A @ line)
            good = residual <= 3.0 * max(1.4826 * float(np.median(residual)), MIN_SCATTER_PX)
            if good.sum() < MIN_MATCHES or np.ptp(x[good]) < MIN_MATCHES:
                break
            used, line = good, np.linalg.lstsq(A[good], y[good])[0]
        scatter = max(float(np.std((y - A @ line)[used])), MIN_SCATTER_PX)
        out[:2, k] = line
        out[2:, k] = scatter * np.sqrt(np.diagonal(np.linalg.pinv(A[used].T @ A[used])))
    return out


class Step(NamedTuple):
    """The difference between the medians of the values before and after one place."""

    place: int
    """Index of the first value after it"""
    size: float
    sigma: float


def largest_step(values: Array, sigma: Array) -> Step | None:
    """The step whose two weighted medians fit values (n,) best, by absolute residuals in their sigmas (n,).

    NaN do not count; None where there are too few. The sigma is that of a difference of medians, by the
    sigmas or the scatter where it is larger; a few values may agree by chance, so at least that of all.
    Successive frames show the same landmarks: the correlation of their values makes them fewer, as of a
    first-order autoregressive process.
    """
    known = np.flatnonzero(np.isfinite(values))
    v, s = values[known], sigma[known]
    best, least = None, np.inf
    for n in range(MIN_FRAMES, len(known) - MIN_FRAMES + 1):
        medians = weighted_median(v[:n], s[:n]), weighted_median(v[n:], s[n:])
        off = (v - np.repeat(medians, (n, len(known) - n))) / s
        residuals = np.abs(off)
        if residuals.sum() < least:
            least, sigmas = float(residuals.sum()), []
            alike = _correlation_of_successive(off)
            fewer = np.sqrt((1.0 + alike) / (1.0 - alike))
            for side in (slice(None, n), slice(n, None)):
                scatter = 1.4826 * float(max(np.median(residuals[side]), np.median(residuals)))
                sigmas.append(1.25 * max(scatter, 1.0) / float(np.sqrt(np.sum(1.0 / s[side] ** 2))))
            best = Step(int(known[n]), medians[1] - medians[0], float(fewer * np.linalg.norm(sigmas)))
    return best


def _correlation_of_successive(residuals: Array) -> float:
    """Of residuals (n,) from 0 to MAX_ALIKE; outliers count like three times the median."""
    limit = 3.0 * float(np.median(np.abs(residuals))) + 1e-12
    clipped = np.clip(residuals, -limit, limit)
    found = float(clipped[1:] @ clipped[:-1] / max(float(clipped @ clipped), 1e-12))
    return min(max(found, 0.0), MAX_ALIKE)


@dataclass(frozen=True)
class CameraDelay:
    """Time of the right camera minus that of the left one."""

    seconds: float
    sigma_s: float
    speed_px_s: float
    """Scatter of the rows' velocities beside what a calibration can explain"""
    turn_rad: float = np.inf
    """By which the target has turned"""

    @property
    def limit_s(self) -> float:
        """A delay beyond it is a fault.

        A slowly turning target makes a long delay of rows that differ for another reason.
        """
        trigger_s = 1e-3 * (CHECK_TABLE["camera delay"].limit or 0.0)
        displaced_px = max(LEAST_PX, OF_VIEW_PX / sqrt(max(self.turn_rad / VIEW_RAD, 1.0)))
        return max(trigger_s, CLEAR_SIGMAS * self.sigma_s, displaced_px / max(self.speed_px_s, 1e-9))


class RowSpeeds(NamedTuple):
    """Row offsets of n points whose images move."""

    speed_px_s: Array
    """(n,) velocity along the rows' order in the left image"""
    offset_px: Array
    """(n,)"""
    frame: Ints
    """(n,) what each is from"""
    uvd_px: Array
    """(n, 3) where it is"""


def camera_delay(context: RunContext, matches: Matches, estimate: MotionEstimate) -> CameraDelay | None:
    """Time of the right camera minus that of the left one; None: nothing shows it.

    The velocities of the points follow from the estimated motion.
    """
    X_NR, time_s = context.X_NR, context.time_s
    found = []
    for k, rows in enumerate(matches):
        if rows is None:
            continue

        def velocity(p_R: Array, k: int = k) -> Array:
            """Of points (n, 3) of the target, relative to the camera, along its axes [m/s]."""
            p_N = transform_points(X_NR[k], p_R)
            v_N = estimate.v_N[k] + np.cross(estimate.R_NP[k] @ estimate.w_P[k], p_N - estimate.r_N[k])
            a, b = max(k - 1, 0), min(k + 1, len(X_NR) - 1)
            between, seconds = inverse_pose(X_NR[a]) @ X_NR[b], time_s[b] - time_s[a]
            camera_w, camera_v = log_so3(between[:3, :3]) / seconds, between[:3, 3] / seconds
            return np.asarray(v_N @ X_NR[k][:3, :3] - camera_v - np.cross(camera_w, p_R))

        found.append(row_speeds(rows, context.rig, k, velocity))
    delay = delay_by_rows(found)
    w_rad_s = np.linalg.norm(estimate.w_P, axis=1)
    return None if delay is None else replace(delay, turn_rad=float(np.trapezoid(w_rad_s, time_s)))


def row_speeds(
    rows: RowOffsets, rig: RectifiedRig, frame: int, velocity: Callable[[Array], Array]
) -> RowSpeeds:
    """Of the matches in front of the camera; ``velocity`` (n, 3) of points (n, 3) in the camera [m/s]."""
    ahead = rows.disparity_px - rig.disparity_offset_px > 1.0
    uvd = np.column_stack([rows.uv_px, rows.disparity_px])[ahead]
    p = rig.triangulate(uvd)
    v = velocity(p)
    speed = rig.focal_px * (v[:, 1] - v[:, 2] * p[:, 1] / p[:, 2]) / p[:, 2]
    return RowSpeeds(np.asarray(speed), rows.offset_px[ahead], np.full(len(uvd), frame), uvd)


def delay_by_rows(parts: Sequence[RowSpeeds]) -> CameraDelay | None:
    """The delay, by least squares of row offsets on velocities; None: too few, or these hide it.

    What an imperfect calibration explains is left out: offsets that depend on the place in the image, to
    second order, and on the disparity. The sigma treats stretches of frames as one observation each, of the
    length that makes it largest: neighbouring frames show the same landmarks.
    """
    if not parts:
        return None
    x, y, frame, uvd_px = (np.concatenate(each) for each in zip(*parts, strict=True))
    u, v, d = ((uvd_px - uvd_px.mean(axis=0)) / np.maximum(uvd_px.std(axis=0), 1e-9)).T
    known = np.column_stack([np.ones(len(u)), u, v, d, u * u, u * v, v * v])
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
    by_frame = np.bincount(frame[good], x0[good] * residual[good])
    lengths = 2 ** np.arange(int(np.log2(max(len(by_frame) // MIN_STRETCHES, 1))) + 1)
    sums = [np.add.reduceat(by_frame, np.arange(0, len(by_frame), length)) for length in lengths]
    sigma_s = float(max(np.sqrt(np.sum(each**2)) for each in sums) / np.sum(x0[good] ** 2))
    return CameraDelay(-slope, sigma_s, float(np.std(x0[good])))
