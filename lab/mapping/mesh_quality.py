"""Quality and cost of the dense surface: depth and fusion alone, on sequences with truth.

    python -m lab.mapping.mesh_quality SEQ [SEQ ...]                with the true poses
    python -m lab.mapping.mesh_quality SEQ [SEQ ...] --runs RUN ... with the poses of runs and their
                                                                           covariances, one for each sequence

Prints a line a sequence: distances to the true surface (as ``polhode evaluate``; "seen thrice": over the
part that was seen and lit in three frames at least), share of the vertices within one and two of their
sigmas, size of the mesh, and seconds of one core a frame for depth and for fusion.
"""

from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import trimesh
from tyro.conf import arg

from lab.command import DEFAULT, Configuration, Sequences, command
from lab.presentation import numbers, print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.frontend.extract import extract_depth
from polhode.frontend.rectification import Rectifier, make_rectifier
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.mapping.fusion.field import fuse
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.mesh_metrics import compare_surfaces, distance_to_surface
from polhode.records.metrics import States, truth_at
from polhode.records.read_truth import read_truth
from polhode.records.surface import DepthMap
from polhode.records.truth import Truth
from polhode.report.evaluation import between_target_frames, seen_truth
from polhode.run_directory.archives import read_covariance
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.summary import read_summary
from polhode.run_directory.trajectory_file import read_trajectory, target_poses

MAX_VERTICES = 15_000
"""Vertices whose distances are compared with their sigmas."""
HEAD = (
    "sequence | frames | accuracy | completion | chamfer | 95th percentile | within 3 mm "
    "| seen thrice: completion | 95th percentile | within 3 mm | chamfer | within 1 sigma | 2 sigma "
    "| vertices | depth s | fusion s"
)


def true_poses(sequence: StereoSequence, truth: Truth) -> Array:
    """X_NG (F, 4, 4) at the pairs of the sequence."""
    return target_poses(truth_at(truth, sequence.timestamps_ns), truth.R_GP, truth.com_G)


def run_poses(run: Path) -> Array:
    """X_NG (F, 4, 4) as a run estimated them."""
    summary, table = read_summary(run), read_trajectory(run)
    states = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    return target_poses(states, np.array(summary.R_GP), np.array(summary.com_G))


def depth_maps(
    sequence: StereoSequence, rectifier: Rectifier, X_RG: Array, points_G: Array, config: Config
) -> Iterator[DepthMap]:
    """Depth of every pair, by one process; points_G (n, 3) at poses X_RG (F, 4, 4) bound the disparity."""
    spans: list[tuple[float, float] | None] = []
    for X in X_RG:
        disparity = rectifier.rig.project(transform_points(X, points_G))[:, 2]
        spans.append((float(disparity.min()), float(disparity.max())))
    return extract_depth(sequence, rectifier, config.frontend, spans, 1)


def measure(folder: Path, run: Path | None, config: Config, frames: int | None) -> list[object]:
    """Rebuild one sequence's surface and compare it with the truth: a row of the table."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    rectifier, X_true = make_rectifier(sequence.calibration), true_poses(sequence, truth)
    X_NG = (X_true if run is None else run_poses(run))[:frames]
    X_RG = inverse_pose(sequence.X_NC[:frames] @ rectifier.X_CR) @ X_NG
    to_true_G = between_target_frames(X_NG, X_true[:frames], np.zeros(3))
    corners_G = transform_points(inverse_pose(to_true_G), np.asarray(truth.mesh.vertices))
    maps, depth_s = depth_maps(sequence, rectifier, X_RG, corners_G, config), 0.0

    def posed() -> Iterator[tuple[DepthMap, Array]]:
        nonlocal depth_s
        for X in X_RG:
            begin = process_time()
            frame = next(maps)
            depth_s += process_time() - begin
            yield frame, X

    begin = process_time()
    surface = fuse(
        posed(),
        rectifier.rig,
        config.mapping,
        covariance_G=None if run is None else read_covariance(run).covariance_X_NG,
        landmarks_G=None if run is None else read_landmarks(run).p_G,
    )
    fusion_s = process_time() - begin - depth_s
    mesh = surface.mesh.copy()
    mesh.apply_transform(between_target_frames(X_NG, X_true[:frames], mesh.centroid))
    m, thrice = (
        compare_surfaces(mesh, truth.mesh, seen_truth(truth.mesh, X_true, sequence, least))
        for least in (1, 3)
    )
    distances = (m.accuracy_mm, m.completion_mm, m.chamfer_mm, m.hausdorff95_mm, m.completeness_3mm)
    of_thrice = (thrice.completion_mm, thrice.hausdorff95_mm, thrice.completeness_3mm, thrice.chamfer_mm)
    return [
        folder.name,
        len(X_NG),
        *numbers((*distances, *of_thrice), ".3f"),
        *numbers(within_sigma(mesh, surface.sigma_m, truth.mesh), ".2f"),
        len(mesh.vertices),
        *numbers((depth_s / len(X_NG), fusion_s / len(X_NG)), ".3f"),
    ]


def within_sigma(
    mesh: trimesh.Trimesh, sigma_m: Array, truth: trimesh.Trimesh, sigmas: tuple[float, float] = (1.0, 2.0)
) -> tuple[float, float]:
    """Share of the vertices that are off by less than one and two (or so many) of their sigmas."""
    known = np.flatnonzero(np.isfinite(sigma_m))
    some = np.random.default_rng(0).choice(known, min(MAX_VERTICES, len(known)), replace=False)
    off = distance_to_surface(truth, np.asarray(mesh.vertices)[some]) / sigma_m[some]
    return float(np.mean(off < sigmas[0])), float(np.mean(off < sigmas[1]))


def main(
    sequences: Sequences,
    runs: Annotated[tuple[Path, ...], arg(help="Runs whose poses are used, one for each sequence.")] = (),
    config: Configuration = DEFAULT,
    frames: Annotated[int | None, arg(help="Only the first so many.")] = None,
) -> None:
    """Measure and print the table."""
    if runs and len(runs) != len(sequences):
        raise SystemExit("--runs needs one run for each sequence")
    jobs, settings = zip(sequences, runs or [None] * len(sequences), strict=True), load_config(config)
    print_table(HEAD, (measure(sequence, run, settings, frames) for sequence, run in jobs))


if __name__ == "__main__":
    command(main)
