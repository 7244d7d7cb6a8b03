"""Motion of the inspector's left camera: its path, the jitter of its control, and the poses that it reports.

The jitter is the limit cycle of a dead-band control, as of the inspector of the thesis (figures 6-9 to 6-12):
nothing acts inside the band; at its edge a minimum impulse of the thrusters reverses the drift, with a
slightly different rate each time.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from polhode.config import scene as config
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, right_jacobian_so3
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
        since, turn = self._pulse(t_s)
        return np.asarray(line + turn * (0.5 * self.pulse_s - abs(since)) ** 2 / (2.0 * self.pulse_s))

    def slope(self, t_s: Array) -> Array:
        """Its rate at times (m,): continuous."""
        if len(self.corner_s) == 0:
            return np.zeros(len(t_s))
        index = np.searchsorted(self.corner_s, t_s, side="right")
        since, turn = self._pulse(t_s)
        side = np.where(since < 0.0, 1.0, -1.0)
        return np.asarray(self.rate[index] + side * turn * (0.5 * self.pulse_s - abs(since)) / self.pulse_s)

    def _pulse(self, t_s: Array) -> tuple[Array, Array]:
        """Time since the nearest pulse, clipped to the pulse [s], and the change of rate by that pulse."""
        after = np.clip(np.searchsorted(self.corner_s, t_s), 0, len(self.corner_s) - 1)
        before = np.maximum(after - 1, 0)
        closer = abs(t_s - self.corner_s[before]) < abs(t_s - self.corner_s[after])
        nearest = np.where(closer, before, after)
        half = 0.5 * self.pulse_s
        return np.clip(t_s - self.corner_s[nearest], -half, half), np.diff(self.rate)[nearest]


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


BRAKE_S = 1.0
"""Duration of the braking at the end of an approach [s]."""


_TAG = 0x31
_MARGIN_S = 60.0
"""The jitter continues for this long after the last frame, for long exposures [s]."""


class CameraStates(NamedTuple):
    """Left camera at n times."""

    X_NC: Array
    """(n, 4, 4)"""
    v_N: Array
    """(n, 3) [m/s]"""
    w_C: Array
    """(n, 3) angular velocity relative to N, in the camera's axes [rad/s]"""


class CameraPath(Protocol):
    """A motion of the camera."""

    def at(self, t_s: Array) -> CameraStates:
        """States at times (n,) after the first frame [s], also before it."""
        ...


@dataclass(frozen=True)
class DriftPath:
    """Constant velocity and constant angular velocity in the camera's axes; rest when both are zero."""

    X_NC0: Array
    """(4, 4) at the first frame"""
    v_N: Array
    """(3,) [m/s]"""
    w_C: Array
    """(3,) [rad/s]"""

    def at(self, t_s: Array) -> CameraStates:
        R_NC = self.X_NC0[:3, :3] @ exp_so3(t_s[:, None] * self.w_C)
        X_NC = make_pose(R_NC, self.X_NC0[:3, 3] + t_s[:, None] * self.v_N)
        return CameraStates(X_NC, np.tile(self.v_N, (len(t_s), 1)), np.tile(self.w_C, (len(t_s), 1)))


@dataclass(frozen=True)
class CirclePath:
    """The first pose rotated about an axis through a centre, at a constant rate."""

    X_NC0: Array
    """(4, 4) at the first frame"""
    centre_N: Array
    """(3,) [m]"""
    w_N: Array
    """(3,) [rad/s]"""

    def at(self, t_s: Array) -> CameraStates:
        turn = exp_so3(t_s[:, None] * self.w_N)
        X_NC = np.asarray(make_pose(turn, self.centre_N - turn @ self.centre_N) @ self.X_NC0)
        v_N = np.cross(self.w_N, X_NC[:, :3, 3] - self.centre_N)
        return CameraStates(X_NC, v_N, np.tile(self.X_NC0[:3, :3].T @ self.w_N, (len(t_s), 1)))


@dataclass(frozen=True)
class ApproachPath:
    """Along a line at a constant speed, then uniform braking to a stop; constant attitude."""

    X_NC0: Array
    """(4, 4) at the first frame"""
    direction_N: Array
    """(3,) unit"""
    length_m: float
    """Length of the line [m]"""
    speed_m_s: float

    def at(self, t_s: Array) -> CameraStates:
        brake_s = min(BRAKE_S, 2.0 * self.length_m / self.speed_m_s)
        cruise_s = self.length_m / self.speed_m_s - 0.5 * brake_s
        braking_s = np.clip(t_s - cruise_s, 0.0, brake_s)
        slowed = braking_s / brake_s if brake_s > 0 else np.ones(len(t_s))
        distance_m = self.speed_m_s * (np.minimum(t_s, cruise_s) + braking_s * (1.0 - 0.5 * slowed))
        speed_m_s = self.speed_m_s * (1.0 - slowed)
        if brake_s == 0.0:
            distance_m = np.zeros(len(t_s))
        p_N = self.X_NC0[:3, 3] + distance_m[:, None] * self.direction_N
        X_NC = make_pose(np.tile(self.X_NC0[:3, :3], (len(t_s), 1, 1)), p_N)
        return CameraStates(X_NC, speed_m_s[:, None] * self.direction_N, np.zeros((len(t_s), 3)))


@dataclass(frozen=True)
class WaypointPath:
    """Splines through given poses, from rest to rest, constant before the first and after the last pose.

    Cubic in position; in attitude scipy's RotationSpline, whose angular velocity is continuous. Time on the
    splines starts and stops smoothly, so that the velocity is continuous at departure and arrival.
    """

    knots_s: Array
    """(n,) increasing, n >= 2 [s]"""
    p_N: Array
    """(n, 3) [m]"""
    R_NC: Array
    """(n, 3, 3)"""

    @cached_property
    def _position(self) -> CubicSpline:
        return CubicSpline(self.knots_s, self.p_N, bc_type="natural")

    @cached_property
    def _attitude(self) -> RotationSpline:
        return RotationSpline(self.knots_s, Rotation.from_matrix(self.R_NC))

    def at(self, t_s: Array) -> CameraStates:
        clock_s, pace = self._clock(t_s)
        X_NC = make_pose(self._attitude(clock_s).as_matrix(), self._position(clock_s))
        v_N = self._position(clock_s, 1) * pace[:, None]
        # scipy gives the angular velocity in the rotating axes, which are the camera's.
        w_C = self._attitude(clock_s, 1) * pace[:, None]
        return CameraStates(X_NC, v_N, w_C)

    def _clock(self, t_s: Array) -> tuple[Array, Array]:
        """Time on the splines and its rate: true time at every knot, at rest at the first and the last."""
        first, last = float(self.knots_s[0]), float(self.knots_s[-1])
        t = np.clip(t_s, first, last)
        outside = (t_s <= first) | (t_s >= last)
        if len(self.knots_s) == 2:
            x = (t - first) / (last - first)
            return first + (last - first) * x * x * (3 - 2 * x), np.where(outside, 0.0, 6 * x * (1 - x))
        clock, pace = t.copy(), np.ones(len(t))
        for end, neighbour in ((first, self.knots_s[1]), (last, self.knots_s[-2])):
            x = (t - end) / (neighbour - end)
            near = x < 1.0
            clock[near] = (end + (neighbour - end) * x * x * (2 - x))[near]
            pace[near] = (x * (4 - 3 * x))[near]
        return clock, np.where(outside, 0.0, pace)


def camera_path(scene: config.Scene) -> CameraPath:
    """The path of the scene's inspector. Raises InputError for an approach without a direction."""
    inspector = scene.inspector
    X_NC0 = make_pose(exp_so3(np.deg2rad(inspector.attitude_deg)), inspector.position_m)
    target_N = np.array(scene.motion.position_m)
    match inspector.profile:
        case "rest":
            return DriftPath(X_NC0, np.zeros(3), np.zeros(3))
        case "drift":
            return DriftPath(
                X_NC0, np.array(inspector.velocity_mm_s) * 1e-3, np.deg2rad(inspector.rate_deg_s)
            )
        case "circle":
            axis_N = np.array(inspector.circle_axis) / np.linalg.norm(inspector.circle_axis)
            return CirclePath(X_NC0, target_N, axis_N * (2 * np.pi / inspector.circle_period_s))
        case "approach":
            line_N = target_N - X_NC0[:3, 3]
            distance_m = float(np.linalg.norm(line_N))
            if distance_m == 0.0:
                raise InputError(
                    "scene.inspector.position_m is the target's position: an approach must start away from it"
                )
            length_m = max(distance_m - inspector.approach_stop_m, 0.0)
            return ApproachPath(X_NC0, line_N / distance_m, length_m, inspector.approach_mm_s * 1e-3)
        case "waypoints":
            points = inspector.waypoints
            return WaypointPath(
                np.array([point.t_s for point in points]),
                np.array([point.position_m for point in points]),
                exp_so3(np.deg2rad([point.attitude_deg for point in points])),
            )


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
    path: CameraPath
    jitter: tuple[LimitCycle, ...]
    """Position in N [m], then rotation vector in the camera's axes [rad]: x, y, z of each"""

    def poses_during(self, k: int, offsets_s: ArrayLike) -> Array:
        """X_NC (S, 4, 4) at times (S,) after, or before, frame k [s]."""
        t_s = self.t_s[k] + np.atleast_1d(np.asarray(offsets_s, dtype=np.float64))
        return camera_states(self.path, self.jitter, t_s).X_NC


def inspector_motion(scene: config.Scene, seed: int) -> InspectorMotion:
    """The inspector's motion over the frames; the seed is that of its limit cycles.

    The first pose is exactly the scene's, because the jitter starts at the centre of its band. Raises
    InputError for an approach that starts at the target.
    """
    stamps = timestamps(scene)[: scene.frames]
    t_s = np.asarray((stamps - stamps[0]) / 1e9)
    path, jitter = camera_path(scene), _jitter(scene.inspector, float(t_s[-1]) + _MARGIN_S, seed)
    states = camera_states(path, jitter, t_s)
    return InspectorMotion(states.X_NC, states.v_N, states.w_C, t_s, path, jitter)


def camera_states(path: CameraPath, jitter: tuple[LimitCycle, ...], t_s: Array) -> CameraStates:
    """CameraPath and jitter together at times (n,) [s]."""
    X_NC, v_N, w_C = path.at(t_s)
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
