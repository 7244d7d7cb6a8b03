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
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Column, Table

from polhode.backend.problem.inertia import FORMS, InertiaForm, unit_determinant
from polhode.config.loader import load_config
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
    state_coverage,
    state_nees,
    truth_at,
    with_half_turn,
)
from polhode.records.read_truth import read_truth
from polhode.records.surface import ErrorCorrelation
from polhode.records.surface_errors import sigma_shares
from polhode.records.truth import Truth
from polhode.run_directory.archives import Covariance, read_covariance
from polhode.run_directory.recording import require_recording
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Intervals, Summary, correlation_of
from polhode.run_directory.trajectory_file import read_trajectory, require_same_frames, target_poses
from polhode.runtime.errors import InputError

MAX_FRAMES = 60
HORIZONS_S = (10, 30, 60)
Metrics = dict[str, Any]


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
    caster = Caster(mesh)
    found = np.zeros(len(p_G), dtype=np.int64)
    count = len(X_NG)
    for k in np.unique(np.linspace(0, count - 1, min(count, MAX_FRAMES)).round().astype(int)):
        X_CG = inverse_pose(sequence.X_NC[k]) @ X_NG[k]
        left = sequence.read_left(int(k))[0]
        # Points seen often enough need no further test.
        candidate = np.flatnonzero(found < min_frames)
        lit = candidate[_is_bright(left, transform_points(X_CG, p_G[candidate]), sequence)]
        eye_G = inverse_pose(X_CG)[:3, 3]
        found[lit[caster.sees(eye_G, p_G[lit], normal_G[lit], CLEARANCE * mesh.scale)]] += 1
    return np.asarray(found >= min_frames)


def _is_bright(left: NDArray[np.uint8], p_C: Array, sequence: StereoSequence) -> Bools:
    """(n,) true where a point projects onto a pixel of the recorded image that is brighter than the sky."""
    rig = sequence.calibration
    front = p_C[:, 2] > 1e-6
    uv = np.full((len(p_C), 2), -1.0)
    if rig.fisheye0:
        uv[front] = fisheye.project(p_C[front], rig.K0, rig.dist0)
    elif front.any():
        projected, _ = cv2.projectPoints(p_C[front], np.zeros(3), np.zeros(3), rig.K0, rig.dist0)
        uv[front] = projected.reshape(-1, 2)
    smooth = cv2.blur(left.astype(np.float32), (3, 3))
    column, row = np.round(np.nan_to_num(uv, nan=-1.0)).clip(-1, 1e6).astype(np.int64).T
    inside = front & (column >= 0) & (column < rig.width_px) & (row >= 0) & (row < rig.height_px)
    bright = np.zeros(len(p_C), dtype=np.bool_)
    bright[inside] = smooth[row[inside], column[inside]] > light_level(left)
    return bright


def evaluate(run_folder: Path, sequence_folder: Path) -> Metrics:
    """Compare a run with the truth of its sequence: what RUN/metrics.json will hold.

    Values that cannot be computed (undetermined, or no truth that far) are None, ``null`` in the file.
    Raises InputError when the run has no estimate, or the sequence no truth or other images than the run's.
    """
    summary = read_summary(run_folder)
    if summary.inertia is None or summary.com_G is None or summary.R_GP is None:
        raise InputError(f"{run_folder}: the run has no estimate; nothing to evaluate")
    table = read_trajectory(run_folder)
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    covariance = read_covariance(run_folder)
    require_same_frames(run_folder, table, covariance.timestamps_ns, "covariance.npz")
    truth = read_truth(sequence_folder)
    require_recording(summary.data, sequence_folder)
    true_states = truth_at(truth, estimate.timestamps_ns)
    X_NG = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))
    X_NG_true = target_poses(true_states, truth.R_GP, truth.com_G)
    form = FORMS[load_config(run_folder / "config.yaml").backend.inertia]
    # the estimate's G is fixed at the first frame: the truth in G follows from the true state there
    com_true_G = (inverse_pose(X_NG[0]) @ np.append(true_states.r_N[0], 1.0))[:3]
    R_GP_true = X_NG[0, :3, :3].T @ true_states.R_NP[0]
    metrics = _motion_metrics(estimate, true_states, covariance)
    metrics["error_k1"] = summary.inertia.k1 - truth.k1
    metrics["error_k2"] = summary.inertia.k2 - truth.k2
    of_mass = _mass_metrics(summary, truth.moments, R_GP_true, com_true_G, form)
    metrics[NEES] |= of_mass[0]
    metrics[COVERAGE_CONSTANTS] = of_mass[1]
    if summary.intervals is not None:
        metrics[IN_INTERVAL] = _truth_in_intervals(summary, summary.intervals, truth, com_true_G)
    metrics |= _prediction_errors(estimate, true_states, truth, summary)
    correlation = None if summary.mesh is None else correlation_of(summary.mesh)
    metrics["mesh"] = _mesh_metrics(run_folder, sequence_folder, truth, X_NG, X_NG_true, correlation)
    return metrics


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
    summary, table = read_summary(run_folder), read_trajectory(run_folder)
    if summary.com_G is None or summary.R_GP is None:
        raise InputError(f"{run_folder}: the run has no estimate; nothing to evaluate")
    truth = read_truth(sequence_folder)
    require_recording(summary.data, sequence_folder)
    if truth.mesh is None:
        raise InputError(f"{sequence_folder}: the truth has no mesh")
    stamps = table.timestamps_ns
    ahead_ns = stamps[-1] + np.round(time_s * 1e9).astype(np.int64)
    X_NG = target_poses(truth_at(truth, ahead_ns), truth.R_GP, truth.com_G)
    X_frames = target_poses(truth_at(truth, stamps), truth.R_GP, truth.com_G)
    estimate = States(stamps, table.r_N, table.v_N, table.R_NP, table.w_P)
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
    states = truth_at(truth, timestamps_ns)
    return replace(
        truth,
        timestamps_ns=timestamps_ns,
        r_N=states.r_N,
        R_NP=states.R_NP,
        v_N=states.v_N,
        w_P=states.w_P,
        mesh=None,
    )


def _motion_metrics(estimate: States, truth: States, covariance: Covariance) -> Metrics:
    errors = asdict(motion_errors(estimate, truth))
    half_turn = errors.pop("half_turn")
    attitude = {"median": errors.pop("attitude_median_deg"), "max": errors.pop("attitude_max_deg")}
    with_axes = {name: errors.pop(f"attitude_with_axes_{name}_deg") for name in ("median", "max")}
    return {
        **errors,
        "attitude_error_deg": attitude,
        "attitude_error_with_axes_deg": with_axes,
        "half_turn": HALF_TURN_NAMES[half_turn],
        NEES: state_nees(estimate, truth, covariance.covariance, half_turn),
        COVERAGE: state_coverage(estimate, truth, covariance.covariance, half_turn),
    }


def _mass_metrics(
    summary: Summary, moments: Array, R_GP_true: Array, com_true_G: Array, form: InertiaForm
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """NEES, and coverage, of the five inertia parameters, the centre of mass and the principal axes; of the
    truth moments (3,), R_GP (3, 3) and com_G (3,), in the run's G."""
    assert summary.inertia is not None and summary.R_GP is not None
    J_true = R_GP_true @ np.diag(moments) @ R_GP_true.T
    between = np.array(summary.R_GP).T @ R_GP_true
    half_turn = HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))]
    found = {
        "inertia": (
            inertia_parameter_error(np.array(summary.inertia.J_G), J_true, form),
            np.array(summary.inertia.cov_J, dtype=np.float64),
        ),
        "com": (np.array(summary.com_G) - com_true_G, np.array(summary.cov_com_G, dtype=np.float64)),
        "axes": (-log_so3(between * half_turn), np.array(summary.cov_R_GP, dtype=np.float64)),
    }
    return (
        {name: nees(error[None], covariance[None]) for name, (error, covariance) in found.items()},
        {name: coverage(error, covariance) for name, (error, covariance) in found.items()},
    )


def _truth_in_intervals(
    summary: Summary, intervals: Intervals, truth: Truth, com_true_G: Array
) -> dict[str, bool]:
    """For each interval of the run whether the truth lies inside; com_true_G (3,) in the run's G [m]."""
    ends = {"k1": (intervals.k1, truth.k1), "k2": (intervals.k2, truth.k2)}
    shift = np.array(summary.R_GP).T @ (com_true_G - np.array(summary.com_G))
    for axis, interval, moved in zip("xyz", intervals.com_shift_P or (), shift, strict=False):
        ends[f"com_{axis}"] = (interval, float(moved))
    found = {name: at[0] <= value <= at[1] for name, (at, value) in ends.items() if at is not None}
    if intervals.com_G is not None:
        low, high = np.array(intervals.com_G)
        found["com_G"] = bool(np.all(low <= com_true_G) and np.all(com_true_G <= high))
    return found


def inertia_parameter_error(J: Array, J_true: Array, form: InertiaForm) -> Array:
    """Estimate minus truth (5,) in the solver's parameters around the estimate; J (3, 3) in G, any scale."""
    xi, R_ref = form.coordinates(_second_moments(J))
    target = unit_determinant(_second_moments(J_true))
    x, upper = xi.copy(), np.triu_indices(3)
    for _ in range(30):
        residual = (form.second_moments(x, R_ref) - target)[upper]
        jacobian = form.derivative(x, R_ref)[:, *upper].T
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        x = x + step * min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        if np.abs(step).max() < 1e-12:
            break
    return np.asarray(xi - x)


def _second_moments(J: Array) -> Array:
    return np.asarray(0.5 * np.trace(J) * np.eye(3) - J)


def _prediction_errors(estimate: States, true_states: States, truth: Truth, summary: Summary) -> Metrics:
    """Errors of position and attitude past the last image.

    The attitude is compared as in ``attitude_error_deg``: after the constant body rotation of the run itself.
    """
    assert summary.inertia is not None
    half_turn = motion_errors(estimate, true_states).half_turn
    R_fit = constant_body_rotation(with_half_turn(estimate, half_turn), true_states)
    end_ns = int(estimate.timestamps_ns[-1])
    reach_s = (int(truth.timestamps_ns[-1]) - end_ns) * 1e-9
    horizons = [h for h in HORIZONS_S if h <= reach_s + 1e-6]
    degrees: dict[str, float | None] = dict.fromkeys(map(str, HORIZONS_S))
    metres = dict(degrees)
    if horizons:
        at = truth_at(truth, end_ns + np.array(horizons, dtype=np.int64) * 1_000_000_000)
        last = estimate.r_N[-1], estimate.v_N[-1], estimate.R_NP[-1], estimate.w_P[-1]
        r_N, v_N, R_NP, w_P = propagate([0.0, *horizons], *last, np.diag(summary.inertia.moments))
        predicted = with_half_turn(States(at.timestamps_ns, r_N[1:], v_N[1:], R_NP[1:], w_P[1:]), half_turn)
        angles = angle_deg(np.swapaxes(predicted.R_NP @ R_fit, -1, -2) @ at.R_NP)
        distances = np.linalg.norm(predicted.r_N - at.r_N, axis=1)
        for h, angle, distance in zip(horizons, angles, distances, strict=True):
            degrees[str(h)], metres[str(h)] = float(angle), float(distance)
    return {"prediction_error_deg": degrees, "prediction_error_m": metres}


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
    mesh = surface.mesh
    if len(mesh.faces) == 0:
        return None
    in_true_G = mesh.copy()
    in_true_G.apply_transform(between_target_frames(X_NG, X_NG_true, mesh.centroid))
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


def format_table(metrics: Metrics) -> str:
    """Everything in metrics.json, one line each, as text, beside what is expected if the sigmas are right."""
    table = Table(
        Column(style="bold"),
        Column("found", justify="right"),
        "unit",
        "expected",
        title="Estimate minus truth",
    )
    for key, value in metrics.items():
        if isinstance(value, dict):
            for name, part in value.items():
                label = f"{key} {name}" + (f"\n  {ALIGNED[key]}" if key in ALIGNED else "")
                table.add_row(label, _format_value(part), _unit(key, name), _expected_text(key, name))
        else:
            table.add_row(key, _format_value(value), _unit(key), "")
    console = Console(width=100, file=StringIO(), force_terminal=False)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


UNITS = {"_deg_s": "deg/s", "_m_s": "m/s", "_deg": "deg", "_mm": "mm", "_m": "m", "_px": "px", "_s": "s"}
"""By the end of a name, the longer ones first"""


def _unit(key: str, name: str = "") -> str:
    """Of a number of metrics.json, as its own name or that of its group ends; empty: it has none."""
    found = (unit for text in (name, key) for end, unit in UNITS.items() if text.endswith(end))
    return next(found, "")


def _expected_text(group: str, name: str) -> str:
    if group == IN_INTERVAL:
        return "True"
    found = expected_range(group, name)
    return "" if found is None else f"{found[0]:.2g} to {found[1]:.3g}"


def _format_value(value: object) -> str:
    if value is None:
        return "not available"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
