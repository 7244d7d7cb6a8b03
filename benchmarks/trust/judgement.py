"""One run against its truth: what it claims, what it says of itself, what its checks cost."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness.judge import judged
from benchmarks.trust.consistency import consistency_of
from polhode.errors import InputError
from polhode.lie import inverse_pose
from polhode.metrics import States, motion_errors
from polhode.pipeline.evaluation import evaluate, truth_of_frames
from polhode.pipeline.run_directory.archives import read_covariance
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.pipeline.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.records import Ints, Truth

FOUND_DEG_S = 0.1
"""A rate is found within this, as vectors in N, root mean square over the frames."""
OUTCOMES = ("found, ok", "found, but doubted", "not found, and said so", "not found, and ok")


@dataclass(frozen=True)
class SequenceTruth:
    """Of a simulated sequence, at the frames of a run."""

    stamps_ns: Ints
    truth: Truth
    later: Truth | None = None


def judgement(run: Path, sequence: Path, mesh: bool) -> dict[str, Any]:
    """A row of the record; ``mesh``: with the errors of the surface, which take a minute."""
    summary = read_summary(run)
    row: dict[str, Any] = {
        "frames": summary.frames,
        "seconds": round(summary.timing_s.total, 1),
        "checks_seconds": getattr(summary.timing_s, "checks", None),
        "checks": {check.name: (check.value, check.limit, bool(check.reason)) for check in summary.checks},
    }
    if not (run / "trajectory.csv").is_file() or summary.com_G is None:
        return {**row, "status": summary.status, "warnings": summary.warnings, "claims": {}, "wrong": []}
    stamps_ns = read_trajectory(run).timestamps_ns
    truth = truth_of_frames(sequence, stamps_ns)
    if truth is None:
        raise InputError(f"{sequence}: no truth; simulate it")
    known = SequenceTruth(stamps_ns, truth)
    row |= judged(run, known) | rates(run, truth)
    row["consistency"] = consistency_of(run, summary, known)
    row["intervals"] = intervals_of(run, summary, truth)
    if mesh:
        row["mesh"] = evaluate(run, sequence)["mesh"]
    return row


def rates(run: Path, truth: Truth) -> dict[str, float | None]:
    """Error of the rotation, its largest sigma and its true size [deg/s]."""
    table = read_trajectory(run)
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    own = States(truth.timestamps_ns, truth.r_N, truth.v_N, truth.R_NP, truth.w_P)
    variance = np.diagonal(read_covariance(run).covariance, axis1=1, axis2=2)[:, 9:]
    sigma = float(np.rad2deg(np.sqrt(np.median(variance.max(axis=1)))))
    return {
        "rate_error_deg_s": float(f"{motion_errors(estimate, own).rmse_angular_velocity_deg_s:.4g}"),
        "rate_sigma_deg_s": float(f"{sigma:.4g}") if np.isfinite(sigma) else None,
        "rate_deg_s": float(f"{np.rad2deg(np.linalg.norm(own.w_P, axis=1).mean()):.4g}"),
    }


def intervals_of(run: Path, summary: Summary, truth: Truth) -> dict[str, Any]:
    """By name: the interval of a scalar that the run states, its true value, and whether this lies inside."""
    content = json.loads((run / "summary.json").read_text(encoding="utf-8")).get("intervals") or {}
    true_values = _true_values(run, summary, truth)
    out = {}
    for name, entry in content.items():
        low, high = _ends(entry)
        if low is None or high is None or name not in true_values:
            continue
        lows, highs, values = (np.atleast_1d(np.asarray(v, float)) for v in (low, high, true_values[name]))
        if lows.shape != values.shape:
            continue
        inside = bool(np.all((lows <= values) & (values <= highs)))
        out[name] = {"low": lows.tolist(), "high": highs.tolist(), "true": values.tolist(), "inside": inside}
    return out


def _ends(entry: Any) -> tuple[Any, Any]:
    """Of an interval that is a mapping or begins with its two ends."""
    if isinstance(entry, Mapping):
        return entry.get("low"), entry.get("high")
    return (entry[0], entry[1]) if isinstance(entry, list) and len(entry) >= 2 else (None, None)


def _true_values(run: Path, summary: Summary, truth: Truth) -> dict[str, Any]:
    """k1, k2 and the centre of mass in the estimate's G, which the first frame holds."""
    table = read_trajectory(run)
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    X_NG = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))[0]
    com_G = (inverse_pose(X_NG) @ np.append(truth.r_N[0], 1.0))[:3]
    return {"k1": truth.k1, "k2": truth.k2, "com_G": com_G}


def spin_outcome(row: Mapping[str, Any]) -> str:
    """One of OUTCOMES: whether the rate was found, and whether the run says that all is well."""
    error = row.get("rate_error_deg_s")
    found = row["status"] != "failed" and error is not None and error <= FOUND_DEG_S
    confident = row["status"] == "ok"
    return OUTCOMES[(0 if confident else 1) if found else (3 if confident else 2)]
