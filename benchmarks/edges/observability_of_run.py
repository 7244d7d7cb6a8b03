"""The metric from a run's mesh beside that from the true mesh: may the inspection feed the approach?

    python -m benchmarks.edges.observability_of_run RUN:SEQ [RUN:SEQ ...] [--every 5]

At the run's pairs, the edges of its own mesh at its own estimate and those of the true mesh at the true pose,
both about the centre of mass and along the camera's axes. Prints the ratio of the sigmas (run over true) for
each degree of freedom: median, and the range that holds 90 %; and the correlation of the logarithms, which
tells whether the run's mesh ranks the places rightly.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import command
from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, make_pose
from polhode.metrics import truth_at
from polhode.pipeline.after_run.observability.assess import CameraOptions, subject_of
from polhode.pipeline.run_directory.archives import read_measurements
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.information import views_along
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.truth import read_truth


def main(
    pairs: Positional[Annotated[tuple[str, ...], arg(metavar="RUN:SEQ")]],
    every: Annotated[int, arg(help="So many pairs of images apart.")] = 5,
) -> None:
    """Print the table."""
    print("| run | edges, run and true |", " | ".join(DEGREES_OF_FREEDOM), "|")
    print("|---|---|" + "---|" * 6)
    for pair in pairs:
        run, _, sequence = pair.partition(":")
        print(row(Path(run), Path(sequence), every), flush=True)


def row(run: Path, sequence: Path, every: int) -> str:
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
        told = np.isfinite(own[:, k]) & np.isfinite(true[:, k])
        ratio = own[told, k] / true[told, k]
        low, median, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        r = np.corrcoef(np.log(own[told, k]), np.log(true[told, k]))[0, 1]
        cells.append(f"{median:.2f} ({low:.2f} to {high:.2f}), r {r:.2f}")
    return f"| {run.name} | {subject.model.size}, {model.size} | {' | '.join(cells)} |"


def sigmas(model: EdgeModel, rig: RectifiedRig, X_RG: Array, o_G: Array) -> Array:
    """(k, 6)"""
    return np.stack([view.metric.sigma for view in views_along(model, rig, X_RG, o_G)])


if __name__ == "__main__":
    command(main)
