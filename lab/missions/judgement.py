"""One run against its truth: what it claims, what it says of itself, what its checks cost."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lab.mapping.mesh_quality import within_sigma
from lab.missions.consistency import consistency_of
from lab.missions.predictions import predictions_of
from lab.robustness.judge import judged
from polhode.geometry.lie import Ints, inverse_pose
from polhode.mapping.mesh_files import read_ply
from polhode.records.metrics import States
from polhode.records.read_truth import read_truth
from polhode.records.truth import Truth
from polhode.report.evaluation import between_target_frames, truth_of_frames
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class SequenceTruth:
    """Of a simulated sequence, at the frames of a run."""

    stamps_ns: Ints
    truth: Truth
    later: Truth | None = None


def judgement(run: Path, sequence: Path, size_m: float) -> dict[str, Any]:
    """A row of the record; size_m: of the target."""
    summary = read_summary(run)
    row: dict[str, Any] = {
        "frames": summary.frames,
        "seconds": round(summary.timing_s.total, 1),
        "checks_seconds": round(summary.timing_s.checks, 2),
        "checks": {check.name: (check.value, check.limit, bool(check.reason)) for check in summary.checks},
    }
    if not (run / "trajectory.csv").is_file() or summary.com_G is None:
        return {**row, "status": summary.status, "warnings": summary.warnings, "claims": {}, "wrong": []}
    stamps_ns = read_trajectory(run).timestamps_ns
    truth = truth_of_frames(sequence, stamps_ns)
    if truth is None:
        raise InputError(f"{sequence}: no truth; simulate it")
    known = SequenceTruth(stamps_ns, truth)
    row |= judged(run, known, size_m)
    row["predictions"] = predictions_of(run, read_truth(sequence), size_m)
    row["consistency"] = consistency_of(run, summary, known)
    row["intervals"] = intervals_of(run, summary, truth)
    row["mesh"] = mesh_shares(run, sequence, summary, truth)
    return row


def mesh_shares(run: Path, sequence: Path, summary: Summary, truth: Truth) -> dict[str, float] | None:
    """Share of the vertices within one and three of their sigmas; the motion alone aligns the surfaces.

    None: there is no surface.
    """
    true_mesh = read_truth(sequence).mesh
    if true_mesh is None or not (run / "mesh.ply").is_file():
        return None
    own = read_ply(run / "mesh.ply")
    if not len(own.mesh.faces):
        return None
    table = read_trajectory(run)
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    known = States(truth.timestamps_ns, truth.r_N, truth.v_N, truth.R_NP, truth.w_P)
    X_NG = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))
    X_NG_true = target_poses(known, truth.R_GP, truth.com_G)
    mesh = own.mesh.copy()
    mesh.apply_transform(between_target_frames(X_NG, X_NG_true, mesh.centroid))
    one, three = within_sigma(mesh, own.sigma_m, true_mesh, (1.0, 3.0))
    return {"within_1_sigma": round(one, 4), "within_3_sigma": round(three, 4)}


def intervals_of(run: Path, summary: Summary, truth: Truth) -> dict[str, Any]:
    """By name of each interval that the run states: low, high, the true value, whether this lies inside."""
    stated = summary.intervals
    if stated is None:
        return {}
    table = read_trajectory(run)
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    R_GP, com_G = np.array(summary.R_GP), np.array(summary.com_G)
    # the estimate's G is held at the first frame
    X_GN = inverse_pose(target_poses(estimate, R_GP, com_G)[0])
    true_com_G = (X_GN @ np.append(truth.r_N[0], 1.0))[:3]
    pairs: dict[str, tuple[tuple[float, float] | None, float]] = {
        "k1": (stated.k1, truth.k1),
        "k2": (stated.k2, truth.k2),
    }
    if stated.com_G is not None:
        low, high = stated.com_G
        pairs |= {f"com_G_{a}": ((low[n], high[n]), true_com_G[n]) for n, a in enumerate("xyz")}
    if stated.com_shift_P is not None:
        shift_P = R_GP.T @ (true_com_G - com_G)
        pairs |= {f"com_P_{a}": (stated.com_shift_P[n], shift_P[n]) for n, a in enumerate("xyz")}
    return {
        name: {
            "low": pair[0],
            "high": pair[1],
            "true": float(true),
            "inside": bool(pair[0] <= true <= pair[1]),
        }
        for name, (pair, true) in pairs.items()
        if pair is not None
    }
