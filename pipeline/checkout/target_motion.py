"""How far the target turns between frames, and whether its features are found again."""

from dataclasses import dataclass

import numpy as np

from polhode.camera import RectifiedRig
from polhode.dataset import StereoSequence
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.lie import Array, inverse_pose, log_so3
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.pipeline.checkout.sample import Sample
from polhode.pipeline.data_checks.rig_check import (
    MAX_DELAY_S,
    MIN_MATCHES,
    CameraDelay,
    delay_by_rows,
)

MAX_TURN_DEG, FAIL_TURN_DEG = 35.0, 60.0
"""Between successive frames. At 30 degrees RootSIFT finds the motion of four fifths of the lit pairs of
frames, at 60 degrees of three tenths, the features trained here of three quarters
(docs/frontend.md#results)."""
MIN_MATCHED, FAIL_MATCHED = 50.0, 20.0
"""Share of the successive pairs that match [%]."""
MIN_FEATURES, FAIL_FEATURES = 100.0, float(MIN_INLIERS)
"""Stereo features of the median pair."""
MIN_LINK = 20.0
"""Matches of the median successive pair, with RootSIFT: runs that were not solved had 6 and 8. Where there
are fewer, a run uses the features trained here as well, which match five times as many."""
DELAY_MATCHES, DELAY_LINKS = 20, 3
"""Matches of a successive pair, and number of such, from which a delay is stated."""
CLEAR_DELAY = 8.0
"""In its standard deviations, which few pairs underestimate: 6.4 at most without a delay."""


@dataclass(frozen=True)
class Turns:
    """The m successive pairs of the sample."""

    time_s: Array
    """(m,) between the two, since the first frame"""
    interval_s: Array
    """(m,)"""
    turn_deg: Array
    """(m,) NaN where they do not match"""
    matches: Array
    """(m,) that agree with the motion"""
    moved_px: Array
    """(m,) median displacement of the features in the image; NaN where they do not match"""


def turns_of(sequence: StereoSequence, sample: Sample) -> Turns:
    """By the relative poses of successive pairs."""
    t = (sequence.timestamps_ns - sequence.timestamps_ns[0]) * 1e-9
    rows = []
    for (i, j), link in zip(sample.successive, sample.links, strict=True):
        a, b = sample.pairs[i], sample.pairs[j]
        turn, moved, count = float("nan"), float("nan"), 0
        if link is not None:
            turn = float(np.rad2deg(np.linalg.norm(log_so3(link.X_RiRj[:3, :3]))))
            ends = [each.features.uvd_px[link.features[:, k], :2] for k, each in enumerate((a, b))]
            moved = float(np.median(np.linalg.norm(ends[1] - ends[0], axis=1)))
            count = len(link.features)
        rows.append((0.5 * (t[a.frame] + t[b.frame]), t[b.frame] - t[a.frame], turn, count, moved))
    return Turns(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)


def motion_checks(
    sequence: StereoSequence, sample: Sample, rig: RectifiedRig, turns: Turns
) -> list[CheckoutCheck]:
    """Number of features, turn between frames, matches, share that matches; of two cameras the delay between
    them."""
    noun = "images" if sequence.has_ranges else "pairs"
    delay = [] if sequence.has_ranges else [_delay(sequence, sample, rig)]
    return [_features(sample), _turn(turns), _matches(turns, noun), _matched(turns, noun), *delay]


def _features(sample: Sample) -> CheckoutCheck:
    count = np.array([len(pair.features) for pair in sample.pairs])
    few = int(np.sum(count < MIN_INLIERS))
    return judged(
        "motion",
        "features with a range, of the median image"
        if sample.has_ranges
        else "stereo features of the median pair",
        float(np.median(count)),
        "",
        MIN_FEATURES,
        fail_limit=FAIL_FEATURES,
        at_least=True,
        finding=f"{few} of {len(count)} examined {sample.noun} have fewer than {MIN_INLIERS}; from "
        f"{count.min()} to {count.max()}.",
        advice="Improve light, focus or distance; where the surface has no texture, the features trained "
        "here "
        "(frontend.features.method polhode) find more.",
    )


def _turn(turns: Turns) -> CheckoutCheck:
    name, known = "turn between successive frames", np.isfinite(turns.turn_deg)
    if not known.any():
        return judged(
            "motion",
            name,
            None,
            "deg",
            MAX_TURN_DEG,
            fail_limit=FAIL_TURN_DEG,
            not_possible="FAIL",
            finding="No two successive frames match.",
            advice="Record at a higher frame rate; if the target turns slowly, see the checks of the images.",
        )
    turn, rate = turns.turn_deg[known], turns.turn_deg[known] / turns.interval_s[known]
    factor = float(np.median(turn)) / MAX_TURN_DEG
    return judged(
        "motion",
        name,
        float(np.median(turn)),
        "deg",
        MAX_TURN_DEG,
        fail_limit=FAIL_TURN_DEG,
        finding=f"The target turns by {turn.min():.2g} to {turn.max():.2g} deg as the camera sees it, "
        f"{float(np.median(rate)):.3g} deg/s; its features move by {np.nanmedian(turns.moved_px):.0f} px.",
        advice=f"Record at a frame rate {max(factor, 1.0):.1f} times as high, or use every frame if some "
        "were left out.",
    )


def _matches(turns: Turns, noun: str) -> CheckoutCheck:
    count = turns.matches
    return judged(
        "motion",
        "matches of successive images, median"
        if noun == "images"
        else "matches of the median successive pair",
        float(np.median(count)) if len(count) else None,
        "",
        MIN_LINK,
        at_least=True,
        not_possible="WARN",
        finding=f"From {count.min():.0f} to {count.max():.0f} matches agree with a rigid motion."
        if len(count)
        else f"No two examined {noun} are successive.",
        advice="Record at a higher frame rate, or with softer light: shadows that move over the surface "
        "and large "
        "turns lose matches.",
    )


def _matched(turns: Turns, noun: str) -> CheckoutCheck:
    matched = np.isfinite(turns.turn_deg)
    return judged(
        "motion",
        f"successive {noun} that match",
        100.0 * float(matched.mean()) if len(matched) else None,
        "%",
        MIN_MATCHED,
        fail_limit=FAIL_MATCHED,
        at_least=True,
        not_possible="WARN",
        finding=f"{int(matched.sum())} of {len(matched)} examined pairs of successive frames match.",
        advice="Look at when they do not (checkout.html): in darkness and out of view nothing helps, else "
        "a higher "
        "frame rate or softer light.",
    )


def _delay(sequence: StereoSequence, sample: Sample, rig: RectifiedRig) -> CheckoutCheck:
    name = "delay between the cameras"
    found = camera_delay(sequence, sample, rig)
    if found is None:
        return judged(
            "time",
            name,
            None,
            "ms",
            1e3 * MAX_DELAY_S,
            advice="",
            finding="The motion does not show it: too few matches, or none that moves across the rows.",
        )
    size, late = 1e3 * abs(found[0]), "late" if found[0] > 0.0 else "early"
    return judged(
        "time",
        name,
        size,
        "ms",
        1e3 * max(CLEAR_DELAY * found.sigma_s, found.limit_s),
        sigma=1e3 * found[1],
        finding=f"By the rows of moving points the right image is {size:.2g} ms {late} (sigma "
        f"{1e3 * found[1]:.2g} ms).",
        advice="Trigger both cameras by one signal; distances are wrong where the target moves.",
    )


def camera_delay(sequence: StereoSequence, sample: Sample, rig: RectifiedRig) -> CameraDelay | None:
    """Time of the right camera minus that of the left one, as ``rig_check`` finds it.

    The velocities of the points follow from the relative poses of successive pairs.
    """
    parts: list[tuple[Array, Array, Array, Array]] = []
    links = 0
    for (i, j), link in zip(sample.successive, sample.links, strict=True):
        if link is None or len(link.features) < DELAY_MATCHES:
            continue
        links += 1
        start_ns, end_ns = sequence.timestamps_ns[[sample.pairs[k].frame for k in (i, j)]]
        w, v = twist(inverse_pose(link.X_RiRj), 1e-9 * float(end_ns - start_ns))
        for k in (int(i), int(j)):
            rows = sample.pairs[k].rows
            ahead = rows.disparity_px - rig.disparity_offset_px > 1.0
            if ahead.sum() < MIN_MATCHES:
                continue
            uvd = np.column_stack([rows.uv_px, rows.disparity_px])[ahead]
            p = rig.triangulate(uvd)
            v_R = np.cross(w, p) + v
            speed = rig.focal_px * (v_R[:, 1] - v_R[:, 2] * p[:, 1] / p[:, 2]) / p[:, 2]
            parts.append((speed, rows.offset_px[ahead], np.full(len(uvd), k), uvd))
    if links < DELAY_LINKS or not parts:
        return None
    speed, offset, pair, uvd = (np.concatenate(column) for column in zip(*parts, strict=True))
    return delay_by_rows(speed, offset, pair, uvd)


def twist(X: Array, seconds: float) -> tuple[Array, Array]:
    """Angular velocity [rad/s], velocity at the origin [m/s] of the constant motion p -> X p, X (4, 4)."""
    theta = log_so3(X[:3, :3])
    angle = float(np.linalg.norm(theta))
    w = theta / seconds
    if angle < 1e-9:
        return w, X[:3, 3] / seconds
    n = theta / angle
    K = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    half = 0.5 * angle
    V_inverse = np.eye(3) - half * K + (1.0 - half / np.tan(half)) * (K @ K)
    return w, V_inverse @ X[:3, 3] / seconds
