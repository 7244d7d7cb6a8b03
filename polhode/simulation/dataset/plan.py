"""All that is decided before rendering: body, mass, cameras, motion, and which frames are dropped.

Scenes in which the target is never in view, or a camera is inside it, are refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.dataset.range_images import MAX_UNITS
from polhode.simulation.motion.inspector import InspectorMotion, inspector_motion
from polhode.simulation.motion.mass import MassDistribution, mass_distribution
from polhode.simulation.motion.target import TargetMotion, target_motion
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.sampling import even_directions
from polhode.simulation.sky import Sky
from polhode.simulation.stereo_camera import Camera, build_cameras


@dataclass(frozen=True)
class SequencePlan:
    """A scene, ready to be rendered."""

    scene: Scene
    seed: int
    body: Body
    mass: MassDistribution
    cameras: tuple[Camera, Camera]
    target: TargetMotion
    inspector: InspectorMotion
    sky: Sky
    frames: tuple[int, ...]
    """Frames that are not dropped, counted from 0"""

    @property
    def recording_cameras(self) -> tuple[Camera, ...]:
        """Those whose images are written: the left one alone, if a range sensor replaces the right one."""
        return self.cameras if self.scene.ranges is None else self.cameras[:1]

    @property
    def X_NC(self) -> Array:
        """(F, 4, 4) left camera at the frames"""
        return self.inspector.X_NC

    def time_s(self, k: int) -> float:
        """Time of frame k after the first one [s]."""
        return float((self.target.timestamps_ns[k] - self.target.timestamps_ns[0]) * 1e-9)


def load_scene(path: Path) -> tuple[Scene, int]:
    """Scene and seed of a configuration. Raises InputError if it has no scene."""
    loaded = load_config(path)
    if loaded.scene is None:
        raise InputError(f"{path} has no scene: give a configuration for polhode simulate")
    return loaded.scene, loaded.seed


def plan_sequence(scene: Scene, seed: int) -> SequencePlan:
    """Build the body and its motion. Raises InputError for a scene that cannot be rendered."""
    body = build_body(scene.body, seed)
    mass = mass_distribution(scene.mass, body)
    plan = SequencePlan(
        scene,
        seed,
        body,
        mass,
        build_cameras(scene.rig),
        target_motion(scene, mass, seed),
        inspector_motion(scene, seed),
        Sky(scene, seed),
        received_frames(scene.sensor, scene.frames, seed),
    )
    frames = list(plan.frames)
    t_s = np.array([plan.time_s(k) for k in frames])
    require_target_in_view(body, plan.recording_cameras, plan.X_NC[frames], plan.target.X_NG[frames], t_s)
    if plan.sky.wall is not None:
        plan.sky.wall.require_behind(plan.target.X_NG[frames][:, :3, 3], body.radius_m)
    if scene.ranges is not None:
        centre_G = np.asarray(body.mesh.bounds).mean(axis=0)
        poses = inverse_pose(plan.X_NC) @ plan.target.X_NG[: scene.frames]
        nearest_m = float(transform_points(poses, centre_G[None])[..., 2].min()) - body.radius_m
        most_m = MAX_UNITS * scene.ranges.scale_m
        if nearest_m > most_m:
            raise InputError(
                f"scene.range_sensor.scale_m: {scene.ranges.scale_m:g} m makes ranges up to {most_m:.3g} m, "
                f"the target is {nearest_m:.3g} m away; give a larger unit"
            )
    return plan


def received_frames(sensor: config.Sensor, count: int, seed: int) -> tuple[int, ...]:
    """Frames of ``count`` that are not dropped. Raises InputError when none is left."""
    lost = np.random.default_rng([seed, 0x3]).random(count) < sensor.drop_probability
    lost[list(sensor.dropped_frames)] = True
    if lost.all():
        raise InputError(
            "scene.sensor: dropped_frames and drop_probability leave no frame; let at least one arrive"
        )
    return tuple(int(k) for k in np.flatnonzero(~lost))


def truth_of(plan: SequencePlan) -> Truth:
    """The truth at all frames, including dropped ones, and over the horizon."""
    target, mass = plan.target, plan.mass
    return Truth(
        timestamps_ns=target.timestamps_ns,
        r_N=target.r_N,
        R_NP=target.R_NP,
        v_N=target.v_N,
        w_P=target.w_P,
        moments=mass.moments,
        k1=float(np.log(mass.moments[0] / mass.moments[1])),
        k2=float(np.log(mass.moments[1] / mass.moments[2])),
        com_G=mass.com_G,
        R_GP=mass.R_GP,
        mesh=plan.body.mesh,
        mass_kg=mass.mass_kg,
    )


def require_target_in_view(
    body: Body, cameras: Sequence[Camera], X_NC: Array, X_NG: Array, t_s: Array
) -> None:
    """Raise InputError if a camera is inside the target, or the target is never in view of both.

    X_NC, X_NG: (F, 4, 4) left camera and target at the times t_s (F,). The target may leave the view.
    """
    caster, vertices_G = RayCaster(body), np.asarray(body.mesh.vertices)
    # Some 4000 vertices are projected into the image; rays find what these miss.
    sample_G = vertices_G[:: 1 + len(vertices_G) // 4000]
    low, high = np.asarray(body.mesh.bounds)
    middle_G, corners_G = 0.5 * (low + high), np.asarray(trimesh.bounds.corners(body.mesh.bounds))
    radius_m = float(np.linalg.norm(vertices_G - middle_G, axis=1).max())
    around = even_directions(256)

    def sees(camera: Camera, X_GK: Array) -> bool:
        """Whether a vertex is in the image or, for faces beyond its edges, a ray of a coarse grid hits."""
        if len(camera.project_visible(transform_points(inverse_pose(X_GK), sample_G))[1]) > 0:
            return True
        rays_K = camera.directions(camera.pixel_grid(8).reshape(-1, 2))
        return len(caster.first_hits(X_GK[:3, 3], rays_K @ X_GK[:3, :3].T).ray) > 0

    seen = ahead = together = False
    for X_NC_k, X_NG_k, t in zip(X_NC, X_NG, t_s, strict=True):
        of_frame = []
        for name, camera in zip(("left", "right")[: len(cameras)], cameras, strict=True):
            X_GK = inverse_pose(X_NG_k) @ X_NC_k @ camera.X_CK
            eye_G = X_GK[:3, 3]
            # Inside: nine of ten directions hit the target; not all, as meshes have holes.
            near = np.linalg.norm(eye_G - middle_G) <= radius_m
            if near and len(caster.first_hits(eye_G, around).ray) >= 0.9 * len(around):
                raise InputError(
                    f"scene: the {name} camera is inside the target at {t:g} s (it is {2 * radius_m:.3g} m "
                    "long); move scene.motion.position_m away, or check scene.body.size_m and metres_per_unit"
                )
            of_frame.append(not together and sees(camera, X_GK))
            ahead = ahead or bool((transform_points(inverse_pose(X_GK), corners_G)[:, 2] > 0).any())
        seen, together = seen or any(of_frame), together or all(of_frame)
    if together:
        return
    if seen:
        raise InputError(
            f"scene: the target is in view of one camera, but of both at none of {len(X_NC)} frames; change "
            "scene.rig.baseline_m or scene.motion.position_m"
        )
    where = "beside the images" if ahead else "behind the cameras"
    raise InputError(
        f"scene: the target is never in view, at none of {len(X_NC)} frames: it stays {where}; change "
        "scene.motion.position_m (z is forward) or scene.inspector"
    )
