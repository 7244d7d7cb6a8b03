"""How far the target rotates between frames, whether its features are found again, delay of the cameras."""

import numpy as np

from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3
from polhode.pipeline.checkout.check_table import limit_of, make_check
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.sample import Sample
from polhode.pipeline.checks.data_checks.rig_check import MIN_MATCHES, delay_by_rows, row_speeds
from polhode.records.dataset import StereoSequence

CLEAR_DELAY = 8.0
"""In its standard deviations, which few pairs underestimate: 6.4 at most without a delay."""


def motion_checks(sequence: StereoSequence, sample: Sample, rig: RectifiedRig) -> list[CheckoutCheck]:
    """Number of features, rotation between frames, matches, share that matches; of two cameras the delay
    between them."""
    # of successive pairs: interval, rotation, matches that agree with it, displacement of the features
    t, rows = (sequence.timestamps_ns - sequence.timestamps_ns[0]) * 1e-9, []
    for (i, j), link in zip(sample.successive, sample.links, strict=True):
        a, b = sample.pairs[i], sample.pairs[j]
        turn, moved, count = float("nan"), float("nan"), 0
        if link is not None:
            turn = float(np.rad2deg(np.linalg.norm(log_so3(link.X_RiRj[:3, :3]))))
            ends = [each.features.uvd_px[link.features[:, k], :2] for k, each in enumerate((a, b))]
            moved = float(np.median(np.linalg.norm(ends[1] - ends[0], axis=1)))
            count = len(link.features)
        rows.append((t[b.frame] - t[a.frame], turn, count, moved))
    interval_s, turn_deg, matches, moved_px = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    features = np.array([len(pair.features) for pair in sample.pairs])
    matched, ranges = np.isfinite(turn_deg), sequence.has_ranges
    finding = (
        f"{int(np.sum(features < MIN_INLIERS))} of {len(features)} examined {sample.noun} have fewer than "
        f"{MIN_INLIERS}; from {features.min()} to {features.max()}."
    )
    name = "median number of features with a range per image" if ranges else ""
    checks = [make_check("features", float(np.median(features)), finding, name=name)]
    if matched.any():
        turns, rate = turn_deg[matched], turn_deg[matched] / interval_s[matched]
        middle = float(np.median(turns))
        finding = (
            f"The target turns by {turns.min():.2g} to {turns.max():.2g} deg as the camera sees it, "
            f"{float(np.median(rate)):.3g} deg/s; its features move by {np.nanmedian(moved_px):.0f} px."
        )
        faster = max(middle / limit_of("rotation"), 1.0)
        advice = (
            f"Record at a frame rate {faster:.1f} times as high, or use every frame if some were left out."
        )
        checks.append(make_check("rotation", middle, finding, advice=advice))
    else:
        advice = "Record at a higher frame rate; if the target turns slowly, see the checks of the images."
        finding = "No two successive frames match."
        checks.append(make_check("rotation", None, finding, advice=advice))
    median, share, finding = None, None, f"No two examined {sample.noun} are successive."
    if len(matches):
        median, share = float(np.median(matches)), 100.0 * float(matched.mean())
        finding = f"From {matches.min():.0f} to {matches.max():.0f} matches agree with a rigid motion."
    name = "median number of matches between successive images" if ranges else ""
    checks.append(make_check("matches", median, finding, name=name))
    finding = f"{int(matched.sum())} of {len(matched)} examined pairs of successive frames match."
    checks.append(make_check("matched", share, finding, name=f"successive {sample.noun} that match"))
    return checks if ranges else [*checks, _delay(sequence, sample, rig)]


def _delay(sequence: StereoSequence, sample: Sample, rig: RectifiedRig) -> CheckoutCheck:
    """Time of the right camera minus that of the left one, as ``rig_check`` finds it.

    The velocities of the points follow from the relative poses of successive pairs, at least three with 20
    matches.
    """
    parts, links = [], 0
    for (i, j), link in zip(sample.successive, sample.links, strict=True):
        if link is None or len(link.features) < 20:
            continue
        links += 1
        start_ns, end_ns = sequence.timestamps_ns[[sample.pairs[k].frame for k in (i, j)]]
        w, v = twist(inverse_pose(link.X_RiRj), 1e-9 * float(end_ns - start_ns))

        def velocity(p_R: Array, w: Array = w, v: Array = v) -> Array:
            return np.asarray(np.cross(w, p_R) + v)

        for k in (int(i), int(j)):
            of_pair = row_speeds(sample.pairs[k].rows, rig, k, velocity)
            if len(of_pair.offset_px) >= MIN_MATCHES:
                parts.append(of_pair)
    found = None if links < 3 else delay_by_rows(parts)
    if found is None:
        finding = "The motion does not show it: too few matches, or none that moves across the rows."
        return make_check("delay", None, finding)
    size_ms, sigma_ms = 1e3 * abs(found.seconds), 1e3 * found.sigma_s
    finding = (
        f"By the rows of moving points the right image is {size_ms:.2g} ms "
        f"{'late' if found.seconds > 0.0 else 'early'} (sigma {sigma_ms:.2g} ms)."
    )
    limit_ms = 1e3 * max(CLEAR_DELAY * found.sigma_s, found.limit_s)
    return make_check("delay", size_ms, finding, limits=(limit_ms, None), sigma=sigma_ms)


def twist(X: Array, seconds: float) -> tuple[Array, Array]:
    """Angular velocity [rad/s], velocity at the origin [m/s] of the constant motion p -> X p, X (4, 4)."""
    theta = log_so3(X[:3, :3])
    angle = float(np.linalg.norm(theta))
    w = theta / seconds
    if angle < 1e-9:
        return w, X[:3, 3] / seconds
    K, half = hat(theta / angle), 0.5 * angle
    V_inverse = np.eye(3) - half * K + (1.0 - half / np.tan(half)) * (K @ K)
    return w, V_inverse @ X[:3, 3] / seconds
