"""What the search around a predicted pose adds to blind matching: the rotation between two frames.

All features of the first frame are the map; the second frame is looked for where a wrong prediction puts it.
"""

import numpy as np

from benchmarks.frontend.scenes import UnseenScene
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.tracks.guided import reconnect
from polhode.frontend.tracks.tracks import Association
from polhode.lie import Array, exp_so3, inverse_pose, log_so3
from polhode.records import InitialMotion

PREDICTED_DEG = 3.0
"""Error of the prediction about each axis, standard deviation [deg]: 5 degrees in all."""
PREDICTED_SHARE = 0.01
"""Error of its distance, and half of it sideways, as shares of the distance."""
VIEW_DEG = 75.0
"""``frontend.guided.max_view_angle_deg`` here: a single view is compared with, 60 degrees away."""


def guided_error_deg(
    scene: UnseenScene, frames: list[StereoFeatures], i: int, j: int, config: Frontend
) -> float | None:
    """Error of the rotation between frames i and j found from a prediction, None where it is not found."""
    a, b = frames[i], frames[j]
    X_RG = np.stack([inverse_pose(scene.X_GR[i]), _predicted(scene, i, j)])
    guided = config.guided.model_copy(update={"max_view_angle_deg": VIEW_DEG})
    known = Association((np.arange(len(a)), np.full(len(b), -1, dtype=np.int64)))
    found = reconnect(
        [a, b], known, InitialMotion(X_RG, np.array([True, False])), scene.rig, guided, 0
    ).motion
    if not found.connected[1]:
        return None
    turn = found.X_RG[1, :3, :3].T @ inverse_pose(scene.X_GR[j])[:3, :3]
    return float(np.rad2deg(np.linalg.norm(log_so3(turn))))


def _predicted(scene: UnseenScene, i: int, j: int) -> Array:
    """True pose of frame j, off by the errors above."""
    rng = np.random.default_rng([i, j])
    X_RG = inverse_pose(scene.X_GR[j])
    X_RG[:3, :3] = X_RG[:3, :3] @ exp_so3(np.deg2rad(PREDICTED_DEG) * rng.normal(size=3))
    X_RG[:3, 3] *= 1.0 + PREDICTED_SHARE * rng.normal()
    X_RG[:3, 3] += 0.5 * PREDICTED_SHARE * X_RG[2, 3] * rng.normal(size=3)
    return np.asarray(X_RG)
