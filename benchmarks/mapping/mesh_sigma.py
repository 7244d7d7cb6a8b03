"""Whether the sigmas of meshes hold: shares of vertices and of means over patches within them.

    python -m benchmarks.mapping.mesh_sigma RUN:SEQ [RUN:SEQ ...]            the meshes as the runs wrote them
    python -m benchmarks.mapping.mesh_sigma RUN:SEQ [RUN:SEQ ...] --again    depth and fusion repeated

Prints a line a run: vertices, median sigma, the noise over what the depth maps state and the number of
landmarks that showed it, shares of the vertices within one and three sigmas of the true surface (Gaussian
errors: 0.683 and 0.997; asked for are 0.63 to 0.73 and 0.98), the same of the mean errors over patches, and
the mean distance from the true surface. The motion alone aligns mesh and truth, as in ``polhode evaluate``.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, Configuration, command
from benchmarks.mapping.mesh_quality import rebuild, run_poses, true_poses
from benchmarks.presentation import numbers, print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.frontend.rectification import make_rectifier
from polhode.mapping.mesh_files import read_ply
from polhode.mesh_metrics import distance_to_surface
from polhode.pipeline.evaluation import between_target_frames
from polhode.pipeline.run_directory.archives import read_covariance
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.summary_schema import correlation_of
from polhode.records import SurfaceErrors, SurfaceModel
from polhode.surface_errors import MAX_VERTICES, sigma_shares
from polhode.truth import read_truth

HEAD = (
    "run | vertices | sigma mm | noise scale | landmarks | 1 sigma | 3 sigma | patches: 1 sigma | 3 sigma "
    "| mean distance mm"
)


def written_surface(run: Path) -> SurfaceModel:
    """The mesh of a run with what its summary says of the errors."""
    surface, mesh = read_ply(run / "mesh.ply"), read_summary(run).mesh
    correlation = None if mesh is None else correlation_of(mesh)
    errors = None
    if mesh is not None and mesh.errors is not None and correlation is not None:
        errors = SurfaceErrors(mesh.errors.noise_scale, mesh.errors.landmarks, correlation)
    return SurfaceModel(surface.mesh, surface.sigma_m, surface.views, errors=errors)


def fused_again(run: Path, sequence_folder: Path, config: Config) -> SurfaceModel:
    """The surface of the run's poses and landmarks by the present code."""
    sequence, landmarks_G = open_sequence(sequence_folder), read_landmarks(run).p_G
    return rebuild(
        sequence,
        make_rectifier(sequence.calibration),
        run_poses(run),
        landmarks_G,
        config,
        covariance_G=read_covariance(run).covariance_X_NG,
        landmarks_G=landmarks_G,
    )[0]


def row(run: Path, sequence_folder: Path, again: bool, config: Config) -> list[object]:
    """Of the table."""
    surface = fused_again(run, sequence_folder, config) if again else written_surface(run)
    sequence, truth = open_sequence(sequence_folder), read_truth(sequence_folder)
    if truth.mesh is None:
        raise SystemExit(f"{sequence_folder}: this sequence has no true surface")
    mesh = surface.mesh.copy()
    mesh.apply_transform(between_target_frames(run_poses(run), true_poses(sequence, truth), mesh.centroid))
    errors = surface.errors
    shares = sigma_shares(mesh, surface.sigma_m, truth.mesh, None if errors is None else errors.correlation)
    known = np.flatnonzero(np.isfinite(surface.sigma_m))
    some = np.random.default_rng(0).choice(known, min(MAX_VERTICES, len(known)), replace=False)
    distance_mm = 1e3 * distance_to_surface(truth.mesh, np.asarray(mesh.vertices)[some]).mean()
    return [
        sequence_folder.name,
        len(mesh.vertices),
        f"{1e3 * np.median(surface.sigma_m[known]):.2f}",
        "" if errors is None else f"{errors.scale:.2f}",
        "" if errors is None else errors.landmarks,
        *numbers([np.nan if share is None else share for share in shares.values()], ".3f"),
        f"{distance_mm:.3f}",
    ]


def main(
    pairs: Annotated[
        Positional[tuple[str, ...]], arg(metavar="RUN:SEQ", help="Runs and their sequences, with truth.")
    ],
    again: Annotated[bool, arg(help="Repeat depth and fusion from the run's poses.")] = False,
    config: Configuration = DEFAULT,
) -> None:
    """Print the table."""
    settings = load_config(config)
    folders = [tuple(Path(part) for part in pair.split(":")) for pair in pairs]
    if any(len(each) != 2 for each in folders):
        raise SystemExit("each argument is RUN:SEQ")
    print_table(HEAD, (row(run, sequence, again, settings) for run, sequence in folders))


if __name__ == "__main__":
    command(main)
