"""Inspections before an approach: rendered pairs of a tumbling body, and the run that they gave.

An inspection is the costly part of a flight; several flights share it, and a folder keeps it. The body
has its own materials, with paint and cells.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import polhode
from polhode.geometry.lie import Array, Ints
from polhode.records.metrics import truth_at
from polhode.records.read_truth import read_truth
from polhode.report.evaluation import between_target_frames
from polhode.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.runtime.errors import RunFailure

FAMILIES = ("free_flyer", "bus", "cubesat", "upper_stage", "truss", "dish")
SIZE_M, RANGE_M = 0.8, 2.2
PAIRS, INTERVAL_S = 48, 1.0
HORIZON_S = 60.0
"""Of the truth after the last pair"""
_ERROR = "error.txt"


@dataclass(frozen=True)
class Inspection:
    """Folders of an inspection."""

    sequence: Path
    run: Path
    error: str
    """Why there is no estimate; empty: there is one"""


def scene_of(family: str, number: int) -> dict[str, Any]:
    """A slow tumble about any axis, the Sun 20 to 60 degrees from the camera."""
    rng = np.random.default_rng([number, FAMILIES.index(family), 0x1A5B])
    axis = rng.normal(size=3)
    spin_rpm = rng.uniform(0.7, 2.0) * axis / np.linalg.norm(axis)
    angle, around = np.deg2rad(rng.uniform(20.0, 60.0)), rng.uniform(0.0, 2.0 * np.pi)
    sun_N = [np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), -np.cos(angle)]
    return {
        "seed": 100 * number + FAMILIES.index(family),
        "scene": {
            "frames": PAIRS,
            "interval_s": INTERVAL_S,
            "truth_horizon_s": HORIZON_S,
            "body": {"family": family, "size_m": SIZE_M, "contrast": 0.7},
            "motion": {
                "position_m": [0.0, 0.0, RANGE_M],
                "velocity_mm_s": rng.uniform(-1.0, 1.0, 3).tolist(),
                "attitude_deg": rng.uniform(-90.0, 90.0, 3).tolist(),
                "spin_rpm": spin_rpm.tolist(),
                "spin_axes": "principal",
            },
            "rig": {"width_px": 400, "height_px": 400, "focal_px": 500.0, "baseline_m": 0.3},
            "light": {"sun_direction_N": sun_N, "earth": 0.2},
        },
    }


OPTIONS: dict[str, Any] = {
    "backend": {"window": {"enabled": False}, "bounds": {"intervals": False}},
    "pictures": {"views": False, "animation": False},
}
"""Of the run: without what no flight uses"""


def inspection(folder: Path, family: str, number: int) -> Inspection:
    """The inspection of that number, made unless the folder has it."""
    here = folder / f"{family}_{number}"
    sequence, run, error = here / "sequence", here / "run", here / _ERROR
    if not error.is_file():
        here.mkdir(parents=True, exist_ok=True)
        if not (sequence / "mav0").is_dir():
            shutil.rmtree(sequence, ignore_errors=True)
            polhode.simulate(scene_of(family, number), sequence, progress=False)
        reason = ""
        try:
            polhode.run(sequence, run, OPTIONS, overwrite=True, progress=False)
        except RunFailure as failure:
            reason = str(failure)
        error.write_text(reason)
    return Inspection(sequence, run, error.read_text())


def poses_of_run(inspected: Inspection) -> tuple[Ints, Array]:
    """Timestamps (F,) [ns] of the run's pairs, and its poses X_NG (F, 4, 4)."""
    table, summary = read_trajectory(inspected.run), polhode.load(inspected.run).summary
    return table.timestamps_ns, target_poses(table, np.array(summary.R_GP), np.array(summary.com_G))


def true_frame(inspected: Inspection, centre_G: Array) -> Array:
    """X_BG (4, 4): the run's G in the body's own frame, by what all pairs have in common."""
    truth, (timestamps_ns, X_NG) = read_truth(inspected.sequence), poses_of_run(inspected)
    X_NB = target_poses(truth_at(truth, timestamps_ns), truth.R_GP, truth.com_G)
    return between_target_frames(X_NG, X_NB, centre_G)
