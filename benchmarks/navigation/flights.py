"""The scenes of benchmarks/navigation/compare_filters.py: a tumbling target, an inspector, a first state.

The inspector flies straight from 4 m to 2 m, or half around the target at 3 m, looking at where the target
was planned to be. The target turns once in a minute, near its middle axis, and is disturbed by white noise of
the level that the filters know. The Sun stands still.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh

from benchmarks.edges.views import edge_body, edge_rig
from benchmarks.navigation.error_state_filter import State, Target, predict, predicted_pose
from polhode.lie import Array, exp_so3, make_pose
from polhode.planning.prediction import process_noise

SCENARIOS = ("approach", "fly-around")
RIG = edge_rig(480.0, 480, 360)
DURATION_S = 60.0
STEP_S = 1.0
PSD = 1e-8
"""[(m/s^2)^2/Hz] and [(rad/s^2)^2/Hz]: in a minute 0.8 mm/s and 0.04 deg/s."""
RATE_RAD_S = 2.0 * np.pi / 60.0
SUN_N = np.array([0.5, -0.55, -0.67])
"""Behind the camera of the approach, to its right and above."""
START_SIGMA = np.repeat([0.05, 0.005, np.deg2rad(3.0), np.deg2rad(0.2)], 3)
"""Of the state that the filters start from [m, m/s, rad, rad/s]."""


@dataclass(frozen=True)
class SimulatedFlight:
    """One run's truth, at T instants."""

    target: Target
    states: list[State]
    """T true states; their covariance has no meaning"""
    R_NR: Array
    """(T, 3, 3) the camera's attitude"""
    accel_N: Array
    """(T, 3) of the inspector, from this instant to the next [m/s^2]"""
    start: State
    """what the filters start from, at the first instant"""

    def X_RG(self, k: int) -> Array:
        """The true pose (4, 4)."""
        return predicted_pose(self.states[k], self.target, self.R_NR[k])


@cache
def body_mesh(body: str) -> trimesh.Trimesh:
    """The mesh that images show, in G."""
    return edge_body(body, plain=True).mesh


@cache
def target_of(body: str) -> Target:
    """The body as if it were filled evenly; its middle is that of the edge model."""
    mesh = trimesh.Trimesh(body_mesh(body).vertices, body_mesh(body).faces)
    hull = mesh.convex_hull
    moments, axes = np.linalg.eigh(np.asarray(hull.moment_inertia))
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] = -axes[:, 2]
    return Target(
        moments / moments[1],
        make_pose(axes, np.asarray(hull.center_mass)),
        np.asarray(mesh.bounds.mean(axis=0)),
        0.5 * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0))),
        PSD,
        PSD,
    )


def instants() -> Array:
    """(T,) [s], from 0."""
    return np.arange(0.0, DURATION_S + 0.5 * STEP_S, STEP_S)


def inspector(scenario: str) -> tuple[Array, Array, Array, Array]:
    """Acceleration (T, 3), constant in each step, place (T, 3), velocity (T, 3) in N, attitude (T, 3, 3).

    The target's planned place is N's origin.
    """
    t = instants()
    middle = t + 0.5 * STEP_S
    if scenario == "approach":
        accel = np.zeros((len(t), 3))
        # 4 m to 2 m, half of the time faster and half of it slower
        accel[:, 2] = np.where(middle < 0.5 * DURATION_S, 1.0, -1.0) * 2.0 / (0.5 * DURATION_S) ** 2
        place, velocity = np.array([0.0, 0.0, -4.0]), np.zeros(3)
    else:
        rate, radius = np.pi / DURATION_S, 3.0
        around = np.stack([np.sin(rate * middle), 0.0 * t, -np.cos(rate * middle)], axis=1)
        accel = -(rate**2) * radius * around
        place, velocity = np.array([0.0, 0.0, -radius]), np.array([rate * radius, 0.0, 0.0])
    places, velocities = np.empty((len(t), 3)), np.empty((len(t), 3))
    for k in range(len(t)):
        places[k], velocities[k] = place, velocity
        place = place + STEP_S * velocity + 0.5 * STEP_S**2 * accel[k]
        velocity = velocity + STEP_S * accel[k]
    ahead = -places / np.linalg.norm(places, axis=1, keepdims=True)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return accel, places, velocities, np.stack([right, np.cross(ahead, right), ahead], axis=2)


def flight(scenario: str, body: str, seed: int) -> SimulatedFlight:
    """A run: attitude, spin, disturbances and first error by the seed."""
    rng = np.random.default_rng([seed, 0xF11E])
    target = target_of(body)
    accel, place, velocity, R_NR = inspector(scenario)
    spin = np.array([0.3, 1.0, 0.3]) * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.8, 1.2, 3)
    spin *= RATE_RAD_S / np.linalg.norm(spin)
    q = rng.standard_normal(4)
    angle = 2.0 * np.arctan2(np.linalg.norm(q[1:]), q[0])
    R_NP = exp_so3(q[1:] / np.linalg.norm(q[1:]) * angle)
    covariance = np.diag(START_SIGMA**2)
    state = State(-place[0], -velocity[0], R_NP, spin, covariance)
    states = [state]
    for k in range(len(R_NR) - 1):
        noise = process_noise(
            target.moments, state.w_P, np.array([STEP_S]), target.accel_psd, target.torque_psd
        )
        state = predict(state, target, STEP_S, accel[k])
        state = state.plus(np.linalg.cholesky(noise[0]) @ rng.standard_normal(12))
        states.append(state)
    start = states[0].plus(START_SIGMA * rng.standard_normal(12))
    return SimulatedFlight(target, states, R_NR, accel, start)


def sun_R(R_NR: Array) -> Array:
    """Direction (3,) to the Sun in the camera."""
    return np.asarray(R_NR.T @ SUN_N / np.linalg.norm(SUN_N))
