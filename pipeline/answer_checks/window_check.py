"""Whether the causal estimate ends where the smoothed one does: two ways of solving one problem.

At the last frame both know all measurements; the sliding window has linearized the older ones early, and has
found its own outliers. They differ by less than the standard deviations, the larger ones: those of the window
take the errors of features as independent.
"""

import numpy as np

from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import MotionEstimate, OnlineEstimate

MAX_SIGMAS = 4.0
"""Of sixteen scenes of configs/scenes the worst component is off by 1.9 sigma of the causal estimate."""


def window_check(online: OnlineEstimate | None, estimate: MotionEstimate) -> Check:
    """The worst component of position, velocity and rate of the last frame; None: no window."""
    check = Check(name="end of the causal estimate, against the smoothed one", limit=MAX_SIGMAS, unit="sigma")
    if online is None:
        return check
    apart = np.concatenate([
        online.r_N[-1] - estimate.r_N[-1],
        online.v_N[-1] - estimate.v_N[-1],
        online.w_P[-1] - estimate.w_P[-1],
    ])  # fmt: skip
    rows = np.r_[0:6, 9:12]
    own, smoothed = (np.diagonal(each.covariance[-1])[rows] for each in (online, estimate))
    known = np.isfinite(own) & np.isfinite(smoothed) & (own > 0.0)
    if not known.any():
        return check
    size = float(np.max(np.abs(apart[known]) / np.sqrt(np.maximum(own, smoothed)[known])))
    return check.judged(
        size,
        f"the causal estimate ends {size:.1f} sigma away from the smoothed one: one of the two has not found "
        "the motion",
    )
