"""The metric from a run's mesh against that from the true mesh.

    python -m lab.edges.observability_of_run RUN:SEQ [RUN:SEQ ...] [--every 5]

At the run's pairs, the edges of its own mesh at its own estimate and those of the true mesh at the true pose,
both about the centre of mass and along the camera's axes. Prints the ratio of the sigmas (run over true) for
each degree of freedom: median, and the range that holds 90 %; and the correlation of the logarithms, which
shows whether the run's mesh ranks the views correctly.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import command
from lab.presentation import print_table
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.information import views_along
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.planning.observability.assess import CameraOptions, subject_of
from polhode.records.metrics import truth_at
from polhode.records.read_truth import read_truth
from polhode.run_directory.archives import read_measurements


def main(
    pairs: Positional[Annotated[tuple[str, ...], arg(metavar="RUN:SEQ")]],
    every: Annotated[int, arg(help="So many pairs of images apart.")] = 5,
) -> None:
    """Print the table."""
    folders = (map(Path, pair.split(":")) for pair in pairs)
    print_table(("run", "edges, run and true", *DEGREES_OF_FREEDOM), (row(*each, every) for each in folders))


def row(run: Path, sequence: Path, every: int) -> list[str]:
    """One run."""
    subject = subject_of(run, None, "G", CameraOptions(), None, None, 30.0, 1.0)
    truth = read_truth(sequence)
    assert truth.mesh is not None
    tracks = read_measurements(run / "measurements.npz")
    own = sigmas(subject.model, subject.rig, subject.X_RG[::every], subject.o_G)
    states = truth_at(truth, tracks.timestamps_ns[::every])
    R_NG = states.R_NP @ truth.R_GP.T
    X_NG = make_pose(R_NG, states.r_N - R_NG @ truth.com_G)
    model = edge_model(truth.mesh)
    true = sigmas(model, subject.rig, inverse_pose(tracks.X_NR[::every]) @ X_NG, truth.com_G)
    cells = []
    for k in range(6):
        known = np.isfinite(own[:, k]) & np.isfinite(true[:, k])
        ratio = own[known, k] / true[known, k]
        low, median, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        r = np.corrcoef(np.log(own[known, k]), np.log(true[known, k]))[0, 1]
        cells.append(f"{median:.2f} ({low:.2f} to {high:.2f}), r {r:.2f}")
    return [run.name, f"{subject.model.size}, {model.size}", *cells]


def sigmas(model: EdgeModel, rig: RectifiedRig, X_RG: Array, o_G: Array) -> Array:
    """(k, 6)"""
    return np.stack([view.metric.sigma for view in views_along(model, rig, X_RG, o_G)])


if __name__ == "__main__":
    command(main)
