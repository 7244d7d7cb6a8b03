"""All that is decided before rendering: body, mass, cameras, motion, and which frames are dropped."""

from dataclasses import dataclass

import numpy as np

from polhode.config import scene as config
from polhode.config.scene import Scene
from polhode.errors import InputError
from polhode.lie import Array
from polhode.records import Truth
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.camera.cameras import Camera, build_cameras
from polhode.simulation.dataset.view_check import require_target_in_view
from polhode.simulation.motion import (
    InspectorMotion,
    MassDistribution,
    TargetMotion,
    inspector_motion,
    mass_distribution,
    target_motion,
)
from polhode.simulation.sky.background import Sky


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
    def X_NC(self) -> Array:
        """(F, 4, 4) left camera at the frames"""
        return self.inspector.X_NC

    def time_s(self, k: int) -> float:
        """Time of frame k after the first one [s]."""
        return float((self.target.timestamps_ns[k] - self.target.timestamps_ns[0]) * 1e-9)


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
    require_target_in_view(body, plan.cameras, plan.X_NC[frames], plan.target.X_NG[frames], t_s)
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
