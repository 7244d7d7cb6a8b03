"""A worked example: fly around a tumbling target that a run has measured, and see whether the plan holds.

    python -m examples.inspect_tumbling RUN SEQ -o DIR [--duration 60]

RUN is a run of the sequence SEQ, which has a truth (``make demo`` makes one of the shipped sample). From the
run alone: the target's motion, its time-dependent keep-out volume at 99 %, and a way from the camera to the
far side that stays out of it (CasADi, IPOPT). Then MuJoCo flies it: the target tumbles from the *true* state
with the true inertia, by MuJoCo's own integration; the inspector is pushed along the plan by forces. Printed
is how close the surfaces come, beside what was promised. DIR gets flight.csv.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, Ints, matrix_from_wxyz, wxyz_from_matrix
from polhode.planning.approach.trajectory import (
    ApproachTask,
    ApproachTrajectory,
    min_distance,
    plan_trajectory,
)
from polhode.planning.keep_out.measured_body import sample_surface
from polhode.planning.keep_out.queries import InstantKeepOut
from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out
from polhode.planning.plan import final_estimate, surface_of
from polhode.records.metrics import truth_at
from polhode.records.read_truth import read_truth
from polhode.records.truth import Truth
from polhode.run_directory.archives import read_occupancy
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError

RADIUS_M, MASS_KG, MAX_FORCE_N = 0.06, 4.5, 0.22
CLEARANCE_M = 0.03
STEP_S = 0.01
STIFFNESS, DAMPING = 0.2, 1.0
"""Of the inspector's own control, per kg: it holds the plan against what integration makes of it."""


@dataclass(frozen=True)
class Flight:
    """What happened, every tenth of a second."""

    time_s: Array
    inspector_N: Array
    r_N: Array
    q_NP_wxyz: Array
    contacts: int


def main() -> int:
    """Plan, fly, judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds")
    options = parser.parse_args()
    try:
        import mujoco  # noqa: F401
    except ImportError:
        print("error: this example needs MuJoCo: pip install 'mujoco>=3.2'", file=sys.stderr)
        return 2
    try:
        return example(options.run, options.sequence, options.output, options.duration)
    except (InputError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return InputError.exit_code


def example(run: Path, sequence: Path, folder: Path, duration_s: float) -> int:
    """Returns 0 when the flight kept what was promised."""
    # planning takes a minute: what flying needs besides is asked for first
    truth = read_truth(sequence)
    if truth.mesh is None:
        raise InputError(f"{sequence}: the truth has no mesh.ply, against which to measure the flight")
    last_ns = read_trajectory(run).timestamps_ns[-1:]
    truth_at(truth, last_ns)
    estimate, _ = final_estimate(run)
    surface = surface_of(run)
    folder.mkdir(parents=True, exist_ok=True)
    found = keep_out(surface, estimate, KeepOutOptions(duration_s, 0.99), read_occupancy(run))
    volume = found.instant
    motion = volume.motion
    end, begin = motion.com_N[-1], motion.com_N[0]
    start = np.zeros(3)
    side = np.cross(begin - start, [0.0, 1.0, 0.0])
    reach = volume.body.radius_m + RADIUS_M + CLEARANCE_M
    task = ApproachTask(
        start, 2.0 * end - start, 0.5 * (begin + end) + 1.3 * reach * side / np.linalg.norm(side),
        duration_s, max(10, int(duration_s)), RADIUS_M, CLEARANCE_M, MAX_FORCE_N / MASS_KG,
    )  # fmt: skip
    trajectory = plan_trajectory(volume, task)
    promised, expected = promise(volume, trajectory, surface.mesh)
    print(f"Planned: {trajectory.delta_v_m_s:.4f} m/s over {duration_s:g} s, {len(trajectory.accel_N)} steps")
    print(f"Bound at 99 %: never closer than {1e3 * promised:.1f} mm; expected {1e3 * expected:.1f} mm")
    flight = fly(trajectory, truth, last_ns)
    distance = separation(flight, truth)
    k = int(np.argmin(distance))
    off = np.linalg.norm(flight.inspector_N - trajectory.at(flight.time_s)[0], axis=1).max()
    print(
        f"Flown in MuJoCo against the true tumble: closest {1e3 * distance[k]:.1f} mm "
        f"after {flight.time_s[k]:.1f} s "
        f"({1e3 * (distance[k] - expected):+.1f} mm from the expected distance); contacts {flight.contacts}; "
        f"off the planned trajectory by at most {1e3 * off:.2f} mm"
    )
    rows = np.column_stack([flight.time_s, flight.inspector_N, flight.r_N, flight.q_NP_wxyz, distance])
    header = (
        "time_s,inspector_N_x,inspector_N_y,inspector_N_z,r_N_x,r_N_y,r_N_z,q_NP_w,q_NP_x,q_NP_y,q_NP_z,gap_m"
    )
    np.savetxt(folder / "flight.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    kept = bool(distance[k] >= promised) and flight.contacts == 0
    print(f"The promise is {'kept' if kept else 'BROKEN'}: {folder}")
    return 0 if kept else 1


def promise(volume: InstantKeepOut, trajectory: ApproachTrajectory, mesh: Any) -> tuple[float, float]:
    """Gaps [m]: from the keep-out volume, never less at 99 %; from the estimated surface, expected."""
    motion = volume.motion
    p, _, _ = trajectory.at(motion.time_s)
    q, _, _ = sample_surface(mesh, np.zeros(len(mesh.vertices)), 0.003)
    p_G = np.einsum("tji,tj->ti", motion.R_NG, p - motion.p_NG)
    expected = float(cKDTree(q).query(p_G)[0].min()) - RADIUS_M
    return min_distance(volume, trajectory) - RADIUS_M, expected


def separation(flight: Flight, truth: Truth) -> Array:
    """Gap (n,) [m] between the inspector and the true surface."""
    assert truth.mesh is not None
    q, _, _ = sample_surface(truth.mesh, np.zeros(len(truth.mesh.vertices)), 0.003)
    R_NP = matrix_from_wxyz(flight.q_NP_wxyz)
    p_P = np.einsum("tji,tj->ti", R_NP, flight.inspector_N - flight.r_N)
    return np.asarray(cKDTree(q).query(p_P @ truth.R_GP.T + truth.com_G)[0] - RADIUS_M)


def fly(trajectory: ApproachTrajectory, truth: Truth, last_ns: Ints) -> Flight:
    """Let MuJoCo move both."""
    import mujoco

    state = truth_at(truth, last_ns)
    model = build(truth)
    model.opt.timestep = STEP_S
    data = mujoco.MjData(model)
    data.qpos[0:3], data.qpos[3:7] = state.r_N[0], wxyz_from_matrix(state.R_NP[0])
    data.qvel[0:3], data.qvel[3:6] = state.v_N[0], state.w_P[0]
    data.qpos[7:10], data.qpos[10] = trajectory.p_N[0], 1.0
    steps = round(trajectory.time_s[-1] / STEP_S)
    rows, contacts = [], 0
    for n in range(steps + 1):
        now = np.array([n * STEP_S])
        p, v, a = (each[0] for each in trajectory.at(now))
        if n % round(0.1 / STEP_S) == 0:
            rows.append(np.concatenate([now, data.qpos[7:10], data.qpos[0:7]]))
        force = MASS_KG * (a + STIFFNESS * (p - data.qpos[7:10]) + DAMPING * (v - data.qvel[6:9]))
        data.xfrc_applied[2, :3] = force * min(1.0, MAX_FORCE_N / max(float(np.linalg.norm(force)), 1e-12))
        mujoco.mj_step(model, data)
        contacts += int(data.ncon > 0)
    table = np.array(rows)
    return Flight(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:11], contacts)


def build(truth: Truth) -> Any:
    """Target and inspector, both free."""
    import mujoco

    assert truth.mesh is not None
    mass = truth.mass_kg or 1.0
    vertices_P = (np.asarray(truth.mesh.vertices) - truth.com_G) @ truth.R_GP
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    mesh = spec.add_mesh(name="target", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    mesh.uservert = vertices_P.astype(np.float32).ravel()
    mesh.userface = np.asarray(truth.mesh.faces).astype(np.int32).ravel()
    target = spec.worldbody.add_body(name="target", mass=mass, inertia=truth.moments, explicitinertial=True)
    target.add_freejoint()
    target.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="target", mass=0.0)
    inspector = spec.worldbody.add_body(name="inspector")
    inspector.add_freejoint()
    inspector.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_M, 0, 0], mass=MASS_KG)
    return spec.compile()


if __name__ == "__main__":
    sys.exit(main())
