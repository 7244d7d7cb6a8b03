"""Quality and cost of the dense surface: depth and fusion alone, on sequences with truth.

    python -m benchmarks.mapping.mesh_quality SEQ [SEQ ...]             with the true poses
    python -m benchmarks.mapping.mesh_quality SEQ [SEQ ...] --runs RUN
                                                                with the poses of runs and their covariances,
                                                                one for each sequence
    python -m benchmarks.mapping.mesh_quality SEQ --doubtful 3 1  every third pose off by 3 mm and 1 degree
                        (sigma): with the covariance of the poses given to the fusion, and not, with
                        these frames aligned to the surface of the others (the default), and exact

Prints a line a sequence: distances to the true surface (as ``polhode evaluate``; "seen thrice":
completion, its larger 95th percentile, what is within 3 mm, and chamfer over the part that was seen and
lit in three frames at least), share of the vertices within one and two of their sigmas, size of the mesh,
and seconds of one core a frame for depth and for fusion. ``--save FOLDER`` keeps the meshes, in the true
frame G.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import trimesh
from tyro.conf import arg

from benchmarks.command import DEFAULT, Configuration, Sequences, command
from benchmarks.presentation import numbers, print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.extract import extract_depth
from polhode.frontend.rectification import Rectifier, make_rectifier
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.mapping.fusion.field import fuse
from polhode.mapping.mesh_files import write_ply
from polhode.mesh_metrics import MeshMetrics, compare_surfaces, distance_to_surface
from polhode.metrics import States, truth_at
from polhode.pipeline.evaluation import between_target_frames, seen_truth
from polhode.pipeline.run_directory.archives import read_covariance
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.records import DepthMap, SurfaceModel, Truth
from polhode.truth import read_truth

MAX_VERTICES = 15_000
"""Looked at for their sigmas."""


@dataclass(frozen=True)
class MeshOutcome:
    """One line of the table."""

    name: str
    frames: int
    metrics: MeshMetrics
    seen_thrice: MeshMetrics
    within_sigma: tuple[float, float]
    vertices: int
    depth_s: float
    fusion_s: float
    poses: str = ""
    """What alignment made of doubtful poses"""


@dataclass(frozen=True)
class Doubts:
    """Errors of every third pose, and whether the fusion is given their covariance."""

    shift_m: float
    turn_rad: float
    given: bool
    aligned: bool = False

    @property
    def label(self) -> str:
        """For the table."""
        if self.shift_m == self.turn_rad == 0.0:
            return "exact"
        return "aligned" if self.aligned else "used" if self.given else "not used"

    def errors(self, count: int) -> Array:
        """(F, 4, 4) to be applied in G before the pose."""
        rng, out = np.random.default_rng(0), np.tile(np.eye(4), (count, 1, 1))
        for k in range(0, count, 3):
            turn, shift = rng.normal(0.0, self.turn_rad, 3), rng.normal(0.0, self.shift_m, 3)
            out[k] = make_pose(exp_so3(turn), shift)
        return out

    def covariance(self, count: int) -> Array:
        """(F, 6, 6) of these."""
        out = np.zeros((count, 6, 6))
        out[::3] = np.diag([self.shift_m**2] * 3 + [self.turn_rad**2] * 3)
        return out


def true_poses(sequence: StereoSequence, truth: Truth) -> Array:
    """X_NG (F, 4, 4) at the pairs of the sequence."""
    return target_poses(truth_at(truth, sequence.timestamps_ns), truth.R_GP, truth.com_G)


def run_poses(run: Path) -> Array:
    """X_NG (F, 4, 4) as a run estimated them."""
    summary, table = read_summary(run), read_trajectory(run)
    states = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    return target_poses(states, np.array(summary.R_GP), np.array(summary.com_G))


def of_aligned(surface: SurfaceModel, X_RG: Array) -> str:
    """Errors of the aligned poses against the true ones (F, 4, 4), as a sentence."""
    found = surface.aligned
    if found is None or len(found.frames) == 0:
        return ""
    between = inverse_pose(found.X_RG) @ X_RG[found.frames]
    error = np.hstack([between[:, :3, 3], log_so3(between[:, :3, :3])])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_G), error)
    mm, deg = (
        np.median(np.linalg.norm(part, axis=1)) for part in (error[:, :3] * 1e3, np.rad2deg(error[:, 3:]))
    )
    return (
        f"{len(found.frames)} of {found.doubtful} doubtful poses aligned: median error {mm:.2f} mm, "
        f"{deg:.2f} deg; mean normalised squared error {squared.mean():.1f} (6 would be right)"
    )


def depth_maps(
    sequence: StereoSequence, rectifier: Rectifier, X_RG: Array, points_G: Array, config: Config
) -> Iterator[DepthMap]:
    """Depth of every pair, by one process; points_G (n, 3) at poses X_RG (F, 4, 4) bound the disparity."""
    spans: list[tuple[float, float] | None] = []
    for X in X_RG:
        disparity = rectifier.rig.project(transform_points(X, points_G))[:, 2]
        spans.append((float(disparity.min()), float(disparity.max())))
    return extract_depth(sequence, rectifier, config.frontend, spans, 1)


def rebuild(
    sequence: StereoSequence,
    rectifier: Rectifier,
    X_NG: Array,
    points_G: Array,
    config: Config,
    doubts: Doubts | None = None,
    covariance_G: Array | None = None,
    landmarks_G: Array | None = None,
) -> tuple[SurfaceModel, float, float, str]:
    """The surface from given poses, seconds for depth, seconds for fusion, a sentence on aligned poses.

    points_G bound the disparity; covariance_G (F, 6, 6) of the poses and landmarks_G (L, 3), as
    ``mapping.fusion.fuse`` takes them.
    """
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ X_NG
    fused_at = X_RG if doubts is None else X_RG @ doubts.errors(len(X_RG))
    covariance = doubts.covariance(len(X_RG)) if doubts is not None and doubts.given else covariance_G
    depth_s = 0.0

    def timed() -> Iterator[tuple[DepthMap, Array]]:
        nonlocal depth_s
        maps = depth_maps(sequence, rectifier, X_RG, points_G, config)
        for X in fused_at:
            begin = process_time()
            frame = next(maps)
            depth_s += process_time() - begin
            yield frame, X

    begin = process_time()
    mapping = (
        config.mapping if doubts is None else config.mapping.model_copy(update={"align": doubts.aligned})
    )
    surface = fuse(timed(), rectifier.rig, mapping, covariance_G=covariance, landmarks_G=landmarks_G)
    return surface, depth_s, process_time() - begin - depth_s, of_aligned(surface, X_RG)


def measure(
    folder: Path, run: Path | None, config: Config, save: Path | None, doubts: Doubts | None = None
) -> MeshOutcome:
    """Rebuild one sequence's surface and compare it with the truth."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    X_true = true_poses(sequence, truth)
    X_NG = X_true if run is None else run_poses(run)
    to_true_G = between_target_frames(X_NG, X_true, np.zeros(3))
    corners = transform_points(inverse_pose(to_true_G), np.asarray(truth.mesh.vertices))
    of_poses = None if run is None else read_covariance(run).covariance_X_NG
    landmarks_G = None if run is None else read_landmarks(run).p_G
    surface, depth_s, fusion_s, poses = rebuild(
        sequence, make_rectifier(sequence.calibration), X_NG, corners, config, doubts, of_poses, landmarks_G
    )
    mesh = surface.mesh.copy()
    mesh.apply_transform(between_target_frames(X_NG, X_true, mesh.centroid))
    if save is not None:
        save.mkdir(parents=True, exist_ok=True)
        write_ply(SurfaceModel(mesh, surface.sigma_m, surface.views), save / f"{folder.name}.ply")
    metrics, thrice = (
        compare_surfaces(mesh, truth.mesh, seen_truth(truth.mesh, X_true, sequence, least))
        for least in (1, 3)
    )
    within, frames = within_sigma(mesh, surface.sigma_m, truth.mesh), len(sequence)
    name = folder.name if doubts is None else f"{folder.name}, {doubts.label}"
    return MeshOutcome(
        name, frames, metrics, thrice, within, len(mesh.vertices), depth_s / frames, fusion_s / frames, poses
    )


def within_sigma(
    mesh: trimesh.Trimesh, sigma_m: Array, truth: trimesh.Trimesh, sigmas: tuple[float, float] = (1.0, 2.0)
) -> tuple[float, float]:
    """Share of the vertices that are off by less than one and two (or so many) of their sigmas."""
    known = np.flatnonzero(np.isfinite(sigma_m))
    some = np.random.default_rng(0).choice(known, min(MAX_VERTICES, len(known)), replace=False)
    off = distance_to_surface(truth, np.asarray(mesh.vertices)[some]) / sigma_m[some]
    return float(np.mean(off < sigmas[0])), float(np.mean(off < sigmas[1]))


def row(o: MeshOutcome) -> list[object]:
    """Of the table."""
    m, t = o.metrics, o.seen_thrice
    distances = (m.accuracy_mm, m.completion_mm, m.chamfer_mm, m.hausdorff95_mm, m.completeness_3mm)
    thrice = (t.completion_mm, t.hausdorff95_mm, t.completeness_3mm, t.chamfer_mm)
    shares, seconds = numbers(o.within_sigma, ".2f"), numbers((o.depth_s, o.fusion_s), ".3f")
    return [o.name, o.frames, *numbers((*distances, *thrice), ".3f"), *shares, o.vertices, *seconds, o.poses]


def main(
    sequences: Sequences,
    runs: Annotated[tuple[Path, ...], arg(help="Runs whose poses are used, one for each sequence.")] = (),
    doubtful: Annotated[
        tuple[float, float] | None, arg(metavar="MM DEG", help="Errors of every third pose.")
    ] = None,
    config: Configuration = DEFAULT,
    save: Annotated[Path | None, arg(help="Folder for the meshes.")] = None,
) -> None:
    """Measure and print the table."""
    if runs and len(runs) != len(sequences):
        raise SystemExit("--runs needs one run for each sequence")
    settings = load_config(config)
    jobs = list(zip(sequences, runs or [None] * len(sequences), strict=True))
    doubts: list[Doubts | None] = [None]
    if doubtful:
        mm, deg = doubtful
        wrong = mm * 1e-3, np.deg2rad(deg)
        doubts = [
            Doubts(*wrong, False),
            Doubts(*wrong, True),
            Doubts(*wrong, True, True),
            Doubts(0.0, 0.0, False),
        ]
    head = (
        "sequence | frames | accuracy | completion | chamfer | hausdorff95 | within 3 mm "
        "| seen thrice: completion | 95 % | 3 mm | chamfer | 1 sigma | 2 | vertices | depth s | fusion s "
        "| poses"
    )
    print_table(
        head, (row(measure(sequence, run, settings, save, each)) for sequence, run in jobs for each in doubts)
    )


if __name__ == "__main__":
    command(main)
