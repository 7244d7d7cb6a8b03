"""Faults that are rendered: what else is in view, what happens to the target, when the cameras look.

A companion (another body, a loose blanket, an ejected mass) is rendered by itself and put in front of or
behind the target by depth; neither casts a shadow on the other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.robustness.bodies import INTERVAL_S, PSD, scene_of
from benchmarks.robustness.recording import Recording, read_recording
from polhode.config.scene_settings import Scene, TargetBody
from polhode.lie import (
    Array,
    exp_so3,
    inverse_pose,
    make_pose,
    matrix_from_wxyz,
    transform_points,
    wxyz_from_matrix,
)
from polhode.progress import Silent
from polhode.rigid_body import propagate
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.sequence import SequencePlan, plan_sequence, truth_of, write_sequence
from polhode.simulation.motion.integrate import advance
from polhode.simulation.motion.mass import MassDistribution, principal_axes
from polhode.simulation.motion.target import poses_of_target
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, through_lens

Rendered = Callable[[str, Path], Recording]
"""From the name of a body and a folder of its rendered sequences"""


def undisturbed(name: str, folder: Path) -> Recording:
    """The body as it is."""
    return _simulated(*scene_of(name), folder / "none")


def disturbances(times: float) -> Rendered:
    """Disturbances so many times as strong (power)."""

    def render(name: str, folder: Path) -> Recording:
        psd = {"accel_psd": times * PSD, "torque_psd": times * PSD}
        return _simulated(*scene_of(name, motion=psd), folder / f"disturbances_{times:g}")

    return render


def thruster_burst(name: str, folder: Path) -> Recording:
    """A thruster fires for a second: 2 mm/s and, about two axes, some 3 deg/s."""
    scene, seed = scene_of(name)
    mass = plan_sequence(scene, seed).mass
    push = {
        "start_s": 0.5 * INTERVAL_S * scene.frames + 0.1,
        "duration_s": 1.0,
        "force_N": [2e-3 * mass.mass_kg, -1e-3 * mass.mass_kg, 0.0],
        "torque_P": [0.05 * mass.moments[0], 0.0, 0.04 * mass.moments[2]],
    }
    changed, _ = scene_of(name, motion={"pushes": [push], "pushes_known": False})
    return _simulated(changed, seed, folder / "thruster_burst")


def leaves_and_returns(name: str, folder: Path) -> Recording:
    """The inspector looks away for six seconds; it reports its poses with 0.3 mm and 0.01 degrees."""
    away = {"position_m": [0.01, 0.0, 0.0], "attitude_deg": [0.0, 60.0, 0.0]}
    waypoints = [{"t_s": 6.0}, {"t_s": 8.5, **away}, {"t_s": 11.5, **away}, {"t_s": 14.0}]
    inspector = {
        "profile": "waypoints", "waypoints": waypoints, "sigma_p_m": 0.0003, "sigma_theta_deg": 0.01,
    }  # fmt: skip
    return _simulated(*scene_of(name, inspector=inspector), folder / "leaves_and_returns")


def right_camera_late(name: str, folder: Path) -> Recording:
    """The right camera takes its images 20 ms after the left one."""
    base, plan = undisturbed(name, folder), _plan(name)
    frames = range(plan.scene.frames)
    later = replace(plan.target, X_NG=np.concatenate([plan.target.poses_during(k, 0.020) for k in frames]))
    renderer = FrameRenderer(replace(plan, target=later))
    images = [renderer.render_image(k, 1)[0] for k in frames]
    return replace(base, right=np.stack(images).astype(np.uint8))


def second_body(name: str, folder: Path) -> Recording:
    """A cubesat, 0.7 times as far away, crosses in front of the target within eight seconds."""
    base, plan = undisturbed(name, folder), _plan(name)
    z = 0.7 * plan.scene.motion.position_m[2]
    from_middle_s = (_times(base) - 0.5 * INTERVAL_S * plan.scene.frames)[:, None]
    r_N = np.array([0.045, 0.0, z]) + from_middle_s * [0.14 * z, 0.01 * z, 0.0]
    R_N = exp_so3(from_middle_s * np.array([0.5, -0.3, 0.2]))
    body = build_body(TargetBody(family="cubesat", size_m=0.22 * z, texture="collage"), 900 + plan.seed)
    return _with_companion(base, plan, body, make_pose(R_N, r_N))


def loose_blanket(name: str, folder: Path) -> Recording:
    """A sheet of foil, hinged to the target, swings by 35 degrees to either side in four seconds."""
    base, plan = undisturbed(name, folder), _plan(name)
    rng = np.random.default_rng([plan.seed, 0xB1A])
    size_m = 0.55 * float(np.ptp(np.asarray(plan.body.mesh.vertices), axis=0).max())
    hinge_G, R_GH = _hinge(plan.body, rng)
    sheet = trimesh.creation.box((size_m, 0.6 * size_m, 0.004 * size_m))
    sheet.apply_translation((0.5 * size_m, 0.0, 0.0))
    file = folder / "blanket.stl"
    file.parent.mkdir(parents=True, exist_ok=True)
    sheet.subdivide().subdivide().export(file)
    foil = TargetBody(family="mesh", path=str(file), metres_per_unit=1.0, material="foil")
    angle = np.deg2rad(35.0) * np.sin(2.0 * np.pi * _times(base) / 4.0)
    X_GH = make_pose(R_GH @ exp_so3(angle[:, None] * np.array([0.0, 1.0, 0.0])), hinge_G)
    return _with_companion(base, plan, build_body(foil, plan.seed), plan.target.X_NG[: len(base)] @ X_GH)


EJECTED_SHARE, EJECTED_M_S = 0.08, 0.05
"""Share of the mass that leaves, and its speed relative to the place that it leaves"""


def mass_ejected(name: str, folder: Path) -> Recording:
    """Half way a cubesat of 8 % of the mass leaves the surface at 5 cm/s: other moments, axes and centre."""
    plan = _plan(name)
    place_G, R_GH = _hinge(plan.body, np.random.default_rng([plan.seed, 0xE7EC]))
    after = _after_ejection(plan, place_G, R_GH[:, 0])
    target = folder / "mass_ejected"
    if not (target / "mav0").is_dir():
        write_sequence(after.plan, target, Silent())
    base = replace(read_recording(target), later=truth_of(replace(after.plan, mass=after.mass)))
    body = build_body(TargetBody(family="cubesat", size_m=0.25 * plan.body.radius_m), 950 + plan.seed)
    since_s = np.maximum(_times(base) - after.time_s, 0.0)[:, None]
    X_NE = make_pose(after.R_NG @ exp_so3(since_s * after.rate_E), after.place_N + since_s * after.v_N)
    # behind the cameras until then
    X_NE[since_s[:, 0] == 0.0, :3, 3] = [0.0, 0.0, -1.0]
    return _with_companion(base, after.plan, body, X_NE)


@dataclass(frozen=True)
class _Ejection:
    """A plan whose target loses a mass, its mass afterwards, and where the ejected mass goes."""

    plan: SequencePlan
    mass: MassDistribution
    time_s: float
    place_N: Array
    """(3,) of the ejection [m]"""
    R_NG: Array
    """(3, 3) of the target then"""
    v_N: Array
    """(3,) of the ejected mass [m/s]"""
    rate_E: Array
    """(3,) of its rotation [rad/s]"""


def _after_ejection(plan: SequencePlan, place_G: Array, out_G: Array) -> _Ejection:
    """Linear and angular momentum are conserved; a quarter of an interval before the frame in the middle."""
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
    place_N = r_N + R_NG @ to_out
    return _Ejection(
        replace(plan, target=moved), mass, time_s, place_N, R_NG, v_N + v_out, 2.0 * R_NG.T @ w_N
    )


def _of_unit_mass(d: Array) -> Array:
    """Inertia (3, 3) of a unit mass at d (3,)."""
    return np.asarray(d @ d * np.eye(3) - np.outer(d, d))


def _hinge(body: Body, rng: np.random.Generator) -> tuple[Array, Array]:
    """A point of the hull (3,) [m] and axes there (3, 3): x outwards."""
    hull = body.mesh.convex_hull
    points, faces = trimesh.sample.sample_surface(hull, 1, seed=int(rng.integers(2**31)))[:2]
    x = np.asarray(hull.face_normals[faces[0]])
    y = np.cross(x, [0.36, 0.48, 0.8])
    y /= np.linalg.norm(y)
    return np.asarray(points[0]), np.stack([x, y, np.cross(x, y)], axis=1)


@cache
def _plan(name: str) -> SequencePlan:
    return plan_sequence(*scene_of(name))


def _times(recording: Recording) -> Array:
    return np.asarray((recording.stamps_ns - recording.stamps_ns[0]) * 1e-9)


def _simulated(scene: Scene, seed: int, folder: Path) -> Recording:
    if not (folder / "mav0").is_dir():
        write_sequence(plan_sequence(scene, seed), folder, Silent())
    return read_recording(folder)


def _with_companion(base: Recording, plan: SequencePlan, body: Body, X_NA: Array) -> Recording:
    """The recording of a plan, whose camera is at rest, with another body in view at X_NA (F, 4, 4)."""
    scene, own, target = plan.scene, RayCaster(body), RayCaster(plan.body)
    renderer = Renderer(body, scene.model_copy(update={"body": TargetBody()}), plan.seed + 1)
    images = [base.left.copy(), base.right.copy()]
    for k in range(len(base)):
        for camera, side in zip(plan.cameras, images, strict=True):
            corners_K = transform_points(inverse_pose(camera.X_CK) @ X_NA[k], body.mesh.bounding_box.vertices)
            if corners_K[:, 2].min() < 0.05 or not len(camera.project_visible(corners_K, 100.0)[1]):
                continue
            picture = renderer.picture(camera, camera.X_CK, X_NA[k])
            behind = _depth(own, camera, X_NA[k]) >= _depth(target, camera, plan.target.X_NG[k])
            front = 1.0 - behind * (picture.covered > 0.0)
            lens = scene.sensor.model_copy(update={"vignetting": 0.0})
            light = scene.sensor.white_dn * through_lens(picture.level * front, scene.sensor)
            side[k] = np.clip(
                np.rint(side[k] * (1.0 - through_lens(picture.covered * front, lens)) + light), 0, 255
            ).astype(np.uint8)
    return replace(base, left=images[0], right=images[1])


def _depth(caster: RayCaster, camera: Camera, X_NB: Array) -> Array:
    """(H, W) distance along the rays through the pixels [m]; inf beside the body at X_NB (4, 4)."""
    X_BK = inverse_pose(X_NB) @ camera.X_CK
    hits = caster.first_hits(X_BK[:3, 3], camera.pixel_directions @ X_BK[:3, :3].T)
    out = np.full(camera.height_px * camera.width_px, np.inf)
    out[hits.ray] = hits.distance_m
    return out.reshape(camera.height_px, camera.width_px)
