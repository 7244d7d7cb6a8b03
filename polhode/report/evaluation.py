"""A run against the truth: metrics and a table. Nothing else reads the truth.

The estimated and the true mesh are in different frames G. The motion alone aligns them: at every frame the
estimated pose maps the estimated mesh into N and the true pose maps it back into the true G; the rigid
transform that fits all frames best is applied. Surfaces are not aligned: an error of the motion that is
common to all frames shows in the mesh.

Completeness is measured on the part of the true surface that the left camera saw lit. A point counts when, in
at least one frame, it lies inside the image, nothing occludes it (rays cast with embree from the true poses),
it is not seen edge-on, and the left image is brighter there than the sky.
"""

from dataclasses import asdict, dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Column, Table

from polhode.backend.problem.inertia import FORMS, InertiaForm, unit_determinant
from polhode.config.loader import load_stored_config
from polhode.geometry import fisheye
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, log_so3, make_pose, transform_points
from polhode.geometry.rigid_body import HALF_TURN_NAMES, HALF_TURNS, propagate
from polhode.geometry.rigid_fit import mean_rotation
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.visibility import CLEARANCE, Caster, light_level
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.mesh_metrics import SAMPLES, compare_surfaces, sample_surface
from polhode.records.metrics import (
    ALIGNED,
    COVERAGE,
    COVERAGE_CONSTANTS,
    IN_INTERVAL,
    NEES,
    States,
    angle_deg,
    constant_body_rotation,
    coverage,
    expected_range,
    motion_errors,
    nees,
    state_scores,
    truth_at,
    with_half_turn,
)
from polhode.records.read_truth import read_truth
from polhode.records.surface import ErrorCorrelation
from polhode.records.surface_errors import sigma_shares
from polhode.records.truth import Truth
from polhode.run_directory.archives import read_covariance
from polhode.run_directory.recording import require_recording
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Inertia, Rotation, Summary, correlation_of
from polhode.run_directory.trajectory_file import read_trajectory, require_same_frames, target_poses
from polhode.runtime.errors import InputError

Metrics = dict[str, Any]


def evaluate(run_folder: Path, sequence_folder: Path) -> Metrics:
    """Compare a run with the truth of its sequence: what RUN/metrics.json will hold.

    Values that cannot be computed (undetermined, or no truth that far) are None, ``null`` in the file.
    Raises InputError when the run has no estimate, or the sequence no truth or other images than the run's.
    """
    summary, inertia, estimate, truth = _run_and_truth(run_folder, sequence_folder)
    covariance = read_covariance(run_folder)
    require_same_frames(run_folder, estimate, covariance.timestamps_ns, "covariance.npz")
    true_states = truth_at(truth, estimate.timestamps_ns)
    R_GP, com_G = np.array(summary.R_GP), np.array(summary.com_G)
    X_NG = target_poses(estimate, R_GP, com_G)
    X_NG_true = target_poses(true_states, truth.R_GP, truth.com_G)
    # the estimate's G is fixed at the first frame: the truth in G follows from the true state there
    com_true_G = (inverse_pose(X_NG[0]) @ np.append(true_states.r_N[0], 1.0))[:3]
    R_GP_true = X_NG[0, :3, :3].T @ true_states.R_NP[0]

    errors = asdict(motion_errors(estimate, true_states))
    half_turn = errors.pop("half_turn")
    of_nees, of_coverage = state_scores(estimate, true_states, covariance.covariance, half_turn)
    attitude = {"median": errors.pop("attitude_median_deg"), "max": errors.pop("attitude_max_deg")}
    with_axes = {name: errors.pop(f"attitude_with_axes_{name}_deg") for name in ("median", "max")}
    metrics: Metrics = {
        **errors,
        "attitude_error_deg": attitude,
        "attitude_error_with_axes_deg": with_axes,
        "half_turn": HALF_TURN_NAMES[half_turn],
        NEES: of_nees,
        COVERAGE: of_coverage,
        "error_k1": inertia.k1 - truth.k1,
        "error_k2": inertia.k2 - truth.k2,
    }
    form = FORMS[load_stored_config(run_folder / "config.yaml").backend.inertia]
    J_true = R_GP_true @ np.diag(truth.moments) @ R_GP_true.T
    between = R_GP.T @ R_GP_true
    nearest = HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))]
    of_mass = {
        "inertia": (inertia_parameter_error(np.array(inertia.J_G), J_true, form), inertia.cov_J),
        "com": (com_G - com_true_G, summary.cov_com_G),
        "axes": (-log_so3(between * nearest), summary.cov_R_GP),
    }
    constants = {name: (error, np.array(cov, dtype=np.float64)) for name, (error, cov) in of_mass.items()}
    metrics[NEES] |= {name: nees(error[None], cov[None]) for name, (error, cov) in constants.items()}
    metrics[COVERAGE_CONSTANTS] = {name: coverage(error, cov) for name, (error, cov) in constants.items()}
    if (intervals := summary.intervals) is not None:
        shift = R_GP.T @ (com_true_G - com_G)
        ends = {"k1": (intervals.k1, truth.k1), "k2": (intervals.k2, truth.k2)}
        for axis, interval, moved in zip("xyz", intervals.com_shift_P or (), shift, strict=False):
            ends[f"com_{axis}"] = (interval, float(moved))
        found = {name: at[0] <= value <= at[1] for name, (at, value) in ends.items() if at is not None}
        if intervals.com_G is not None:
            low, high = np.array(intervals.com_G)
            found["com_G"] = bool(np.all(low <= com_true_G) and np.all(com_true_G <= high))
        metrics[IN_INTERVAL] = found
    if (rotation := summary.rotation) is not None:
        metrics["rotation"], of_rotation = _rotation_errors(rotation, true_states, truth.moments)
        metrics[NEES] |= of_rotation
    metrics |= _prediction_errors(estimate, true_states, half_turn, truth, np.array(inertia.moments))
    correlation = None if summary.mesh is None else correlation_of(summary.mesh)
    metrics["mesh"] = _mesh_metrics(run_folder, sequence_folder, truth, X_NG, X_NG_true, correlation)
    return metrics


def _run_and_truth(run_folder: Path, sequence_folder: Path) -> tuple[Summary, Inertia, States, Truth]:
    """A run with an estimate, its states, and the truth of its own recording. Raises InputError."""
    summary = read_summary(run_folder)
    if summary.inertia is None or summary.com_G is None or summary.R_GP is None:
        raise InputError(f"{run_folder}: the run has no estimate; nothing to evaluate")
    table = read_trajectory(run_folder)
    truth = read_truth(sequence_folder)
    require_recording(summary.data, sequence_folder)
    states = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    return summary, summary.inertia, states, truth


def _rotation_errors(found: Rotation, true_states: States, moments: Array) -> tuple[Metrics, Metrics]:
    """Errors of angular momentum and spin axis at the last pair, and their NEES."""
    h_N = true_states.R_NP[-1] @ (moments / moments[1] * true_states.w_P[-1])
    size = float(np.linalg.norm(h_N))
    off, sigma = found.momentum_rad_s - size, found.sigma_momentum_rad_s
    errors: Metrics = {"momentum_size_percent": 100.0 * off / size}
    of_nees: Metrics = {"momentum_size": None if sigma is None else (off / sigma) ** 2}
    both = {"momentum": (found.momentum_N, h_N), "spin": (found.spin_N, true_states.w_N[-1])}
    for name, (one, true_N) in both.items():
        unit, true_unit = np.array(one.unit), true_N / max(float(np.linalg.norm(true_N)), 1e-300)
        angle = np.arctan2(np.linalg.norm(np.cross(unit, true_unit)), unit @ true_unit)
        errors[f"{name}_direction_deg"], of_nees[name] = float(np.rad2deg(angle)), None
        if one.sigma_deg is not None:
            inverse = np.linalg.pinv(np.array(one.cov, dtype=np.float64), rcond=1e-6, hermitian=True)
            of_nees[name] = float((unit - true_unit) @ inverse @ (unit - true_unit))
    return errors, of_nees


def _prediction_errors(
    estimate: States, true_states: States, half_turn: int, truth: Truth, moments: Array
) -> Metrics:
    """Errors of position and attitude 10, 30 and 60 s past the last image, as far as the truth reaches.

    The attitude is compared as in ``attitude_error_deg``: after the constant body rotation of the run itself.
    """
    R_fit = constant_body_rotation(with_half_turn(estimate, half_turn), true_states)
    end_ns = int(estimate.timestamps_ns[-1])
    reach_s = (int(truth.timestamps_ns[-1]) - end_ns) * 1e-9
    degrees: dict[str, float | None] = dict.fromkeys(("10", "30", "60"))
    metres = dict(degrees)
    horizons = [int(h) for h in degrees if int(h) <= reach_s + 1e-6]
    if horizons:
        at = truth_at(truth, end_ns + np.array(horizons, dtype=np.int64) * 1_000_000_000)
        last = estimate.r_N[-1], estimate.v_N[-1], estimate.R_NP[-1], estimate.w_P[-1]
        r_N, v_N, R_NP, w_P = propagate([0.0, *horizons], *last, np.diag(moments))
        predicted = with_half_turn(States(at.timestamps_ns, r_N[1:], v_N[1:], R_NP[1:], w_P[1:]), half_turn)
        angles = angle_deg(np.swapaxes(predicted.R_NP @ R_fit, -1, -2) @ at.R_NP)
        distances = np.linalg.norm(predicted.r_N - at.r_N, axis=1)
        for h, angle, distance in zip(horizons, angles, distances, strict=True):
            degrees[str(h)], metres[str(h)] = float(angle), float(distance)
    return {"prediction_error_deg": degrees, "prediction_error_m": metres}


def inertia_parameter_error(J: Array, J_true: Array, form: InertiaForm) -> Array:
    """Estimate minus truth (5,) in the solver's parameters around the estimate; J (3, 3) in G, any scale."""

    def second_moments(J: Array) -> Array:
        return np.asarray(0.5 * np.trace(J) * np.eye(3) - J)

    xi, R_ref = form.coordinates(second_moments(J))
    target = unit_determinant(second_moments(J_true))
    x, upper = xi.copy(), np.triu_indices(3)
    for _ in range(30):
        residual = (form.second_moments(x, R_ref) - target)[upper]
        jacobian = form.derivative(x, R_ref)[:, *upper].T
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        x = x + step * min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        if np.abs(step).max() < 1e-12:
            break
    return np.asarray(xi - x)


def _mesh_metrics(
    run_folder: Path,
    sequence_folder: Path,
    truth: Truth,
    X_NG: Array,
    X_NG_true: Array,
    correlation: tuple[ErrorCorrelation, ...] | None,
) -> dict[str, float | None] | None:
    """Distances between the surfaces, and how many of the vertices' errors their sigmas hold."""
    if truth.mesh is None or not (run_folder / "mesh.ply").is_file():
        return None
    surface = read_ply(run_folder / "mesh.ply")
    if len(surface.mesh.faces) == 0:
        return None
    in_true_G = surface.mesh.copy()
    in_true_G.apply_transform(between_target_frames(X_NG, X_NG_true, surface.mesh.centroid))
    points = seen_truth(truth.mesh, X_NG_true, open_sequence(sequence_folder))
    if len(points) == 0:
        return None
    distances = asdict(compare_surfaces(in_true_G, truth.mesh, points))
    return {**distances, **sigma_shares(in_true_G, surface.sigma_m, truth.mesh, correlation)}


def between_target_frames(X_NG: Array, X_NG_true: Array, centre_G: Array) -> Array:
    """X_G*G (4, 4): the estimate's G in the true one, averaged over the frames (F, 4, 4) each.

    Rotations by their chordal mean; translations by the mean image of ``centre_G``, the centre of the mesh.
    """
    between = inverse_pose(X_NG_true) @ X_NG
    R = mean_rotation(between[:, :3, :3])
    moved = np.mean(between[:, :3, :3] @ centre_G + between[:, :3, 3], axis=0)
    return make_pose(R, moved - R @ centre_G)


def seen_truth(
    mesh: trimesh.Trimesh, X_NG_true: Array, sequence: StereoSequence, min_frames: int = 1
) -> Array:
    """Points (n, 3) of the true surface, in the true G, seen and lit in at least ``min_frames`` frames."""
    points, normals = sample_surface(mesh, SAMPLES)
    if len(sequence) != len(X_NG_true):
        raise InputError(f"{sequence.folder}: not the sequence of this run (other number of pairs)")
    return points[seen_and_lit(mesh, points, normals, X_NG_true, sequence, min_frames)]


def seen_and_lit(
    mesh: trimesh.Trimesh,
    p_G: Array,
    normal_G: Array,
    X_NG: Array,
    sequence: StereoSequence,
    min_frames: int = 1,
) -> Bools:
    """(n,) true where a point of the true surface was seen and lit, in at least ``min_frames`` frames.

    mesh, p_G (n, 3), normal_G (n, 3) in the true G [m]; X_NG (F, 4, 4) true poses at the sequence's pairs.
    At most 60 frames are used, evenly spread.
    """
    caster, rig = Caster(mesh), sequence.calibration
    found = np.zeros(len(p_G), dtype=np.int64)
    for k in np.unique(np.linspace(0, len(X_NG) - 1, min(len(X_NG), 60)).round().astype(int)):
        X_CG = inverse_pose(sequence.X_NC[k]) @ X_NG[k]
        left = sequence.read_left(int(k))[0]
        # Points seen often enough need no further test.
        candidate = np.flatnonzero(found < min_frames)
        p_C = transform_points(X_CG, p_G[candidate])
        front = p_C[:, 2] > 1e-6
        uv = np.full((len(p_C), 2), -1.0)
        if rig.fisheye0:
            uv[front] = fisheye.project(p_C[front], rig.K0, rig.dist0)
        elif front.any():
            projected, _ = cv2.projectPoints(p_C[front], np.zeros(3), np.zeros(3), rig.K0, rig.dist0)
            uv[front] = projected.reshape(-1, 2)
        # lit: on a pixel of the recorded image that is brighter than the sky
        column, row = np.round(np.nan_to_num(uv, nan=-1.0)).clip(-1, 1e6).astype(np.int64).T
        inside = front & (column >= 0) & (column < rig.width_px) & (row >= 0) & (row < rig.height_px)
        smooth = cv2.blur(left.astype(np.float32), (3, 3))
        inside[inside] = smooth[row[inside], column[inside]] > light_level(left)
        lit, eye_G = candidate[inside], inverse_pose(X_CG)[:3, 3]
        found[lit[caster.sees(eye_G, p_G[lit], normal_G[lit], CLEARANCE * mesh.scale)]] += 1
    return np.asarray(found >= min_frames)


@dataclass(frozen=True)
class TrueBody:
    """Points of the true surface, and how they move after the last pair."""

    p_G: Array
    """(n, 3) in the true G [m]"""
    seen: Bools
    """(n,) whether any frame saw the point in light"""
    X_NG: Array
    """(T, 4, 4) true poses"""
    last_X_NG: Array
    """(4, 4) true pose at the last pair"""
    last_estimate_X_NG: Array
    """(4, 4) of the run's G there"""


def true_body_ahead(run_folder: Path, sequence_folder: Path, time_s: Array, count: int) -> TrueBody:
    """Sample ``count`` points and move them; time_s (T,) after the last pair.

    Raises InputError: the sequence has no truth or none that reaches so far, no mesh, or is not the run's.
    """
    summary, _, estimate, truth = _run_and_truth(run_folder, sequence_folder)
    if truth.mesh is None:
        raise InputError(f"{sequence_folder}: the truth has no mesh")
    ahead_ns = estimate.timestamps_ns[-1] + np.round(time_s * 1e9).astype(np.int64)
    X_NG, X_frames = (
        target_poses(truth_at(truth, times), truth.R_GP, truth.com_G)
        for times in (ahead_ns, estimate.timestamps_ns)
    )
    estimated = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))
    points, normals = sample_surface(truth.mesh, count)
    seen = seen_and_lit(truth.mesh, points, normals, X_frames, open_sequence(sequence_folder))
    return TrueBody(points, seen, X_NG, X_frames[-1], estimated[-1])


def truth_of_frames(sequence_folder: Path, timestamps_ns: Ints) -> Truth | None:
    """The truth of a sequence at its frames' instants (F,), without the surface; None: it has none.

    Raises InputError when the truth does not cover the frames.
    """
    if not (sequence_folder / "mav0" / "target0").is_dir():
        return None
    truth = read_truth(sequence_folder)
    at = truth_at(truth, timestamps_ns)
    states: Metrics = {"r_N": at.r_N, "R_NP": at.R_NP, "v_N": at.v_N, "w_P": at.w_P}
    return replace(truth, timestamps_ns=timestamps_ns, mesh=None, **states)


def format_table(metrics: Metrics) -> str:
    """Everything in metrics.json, one line each, as text, beside what is expected if the sigmas are right."""
    units = {"_deg_s": "deg/s", "_m_s": "m/s", "_deg": "deg", "_mm": "mm", "_m": "m", "_px": "px", "_s": "s"}
    table = Table(
        Column(style="bold"),
        Column("found", justify="right"),
        "unit",
        "expected",
        title="Estimate minus truth",
    )
    for key, value in metrics.items():
        for name, part in (value if isinstance(value, dict) else {"": value}).items():
            label = f"{key} {name}".strip() + (f"\n  {ALIGNED[key]}" if name and key in ALIGNED else "")
            found = f"{part:.4g}" if isinstance(part, float) else str(part)
            # as its own name or that of its group ends
            unit = next(
                (unit for text in (name, key) for end, unit in units.items() if text.endswith(end)), ""
            )
            expected = expected_range(key, name) if name else None
            words = "" if expected is None else f"{expected[0]:.2g} to {expected[1]:.3g}"
            words = "True" if key == IN_INTERVAL else words
            table.add_row(label, "not available" if part is None else found, unit, words)
    console = Console(width=100, file=StringIO(), force_terminal=False)
    with console.capture() as capture:
        console.print(table)
    return capture.get()
