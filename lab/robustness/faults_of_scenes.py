"""Faults that are rendered: what happens to the target, and when the cameras look."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from lab.robustness.bodies import INTERVAL_S, PSD, scene_of
from lab.robustness.recording import Recording, read_recording
from polhode.config.scene_settings import Scene
from polhode.geometry.lie import (
    Array,
    matrix_from_wxyz,
    wxyz_from_matrix,
)
from polhode.geometry.rigid_body import propagate
from polhode.runtime.progress import Silent
from polhode.simulation.bodies import Body
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.sequence import SequencePlan, plan_sequence, truth_of, write_sequence
from polhode.simulation.motion.integrate import advance
from polhode.simulation.motion.mass import MassDistribution, principal_axes
from polhode.simulation.motion.target import poses_of_target

Rendered = Callable[[str, int, Path], Recording]
"""From the name of a body, the number of pairs and a folder of its rendered sequences"""


def undisturbed(name: str, frames: int, folder: Path) -> Recording:
    """The body as it is."""
    return _simulated(*scene_of(name, frames), folder / "none")


def disturbances(times: float) -> Rendered:
    """Disturbances so many times as strong (power)."""

    def render(name: str, frames: int, folder: Path) -> Recording:
        psd = {"accel_psd": times * PSD, "torque_psd": times * PSD}
        return _simulated(*scene_of(name, frames, motion=psd), folder / f"disturbances_{times:g}")

    return render


def thruster_burst(name: str, frames: int, folder: Path) -> Recording:
    """A thruster fires for a second: 2 mm/s and, about two axes, some 3 deg/s."""
    scene, seed = scene_of(name, frames)
    mass = plan_sequence(scene, seed).mass
    push = {
        "start_s": 0.5 * INTERVAL_S * scene.frames + 0.1,
        "duration_s": 1.0,
        "force_N": [2e-3 * mass.mass_kg, -1e-3 * mass.mass_kg, 0.0],
        "torque_P": [0.05 * mass.moments[0], 0.0, 0.04 * mass.moments[2]],
    }
    changed, _ = scene_of(name, frames, motion={"pushes": [push], "pushes_known": False})
    return _simulated(changed, seed, folder / "thruster_burst")


def leaves_and_returns(name: str, frames: int, folder: Path) -> Recording:
    """The inspector looks away for six seconds; it reports its poses with 0.3 mm and 0.01 degrees."""
    away = {"position_m": [0.01, 0.0, 0.0], "attitude_deg": [0.0, 60.0, 0.0]}
    waypoints = [{"t_s": 6.0}, {"t_s": 8.5, **away}, {"t_s": 11.5, **away}, {"t_s": 14.0}]
    inspector = {
        "profile": "waypoints", "waypoints": waypoints, "sigma_p_m": 0.0003, "sigma_theta_deg": 0.01,
    }  # fmt: skip
    return _simulated(*scene_of(name, frames, inspector=inspector), folder / "leaves_and_returns")


def right_camera_late(name: str, frames: int, folder: Path) -> Recording:
    """The right camera takes its images 20 ms after the left one."""
    base, plan = undisturbed(name, frames, folder), _plan(name, frames)
    shown = range(frames)
    later = replace(plan.target, X_NG=np.concatenate([plan.target.poses_during(k, 0.020) for k in shown]))
    renderer = FrameRenderer(replace(plan, target=later))
    images = [renderer.render_image(k, 1)[0] for k in shown]
    return replace(base, right=np.stack(images).astype(np.uint8))


EJECTED_SHARE, EJECTED_M_S = 0.08, 0.05
"""Share of the mass that leaves, and its speed relative to the place that it leaves"""


def mass_ejected(name: str, frames: int, folder: Path) -> Recording:
    """Half way 8 % of the mass leave the surface at 5 cm/s, unseen: other moments, axes and centre."""
    plan, target = _plan(name, frames), folder / "mass_ejected"
    moved, mass = _after_ejection(
        plan, *_place_on_hull(plan.body, np.random.default_rng([plan.seed, 0xE7EC]))
    )
    if not (target / "mav0").is_dir():
        write_sequence(moved, target, Silent())
    return replace(read_recording(target), later=truth_of(replace(moved, mass=mass)))


def _after_ejection(
    plan: SequencePlan, place_G: Array, out_G: Array
) -> tuple[SequencePlan, MassDistribution]:
    """The plan of a target that loses a mass, and its mass afterwards.

    Linear and angular momentum are conserved; a quarter of an interval before the frame in the middle.
    """
    target, before, k = plan.target, plan.mass, plan.scene.frames // 2
    time_s = float(target.t_s[k]) - 0.25 * INTERVAL_S
    state = np.concatenate([target.r_N[k], target.v_N[k], wxyz_from_matrix(target.R_NP[k]), target.h_P[k]])
    y = advance(state, float(target.t_s[k]), time_s, target.forces)
    r_N, v_N, R_NP = y[:3], y[3:6], matrix_from_wxyz(y[6:10])
    w_N, R_NG = R_NP @ (y[10:13] / before.moments), R_NP @ before.R_GP.T

    share = EJECTED_SHARE
    com_G = (before.com_G - share * place_G) / (1.0 - share)
    to_out, to_left = place_G - before.com_G, com_G - before.com_G
    m_out, m_left = share * before.mass_kg, (1.0 - share) * before.mass_kg
    J_G = before.J_G - m_out * _of_unit_mass(to_out) - m_left * _of_unit_mass(to_left)
    mass = MassDistribution(com_G, J_G, *principal_axes(J_G), m_left)

    # velocities relative to the centre of mass before
    v_out = np.cross(w_N, R_NG @ to_out) + EJECTED_M_S * (R_NG @ out_G)
    v_left = -share / (1.0 - share) * v_out
    carried = m_out * np.cross(R_NG @ to_out, v_out) + m_left * np.cross(R_NG @ to_left, v_left)
    w_after_N = np.linalg.solve(R_NG @ J_G @ R_NG.T, R_NG @ before.J_G @ R_NG.T @ w_N - carried)
    R_after = R_NG @ mass.R_GP
    states = propagate(
        np.concatenate([[0.0], target.t_s[k:] - time_s]), r_N + R_NG @ to_left, v_N + v_left,
        R_after, R_after.T @ w_after_N, np.diag(mass.moments),
    )  # fmt: skip
    r_t, v_t, R_t, w_t = (each[1:] for each in states)
    moved = replace(
        target,
        r_N=np.concatenate([target.r_N[:k], r_t]),
        v_N=np.concatenate([target.v_N[:k], v_t]),
        R_NP=np.concatenate([target.R_NP[:k], R_t]),
        w_P=np.concatenate([target.w_P[:k], w_t]),
        X_NG=np.concatenate([target.X_NG[:k], poses_of_target(r_t, R_t, mass)]),
    )
    return replace(plan, target=moved), mass


def _of_unit_mass(d: Array) -> Array:
    """Inertia (3, 3) of a unit mass at d (3,)."""
    return np.asarray(d @ d * np.eye(3) - np.outer(d, d))


def _place_on_hull(body: Body, rng: np.random.Generator) -> tuple[Array, Array]:
    """A point of the hull (3,) [m] and the outward normal there (3,)."""
    hull = body.mesh.convex_hull
    points, faces = trimesh.sample.sample_surface(hull, 1, seed=int(rng.integers(2**31)))[:2]
    return np.asarray(points[0]), np.asarray(hull.face_normals[faces[0]])


@cache
def _plan(name: str, frames: int) -> SequencePlan:
    return plan_sequence(*scene_of(name, frames))


def _simulated(scene: Scene, seed: int, folder: Path) -> Recording:
    if not (folder / "mav0").is_dir():
        write_sequence(plan_sequence(scene, seed), folder, Silent())
    return read_recording(folder)
