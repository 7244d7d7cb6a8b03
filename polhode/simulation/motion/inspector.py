"""Motion of the inspector's left camera: its path, the jitter of its control, and the poses that it reports.

The jitter is the limit cycle of a dead-band control, as of the inspector of the thesis (figures 6-9 to 6-12):
nothing acts inside the band; at its edge a minimum impulse of the thrusters reverses the drift, with a
slightly different rate each time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.runtime.errors import InputError
from polhode.simulation.motion.target import timestamps

PULSE_S = 0.1
"""Duration of a pulse [s]; shorter if the band is crossed as quickly."""
RATE_VARIATION = 0.25
"""Largest relative difference of a drift rate from the nominal one."""


@dataclass(frozen=True)
class LimitCycle:
    """One axis: straight lines between corners at the band's edges, rounded during the pulses."""

    corner_s: Array
    """(n,) middle of each pulse [s]"""
    corner_value: Array
    """(n,) value at each pulse: the edge of the band"""
    rate: Array
    """(n + 1,) drift before, between and after the pulses"""
    pulse_s: float

    def value(self, t_s: Array) -> Array:
        """Deviation at times (m,): zero at the first frame, never beyond the band."""
        if len(self.corner_s) == 0:
            return np.zeros(len(t_s))
        index = np.searchsorted(self.corner_s, t_s, side="right")
        # The first line is evaluated from its start, so that it is exactly zero there.
        start_s, start = np.append(0.0, self.corner_s)[index], np.append(0.0, self.corner_value)[index]
        line = start + self.rate[index] * (t_s - start_s)
        after = np.clip(np.searchsorted(self.corner_s, t_s), 0, len(self.corner_s) - 1)
        before = np.maximum(after - 1, 0)
        closer = abs(t_s - self.corner_s[before]) < abs(t_s - self.corner_s[after])
        nearest, half = np.where(closer, before, after), 0.5 * self.pulse_s
        since = np.clip(t_s - self.corner_s[nearest], -half, half)
        return np.asarray(
            line + np.diff(self.rate)[nearest] * (half - abs(since)) ** 2 / (2.0 * self.pulse_s)
        )


def limit_cycle(half_width: float, rate: float, stop_s: float, rng: np.random.Generator) -> LimitCycle:
    """A cycle in the band [-half_width, half_width], from its centre at time zero until ``stop_s`` [s].

    ``rate`` is the nominal drift per second. The cycle up to any time does not depend on ``stop_s``.
    """
    if half_width == 0.0 or rate == 0.0:
        return LimitCycle(np.zeros(0), np.zeros(0), np.zeros(1), PULSE_S)
    quickest = rate * (1.0 + RATE_VARIATION)
    count = int(np.ceil(stop_s * quickest / (2.0 * half_width))) + 2
    first = 1.0 if rng.random() < 0.5 else -1.0
    signs = first * np.where(np.arange(count + 1) % 2 == 0, 1.0, -1.0)
    rates = signs * rate * (1.0 + RATE_VARIATION * rng.uniform(-1.0, 1.0, count + 1))
    values = signs[:-1] * half_width
    way = np.diff(np.concatenate([[0.0], values]))
    pulse_s = min(PULSE_S, 0.5 * half_width / quickest)
    return LimitCycle(np.cumsum(way / rates[:-1]), values, rates, pulse_s)


CameraPath = Callable[[Array], Array]
"""Poses X_NC (n, 4, 4) of the left camera at times (n,) after the first frame [s], also before it."""


def _drift(X_NC0: Array, v_N: Array, w_C: Array, t_s: Array) -> Array:
    """Constant velocity [m/s] and constant rate in the camera's axes [rad/s]; rest when both are zero."""
    R_NC = X_NC0[:3, :3] @ exp_so3(t_s[:, None] * w_C)
    return make_pose(R_NC, X_NC0[:3, 3] + t_s[:, None] * v_N)


def _circle(X_NC0: Array, centre_N: Array, w_N: Array, t_s: Array) -> Array:
    """The first pose rotated about an axis through a centre, at a constant rate (3,) [rad/s]."""
    turn = exp_so3(t_s[:, None] * w_N)
    return np.asarray(make_pose(turn, centre_N - turn @ centre_N) @ X_NC0)


def _approach(X_NC0: Array, direction_N: Array, length_m: float, speed_m_s: float, t_s: Array) -> Array:
    """Along a line at a constant speed, then uniform braking to a stop; constant attitude."""
    # Braking takes one second, or the whole way.
    brake_s = min(1.0, 2.0 * length_m / speed_m_s)
    cruise_s = length_m / speed_m_s - 0.5 * brake_s
    braking_s = np.clip(t_s - cruise_s, 0.0, brake_s)
    slowed = braking_s / brake_s if brake_s > 0 else np.ones(len(t_s))
    distance_m = speed_m_s * (np.minimum(t_s, cruise_s) + braking_s * (1.0 - 0.5 * slowed))
    if brake_s == 0.0:
        distance_m = np.zeros(len(t_s))
    p_N = X_NC0[:3, 3] + distance_m[:, None] * direction_N
    return make_pose(np.tile(X_NC0[:3, :3], (len(t_s), 1, 1)), p_N)


def _through_waypoints(knots_s: Array, p_N: Array, R_NC: Array, t_s: Array) -> Array:
    """Splines through n >= 2 poses, from rest to rest, constant before the first and after the last pose.

    Cubic in position; in attitude scipy's RotationSpline, whose angular velocity is continuous. Time on the
    splines starts and stops smoothly, so that the velocity is continuous at departure and arrival.
    """
    first, last = float(knots_s[0]), float(knots_s[-1])
    t = np.clip(t_s, first, last)
    clock_s = t.copy()
    if len(knots_s) == 2:
        x = (t - first) / (last - first)
        clock_s = first + (last - first) * x * x * (3 - 2 * x)
    else:
        for end, neighbour in ((first, knots_s[1]), (last, knots_s[-2])):
            x = (t - end) / (neighbour - end)
            near = x < 1.0
            clock_s[near] = (end + (neighbour - end) * x * x * (2 - x))[near]
    attitude = RotationSpline(knots_s, Rotation.from_matrix(R_NC))
    return make_pose(attitude(clock_s).as_matrix(), CubicSpline(knots_s, p_N, bc_type="natural")(clock_s))


def camera_path(scene: config.Scene) -> CameraPath:
    """The path of the scene's inspector. Raises InputError for an approach without a direction."""
    inspector = scene.inspector
    X_NC0 = make_pose(exp_so3(np.deg2rad(inspector.attitude_deg)), inspector.position_m)
    target_N = np.array(scene.motion.position_m)
    match inspector.profile:
        case "rest":
            return partial(_drift, X_NC0, np.zeros(3), np.zeros(3))
        case "drift":
            v_N = np.array(inspector.velocity_mm_s) * 1e-3
            return partial(_drift, X_NC0, v_N, np.deg2rad(inspector.rate_deg_s))
        case "circle":
            axis_N = np.array(inspector.circle_axis) / np.linalg.norm(inspector.circle_axis)
            return partial(_circle, X_NC0, target_N, axis_N * (2 * np.pi / inspector.circle_period_s))
        case "approach":
            line_N = target_N - X_NC0[:3, 3]
            distance_m = float(np.linalg.norm(line_N))
            if distance_m == 0.0:
                raise InputError(
                    "scene.inspector.position_m is the target's position: an approach must start away from it"
                )
            length_m = max(distance_m - inspector.approach_stop_m, 0.0)
            return partial(_approach, X_NC0, line_N / distance_m, length_m, inspector.approach_mm_s * 1e-3)
        case "waypoints":
            points = inspector.waypoints
            knots_s, p_N = np.array([point.t_s for point in points]), [point.position_m for point in points]
            R_NC = exp_so3(np.deg2rad([point.attitude_deg for point in points]))
            return partial(_through_waypoints, knots_s, np.array(p_N), R_NC)


@dataclass(frozen=True)
class InspectorMotion:
    """The left camera at the F frames, and between them."""

    t_s: Array
    """(F,) time after the first frame [s]"""
    path: CameraPath
    jitter: tuple[LimitCycle, ...]
    """Position in N [m], then rotation vector in the camera's axes [rad]: x, y, z of each"""

    @cached_property
    def X_NC(self) -> Array:
        """(F, 4, 4)"""
        return self._poses(self.t_s)

    def poses_during(self, k: int, offsets_s: ArrayLike) -> Array:
        """X_NC (S, 4, 4) at times (S,) after, or before, frame k [s]."""
        return self._poses(self.t_s[k] + np.atleast_1d(np.asarray(offsets_s, dtype=np.float64)))

    def _poses(self, t_s: Array) -> Array:
        """Path and jitter together at times (n,) [s]: (n, 4, 4)."""
        X_NC = self.path(t_s)
        deviation = np.stack([cycle.value(t_s) for cycle in self.jitter], axis=1)
        return make_pose(X_NC[:, :3, :3] @ exp_so3(deviation[:, 3:]), X_NC[:, :3, 3] + deviation[:, :3])


def inspector_motion(scene: config.Scene, seed: int) -> InspectorMotion:
    """The inspector's motion over the frames; the seed is that of its limit cycles.

    The first pose is exactly the scene's, because the jitter starts at the centre of its band. Raises
    InputError for an approach that starts at the target.
    """
    inspector = scene.inspector
    stamps = timestamps(scene)[: scene.frames]
    t_s = np.asarray((stamps - stamps[0]) / 1e9)
    position = (inspector.deadband_mm * 1e-3, inspector.deadband_mm_s * 1e-3)
    attitude = (np.deg2rad(inspector.deadband_deg), np.deg2rad(inspector.deadband_deg_s))
    # The jitter continues for a minute after the last frame, for long exposures.
    jitter = tuple(
        limit_cycle(width, rate, float(t_s[-1]) + 60.0, np.random.default_rng([seed, 0x31, axis]))
        for axis, (width, rate) in enumerate([position] * 3 + [attitude] * 3)
    )
    return InspectorMotion(t_s, camera_path(scene), jitter)


def reported_inspector(scene: config.Scene, X_NC: Array, X_BC: Array, rng: np.random.Generator) -> Array:
    """Inspector poses X_NB (F, 4, 4) as its own estimator reports them: truth plus noise."""
    X_NB = X_NC @ inverse_pose(X_BC)
    noise_p_N = rng.normal(0.0, 1.0, (len(X_NB), 3)) * scene.inspector.sigma_p_m
    noise_theta = rng.normal(0.0, 1.0, (len(X_NB), 3)) * np.deg2rad(scene.inspector.sigma_theta_deg)
    return make_pose(X_NB[:, :3, :3] @ exp_so3(noise_theta), X_NB[:, :3, 3] + noise_p_N)
