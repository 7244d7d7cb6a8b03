"""Motion of the inspector's left camera: its course, the jitter of its control, and what it reports."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polhode.config import scene as config
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, right_jacobian_so3
from polhode.simulation.motion.course import CameraStates, Course, course_of
from polhode.simulation.motion.deadband import LimitCycle, limit_cycle
from polhode.simulation.motion.target import timestamps

_TAG = 0x31
_BEYOND_S = 60.0
"""The jitter goes on for this long after the last frame, for long exposures [s]."""


@dataclass(frozen=True)
class InspectorMotion:
    """The left camera at the F frames, and between them."""

    X_NC: Array
    """(F, 4, 4)"""
    v_N: Array
    """(F, 3) [m/s]"""
    w_C: Array
    """(F, 3) angular velocity relative to N, in the camera's axes [rad/s]"""
    t_s: Array
    """(F,) time after the first frame [s]"""
    course: Course
    jitter: tuple[LimitCycle, ...]
    """Position in N [m], then rotation vector in the camera's axes [rad]: x, y, z of each"""

    def poses_during(self, k: int, offsets_s: ArrayLike) -> Array:
        """X_NC (S, 4, 4) at times (S,) after, or before, frame k [s]."""
        t_s = self.t_s[k] + np.atleast_1d(np.asarray(offsets_s, dtype=np.float64))
        return camera_states(self.course, self.jitter, t_s).X_NC


def inspector_motion(scene: config.Scene, seed: int) -> InspectorMotion:
    """The inspector's motion over the frames; the seed is that of its limit cycles.

    The first pose is the scene's, exactly: the jitter starts in the middle of its band. Raises InputError for
    an approach that starts at the target.
    """
    stamps = timestamps(scene)[: scene.frames]
    t_s = np.asarray((stamps - stamps[0]) / 1e9)
    course, jitter = course_of(scene), _jitter(scene.inspector, float(t_s[-1]) + _BEYOND_S, seed)
    states = camera_states(course, jitter, t_s)
    return InspectorMotion(states.X_NC, states.v_N, states.w_C, t_s, course, jitter)


def camera_states(course: Course, jitter: tuple[LimitCycle, ...], t_s: Array) -> CameraStates:
    """Course and jitter together at times (n,) [s]."""
    X_NC, v_N, w_C = course.at(t_s)
    deviation = np.stack([cycle.value(t_s) for cycle in jitter], axis=1)
    rate = np.stack([cycle.slope(t_s) for cycle in jitter], axis=1)
    theta = deviation[:, 3:]
    turn = exp_so3(theta)
    w_C = np.einsum("nji,nj->ni", turn, w_C) + (right_jacobian_so3(theta) @ rate[:, 3:, None])[..., 0]
    X_NC = make_pose(X_NC[:, :3, :3] @ turn, X_NC[:, :3, 3] + deviation[:, :3])
    return CameraStates(X_NC, v_N + rate[:, :3], w_C)


def reported_inspector(scene: config.Scene, X_NC: Array, X_BC: Array, rng: np.random.Generator) -> Array:
    """Inspector poses X_NB (F, 4, 4) as its own estimator reports them: truth plus noise."""
    X_NB = X_NC @ inverse_pose(X_BC)
    noise_p_N = rng.normal(0.0, 1.0, (len(X_NB), 3)) * scene.inspector.sigma_p_m
    noise_theta = rng.normal(0.0, 1.0, (len(X_NB), 3)) * np.deg2rad(scene.inspector.sigma_theta_deg)
    return make_pose(X_NB[:, :3, :3] @ exp_so3(noise_theta), X_NB[:, :3, 3] + noise_p_N)


def _jitter(inspector: config.Inspector, stop_s: float, seed: int) -> tuple[LimitCycle, ...]:
    """Limit cycles of the three components of position [m] and of attitude [rad], one generator each."""
    position = (inspector.deadband_mm * 1e-3, inspector.deadband_mm_s * 1e-3)
    attitude = (np.deg2rad(inspector.deadband_deg), np.deg2rad(inspector.deadband_deg_s))
    return tuple(
        limit_cycle(width, rate, stop_s, np.random.default_rng([seed, _TAG, axis]))
        for axis, (width, rate) in enumerate([position] * 3 + [attitude] * 3)
    )
