"""Whether the disturbances that were found move the target as a push does.

A force in one direction, at any time within an interval, displaces a body by at most half of the change of
velocity times the interval, beside the mean of the velocities before and after it. What displaces it
further and leaves the velocity as it was is no push: a camera or the inspector's pose that jumped, or another
point of the body that is taken for its centre of mass from then on.
"""

import numpy as np

from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Impulse, MotionEstimate

MAX_SIGMAS = 4.0
"""Thruster bursts have up to 0.9; of 35 good runs with a push, those whose clock did not jump up to 3.1."""


def push_check(estimate: MotionEstimate) -> Check:
    """The largest excess over what a push can do, in its standard deviations; not possible without pushes."""
    check = Check(name="displacement that no push explains", limit=MAX_SIGMAS, unit="sigma")
    impulses = estimate.disturbances.impulses if estimate.disturbances is not None else ()
    found = [(*excess, push) for push in impulses if (excess := _excess(estimate, push)) is not None]
    if not found:
        return check
    sigmas, excess_m, push = max(found, key=lambda each: each[0])
    start_s, end_s = (1e-9 * (at - int(estimate.timestamps_ns[0])) for at in (push.start_ns, push.end_ns))
    return check.judged(
        max(sigmas, 0.0),
        f"between {start_s:.1f} s and {end_s:.1f} s the target is displaced by {1e3 * excess_m:.2g} mm more "
        f"than its change of velocity explains ({sigmas:.1f} sigma): no push does this; a camera or the "
        "inspector's pose may have jumped, or a part left the target",
    )


def _excess(estimate: MotionEstimate, push: Impulse) -> tuple[float, float] | None:
    """Excess in sigmas and in metres; None: position or velocity are undetermined."""
    stamps, last = estimate.timestamps_ns, len(estimate.timestamps_ns) - 1
    a, b = (min(int(np.searchsorted(stamps, at)), last) for at in (push.start_ns, push.end_ns))
    seconds = 1e-9 * float(stamps[b] - stamps[a])
    mean_v, change_v = 0.5 * (estimate.v_N[a] + estimate.v_N[b]), estimate.v_N[b] - estimate.v_N[a]
    beside = estimate.r_N[b] - estimate.r_N[a] - seconds * mean_v
    length = float(np.linalg.norm(beside))
    P_a, P_b = estimate.covariance[a], estimate.covariance[b]
    covariance = P_a[:3, :3] + P_b[:3, :3] + 0.25 * seconds**2 * (P_a[3:6, 3:6] + P_b[3:6, 3:6])
    if not (np.isfinite(covariance).all() and length > 0.0):
        return None
    along = beside / length
    excess_m = length - 0.5 * float(np.linalg.norm(change_v)) * seconds
    return excess_m / float(np.sqrt(along @ covariance @ along)), excess_m
