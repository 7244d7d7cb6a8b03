"""Motion of the inspector's left camera over time."""

import numpy as np

from polhode.config import scene as config
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, inverse_pose, make_pose


def camera_motion(scene: config.Scene) -> Array:
    """Poses X_NC (F, 4, 4) of the left camera at the frames."""
    inspector = scene.inspector
    t_s = scene.interval_s * np.arange(scene.frames)
    X_NC0 = make_pose(exp_so3(np.deg2rad(inspector.attitude_deg)), inspector.position_m)
    match inspector.profile:
        case "rest":
            return np.repeat(X_NC0[None], scene.frames, axis=0)
        case "drift":
            R = X_NC0[:3, :3] @ exp_so3(t_s[:, None] * np.deg2rad(inspector.rate_deg_s))
            return make_pose(R, X_NC0[:3, 3] + t_s[:, None] * np.array(inspector.velocity_mm_s) * 1e-3)
        case "circle":
            axis = np.array(inspector.circle_axis) / np.linalg.norm(inspector.circle_axis)
            turn = exp_so3(t_s[:, None] * (2 * np.pi / inspector.circle_period_s) * axis)
            centre_N = np.array(scene.motion.position_m)
            about_centre = make_pose(turn, centre_N - turn @ centre_N)
            return np.asarray(about_centre @ X_NC0)
        case _:
            raise InputError(f"scene.inspector.profile: {inspector.profile} cannot be moved yet")


def reported_inspector(scene: config.Scene, X_NC: Array, X_BC: Array, rng: np.random.Generator) -> Array:
    """Inspector poses X_NB (F, 4, 4) as its own estimator reports them: truth plus noise."""
    X_NB = X_NC @ inverse_pose(X_BC)
    noise_p_N = rng.normal(0.0, 1.0, (len(X_NB), 3)) * scene.inspector.sigma_p_m
    noise_theta = rng.normal(0.0, 1.0, (len(X_NB), 3)) * np.deg2rad(scene.inspector.sigma_theta_deg)
    return make_pose(X_NB[:, :3, :3] @ exp_so3(noise_theta), X_NB[:, :3, 3] + noise_p_N)
