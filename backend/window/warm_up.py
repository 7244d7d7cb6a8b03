"""Compile what the window needs before the first frame comes: otherwise it would wait for seconds there."""

import numpy as np

from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.frame import FrameMeasurements
from polhode.camera import RectifiedRig
from polhode.config.backend_settings import Backend
from polhode.lie import exp_so3, make_pose, transform_points

FRAMES = 24
"""Noise levels are estimated and other inertias tried after 6, 12 and 24 frames."""
LANDMARKS = 40
STEP_NS = 500_000_000


def warm_up(rig: RectifiedRig, config: Backend) -> None:
    """Let a window of its own see a body that turns; what is compiled stays for all others."""
    rng, window = np.random.default_rng(0), SlidingWindow(rig, config)
    p_G = rng.uniform(-0.1, 0.1, (LANDMARKS, 3))
    sigma = np.full((LANDMARKS, 3), 0.3)
    for k in range(FRAMES):
        X_RG = make_pose(exp_so3([0.05 * k, 0.3 * k, 0.0]), [0.0, 0.0, 1.0])
        uvd = rig.project(transform_points(X_RG, p_G)) + sigma * rng.standard_normal((LANDMARKS, 3))
        names = np.arange(LANDMARKS, dtype=np.int64)
        window.add(FrameMeasurements(k * STEP_NS, np.eye(4), names, uvd, sigma))
