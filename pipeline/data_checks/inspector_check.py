"""Whether the poses that the inspector reports agree with the images: right ones make the motion smoother.

The images show the target in the camera; the reported poses carry it into N, where it moves smoothly. If the
rotation is rougher in N than it is in the camera, the poses add the roughness: they are wrong by more than
they state.
"""

import numpy as np

from polhode.lie import Array, inverse_pose, log_so3
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Bools

MAX_RATIO = 2.0
"""Of the roughness in N over that in the camera: right poses of a camera that moves make it smaller."""
CLEAR = 4.0
"""Times the roughness that the stated standard deviation causes."""
MIN_ERROR_DEG = 0.1
"""Of a pose, as the roughness in N shows it."""
_PER_SIGMA = float(np.sqrt(15.0))
"""Root mean square of the roughness over the standard deviation of a pose's attitude about each axis: the
coefficients of four successive poses are -1/2, 3/2, -3/2, 1/2."""
MIN_STEPS = 8


def inspector_check(X_NR: Array, X_NG: Array, seen: Bools, sigma_theta_rad: float) -> Check:
    """Whether the reported poses agree with the images; not possible for a camera that stays at one pose.

    X_NR (F, 4, 4): camera as reported; X_NG (F, 4, 4): target by these; seen (F,): with observations.
    """
    check = Check(name="scatter of the inspector's attitudes", limit=MIN_ERROR_DEG, unit="deg")
    if np.ptp(X_NR, axis=0).max() == 0.0:
        return check
    X_RG = inverse_pose(X_NR) @ X_NG
    in_N, in_camera = roughness(X_NG[:, :3, :3], seen), roughness(X_RG[:, :3, :3], seen)
    if min(len(in_N), len(in_camera)) < MIN_STEPS:
        return check
    error_deg, camera_deg = (
        float(np.rad2deg(np.sqrt(np.mean(each**2)))) / _PER_SIGMA for each in (in_N, in_camera)
    )
    stated_deg = float(np.rad2deg(sigma_theta_rad))
    return check.judged(
        error_deg,
        "the reported poses of the inspector contradict the images: their attitudes scatter by about "
        f"{error_deg:.2f} deg, where {stated_deg:.2f} deg is stated, and the target turns more smoothly "
        "without them; check inspector0/",
        max(MIN_ERROR_DEG, MAX_RATIO * camera_deg, CLEAR * stated_deg),
    )


def roughness(R: Array, seen: Bools) -> Array:
    """(n,) length of each turn (F, 3, 3) minus the mean of its neighbours [rad], where four frames are seen.

    Turns are along the axes of the frame that stays.
    """
    turns = log_so3(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    whole = seen[:-3] & seen[1:-2] & seen[2:-1] & seen[3:]
    return np.asarray(np.linalg.norm(turns[1:-1] - 0.5 * (turns[:-2] + turns[2:]), axis=1)[whole])
