"""Forty deliberate faults, each of a kind that a person could commit: what the test suite must notice.

A fault is one piece of code, and what replaces it. The piece is looked for in its file and, where it has
moved, in the others; it must occur exactly once, so that a change of the code that removes it is noticed:
then the fault is written anew for the new code.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One defect, and the tests that exercise the code it sits in."""

    kind: str
    """What is wrong, in a few words"""
    file: str
    """Where, relative to the repository"""
    old: str
    new: str
    tests: tuple[str, ...]
    """Test files or folders relative to ``tests/``, run in turn until one fails: the closest first"""


BACKEND = (
    Fault(
        "Euler's equation: cross product the other way round",
        "backend/dynamics/propagation.py",
        "a -= w1 * m2 - w2 * m1",
        "a += w1 * m2 - w2 * m1",
        ("backend/dynamics/test_propagation.py",),
    ),
    Fault(
        "dropped term: the derivative of the rate without the change of the inertia",
        "backend/dynamics/propagation.py",
        "            a -= dJ[0, n] * w[k + 1, n]\n",
        "",
        ("backend/dynamics/test_propagation.py",),
    ),
    Fault(
        "wrong power in the derivative of the disparity",
        "backend/solvers/schur.py",
        "xz, yz, bz = fz * x / z, fz * y / z, fb / z**2",
        "xz, yz, bz = fz * x / z, fz * y / z, fb / z",
        ("backend/solvers/test_ipopt.py",),
    ),
    Fault(
        "off by one: the last observation of each landmark is not eliminated",
        "backend/solvers/schur.py",
        "            for b in range(start[mark], a + 1):\n                kb = np.uint64(stride * frame[b])\n"
        "                for row",
        "            for b in range(start[mark], a):\n                kb = np.uint64(stride * frame[b])\n"
        "                for row",
        ("backend/solvers/test_ipopt.py",),
    ),
    Fault(
        "scale of the kernel not squared in the robust weight",
        "backend/solvers/robust_kernel.py",
        "return np.asarray(1.0 / (1.0 + s / scale**2))",
        "return np.asarray(1.0 / (1.0 + s / scale))",
        ("backend/solvers/test_ipopt.py",),
    ),
    Fault(
        "sign of a derivative of the principal axes",
        "backend/uncertainty/principal_axes.py",
        "axes[1, n] = -M[0, 2] / _gap",
        "axes[1, n] = M[0, 2] / _gap",
        ("backend/test_camera_noise.py",),
    ),
    Fault(
        "left-handed principal axes",
        "backend/problem/inertia.py",
        "R[:, 1] = np.cross(R[:, 2], R[:, 0])",
        "R[:, 1] = np.cross(R[:, 0], R[:, 2])",
        ("backend/problem/test_inertia.py",),
    ),
    Fault(
        "variance instead of standard deviation: the noise of the pixels",
        "backend/noise/measurement_noise.py",
        "np.sqrt([squares[:2].sum() / freedom[:2].sum(), squares[2] / freedom[2]])",
        "np.array([squares[:2].sum() / freedom[:2].sum(), squares[2] / freedom[2]])",
        ("backend/noise", "backend/test_estimate.py::test_pixel_and_disparity_noise_are_recovered"),
    ),
    Fault(
        "frames swapped: a rotation of the pose graph applied in the wrong frame",
        "backend/initialization/pose_graph.py",
        'error = np.einsum("eba,eb->ea", R[i], target)',
        'error = np.einsum("eab,eb->ea", R[i], target)',
        ("backend/initialization/test_pose_graph.py", "backend/initialization"),
    ),
    Fault(
        "the sliding window keeps the frame that is worth least and drops the best",
        "backend/window/marginalize.py",
        "return int(np.argmin(worth))",
        "return int(np.argmax(worth))",
        ("backend/window/test_marginalize.py", "backend/window/test_estimator.py", "backend/window"),
    ),
)
FRONTEND = (
    Fault(
        "factor two: distance of unit descriptors from their product",
        "frontend/features/stereo.py",
        "distance = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0))",
        "distance = np.sqrt(np.maximum(1.0 - top, 0.0))",
        ("frontend/features/test_stereo.py",),
    ),
    Fault(
        "the refined disparity does not follow the slant from the window's centre to the point",
        "frontend/features/stereo.py",
        "return np.sum(warp * arm, axis=1), sigma,",
        "return warp[:, 0], sigma,",
        ("frontend/features/test_stereo.py", "frontend"),
    ),
    Fault(
        "transposed rotation of a covariance between two frames",
        "frontend/matching/ransac.py",
        "W = np.linalg.inv(C_A + R @ C_B @ R.T)",
        "W = np.linalg.inv(C_A + R.T @ C_B @ R)",
        ("frontend/tracks/test_association.py",),
    ),
    Fault(
        "sign: the reference of a track is the view that faces the camera least",
        "frontend/tracks/track_refinement.py",
        "facing = -np.sum(found.R_RS[shown, :, 2] * p, axis=1)",
        "facing = np.sum(found.R_RS[shown, :, 2] * p, axis=1)",
        ("frontend/tracks/test_track_refinement.py", "frontend/tracks/test_association.py"),
    ),
    Fault(
        "offset of the principal points with the wrong sign",
        "frontend/rectification/rectify.py",
        "K[0, 2] -= rig.disparity_offset_px",
        "K[0, 2] += rig.disparity_offset_px",
        ("frontend/rectification/test_rectify.py",),
    ),
    Fault(
        "missing check: landmarks that do not look alike are merged",
        "frontend/tracks/duplicates.py",
        "        if not distance[pair] < max_distance:\n            break\n",
        "",
        ("frontend/tracks/test_duplicates.py",),
    ),
)
SIMULATION = (
    Fault(
        "quaternion kinematics: sign of one product",
        "simulation/motion/integrate.py",
        "out[8] = 0.5 * (w * rate[1] + z * rate[0] - x * rate[2])",
        "out[8] = 0.5 * (w * rate[1] - z * rate[0] + x * rate[2])",
        ("simulation/motion/test_forces.py",),
    ),
    Fault(
        "the lamp's light falls with the distance, not with its square",
        "simulation/rendering/shading.py",
        "at_hit = lights.lamp / reach[visible] ** 2",
        "at_hit = lights.lamp / reach[visible]",
        ("simulation/rendering/test_shading.py", "simulation/rendering"),
    ),
    Fault(
        "tangential distortion with its coefficients swapped",
        "simulation/camera/cameras.py",
        "off_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y",
        "off_y = y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y",
        ("simulation/camera/test_cameras.py",),
    ),
    Fault(
        "unit: noise drawn of grey values, not of electrons",
        "simulation/camera/sensor.py",
        "return digitise(charge / sensor.electrons_per_dn, sensor, rng)",
        "return digitise(charge / sensor.white_dn, sensor, rng)",
        ("simulation/camera/test_sensor.py",),
    ),
    Fault(
        "parallel axis theorem forgotten",
        "simulation/bodies/parts/mass.py",
        "inertia += factor * mass.inertia_per_density + weight * (d @ d * np.eye(3) - np.outer(d, d))",
        "inertia += factor * mass.inertia_per_density",
        ("simulation/bodies/parts/test_mass.py", "simulation/motion/test_mass.py"),
    ),
    Fault(
        "pixel centres off by half a pixel",
        "simulation/camera/cameras.py",
        "return self.directions(np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64))",
        "return self.directions(np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64) + 0.5)",
        ("simulation/camera/test_cameras.py", "simulation/test_depth.py"),
    ),
)
MAPPING = (
    Fault(
        "row and column of the projection swapped",
        "mapping/fusion/integration.py",
        "pixel = v[hit] * w + u[hit]",
        "pixel = u[hit] * w + v[hit]",
        ("mapping/fusion/test_field.py", "mapping"),
    ),
    Fault(
        "pose where its inverse is needed",
        "mapping/fusion/integration.py",
        "np.ascontiguousarray(inverse_pose(X_RG)),\n            grid.voxel_m,",
        "np.ascontiguousarray(X_RG),\n            grid.voxel_m,",
        ("mapping/fusion/test_field.py", "mapping"),
    ),
    Fault(
        "sign of the rotation's derivative in the alignment of a frame",
        "mapping/fusion/frame_alignment.py",
        "by_turn = np.cross(along, away)",
        "by_turn = np.cross(away, along)",
        ("mapping/fusion/test_frame_alignment.py", "mapping"),
    ),
    Fault(
        "missing check: holes that a frame looked through are closed",
        "mapping/finishing/hole_closing.py",
        "    if patches and views and rig is not None:\n",
        "    if False and patches and views and rig is not None:\n",
        ("mapping/finishing/test_hole_closing.py", "mapping"),
    ),
)
PLANNING = (
    Fault(
        "wrong exponent in the spread of the position by white acceleration",
        "planning/prediction.py",
        "out[:, i, i] = accel_psd * time_s[:, None] ** 3 / 3",
        "out[:, i, i] = accel_psd * time_s[:, None] ** 2 / 3",
        ("planning/test_prediction.py", "planning"),
    ),
    Fault(
        "transposed rotation in the swept volume",
        "planning/keep_out/distance_fields.py",
        "gx = A[0, 0] * dx + A[1, 0] * dy + A[2, 0] * dz",
        "gx = A[0, 0] * dx + A[0, 1] * dy + A[0, 2] * dz",
        ("planning/keep_out/test_volumes.py", "planning"),
    ),
    Fault(
        "scalar part of an exported quaternion first instead of last",
        "planning/exports/ccsds.py",
        "rows = np.hstack([wxyz[:, [1, 2, 3, 0]], np.rad2deg(w_F)])",
        "rows = np.hstack([wxyz, np.rad2deg(w_F)])",
        (
            "pipeline/test_export_programs.py::test_a_ccsds_library_validates_the_aem_and_its_rates_turn_the_attitude",
        ),
    ),
    Fault(
        "scale of shifts by the radius applied the wrong way round",
        "planning/edges/information.py",
        "return np.array([radius_m] * 3 + [1.0] * 3)",
        "return np.array([1.0 / radius_m] * 3 + [1.0] * 3)",
        ("planning/edges/test_contributions.py", "benchmarks/edges/trajectory"),
    ),
)
PIPELINE_AND_CLI = (
    Fault(
        "columns of trajectory.csv exchanged: velocity before position",
        "pipeline/run_directory/trajectory_file.py",
        "states = np.hstack([trajectory.r_N, trajectory.v_N, trajectory.q_NP_wxyz, trajectory.w_P])",
        "states = np.hstack([trajectory.v_N, trajectory.r_N, trajectory.q_NP_wxyz, trajectory.w_P])",
        ("pipeline/run_directory/test_trajectory_file.py",),
    ),
    Fault(
        "what stood in the run directory is lost when a run ends with the user's mistake",
        "pipeline/run_directory/run_folder.py",
        "failed = isinstance(error, Exception) and not isinstance(error, InputError)",
        "failed = isinstance(error, Exception)",
        ("pipeline/run_directory/test_run_folder.py", "pipeline/test_faults_in_files.py"),
    ),
    Fault(
        "sign of the lever arm from the centre of mass to the origin of the mesh",
        "pipeline/evaluation.py",
        "return make_pose(R_NG, states.r_N - R_NG @ com_G)",
        "return make_pose(R_NG, states.r_N + R_NG @ com_G)",
        ("pipeline/test_evaluation.py",),
    ),
    Fault(
        "bad input unhandled: a standard deviation of zero passes",
        "pipeline/run_directory/archives.py",
        "if np.any(sigma_px <= 0.0):",
        "if np.any(sigma_px < 0.0):",
        ("pipeline/run_directory/test_archives.py", "pipeline/test_faults_in_files.py"),
    ),
    Fault(
        "wrong exit code for the user's mistake",
        "cli/main.py",
        "return _fail(InputError.exit_code, str(error), debug)",
        "return _fail(RunFailure.exit_code, str(error), debug)",
        ("cli/test_main.py",),
    ),
)
COMPARE = (
    Fault(
        "the front of time against accuracy: slower counts as faster",
        "compare/ranking.py",
        "faster = (1.0 + NOISE) * row.wall_s < other.wall_s",
        "faster = (1.0 + NOISE) * row.wall_s > other.wall_s",
        ("compare/test_ranking.py", "compare"),
    ),
    Fault(
        "the assessment forgets the remaining decrease of the landmarks",
        "compare/problem/assessment.py",
        "gain = 0.5 * float(g @ cho_solve(factor, g)) + 0.5 * float(of_landmarks)",
        "gain = 0.5 * float(g @ cho_solve(factor, g))",
        ("compare/problem/test_assessment.py",),
    ),
)
POLHODE = (
    Fault(
        "offset of the disparity ignored in the triangulation",
        "polhode/camera.py",
        "z = self.focal_px * self.baseline_m / (uvd[..., 2] - self.disparity_offset_px)",
        "z = self.focal_px * self.baseline_m / uvd[..., 2]",
        ("polhode/test_triangulation.py", "polhode", "frontend/features/test_stereo.py"),
    ),
    Fault(
        "not atomic: a file that was written by half is published when its writer fails",
        "polhode/atomic.py",
        "        partial.replace(path)\n    finally:\n        partial.unlink(missing_ok=True)\n",
        "    finally:\n        partial.replace(path)\n",
        ("polhode/test_atomic.py",),
    ),
    Fault(
        "series of the Jacobian of rotations near zero",
        "polhode/lie.py",
        "a = np.where(small, 0.5 - angle**2 / 24.0,",
        "a = np.where(small, 1.0 - angle**2 / 24.0,",
        ("polhode/test_lie.py", "polhode"),
    ),
)
FAULTS = (*BACKEND, *FRONTEND, *SIMULATION, *MAPPING, *PLANNING, *PIPELINE_AND_CLI, *COMPARE, *POLHODE)
