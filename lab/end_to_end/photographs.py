"""Photographs of a real object with known motion: displacements, rate, axis, and mesh outside of its box.

    python -m lab.end_to_end.photographs SEQ --run RUN [--box None]

SEQ holds ``mav0/`` and ``truth.csv``: timestamp [ns], rotation row by row and translation [m] that take the
object's frame O to the left camera; for a simulated sequence its own truth is taken. The truth is the
calibration of the views. RUN is made by configs/default.yaml unless it exists. The run's landmarks of the
first frame are carried to the other frames by the estimate and by the truth; the rate is that of the whole
sequence, the axis that of its rotation. The mesh is laid into O by all frames.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import DEFAULT, command, polhode
from lab.mapping.mesh_quality import true_poses
from polhode.files.tables import read_table
from polhode.geometry.lie import Array, Ints, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.geometry.rigid_fit import fit_rigid
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.read_truth import read_truth
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from polhode.runtime.errors import InputError

TEMPLE_BOX_M = (-0.023121, -0.038009, -0.091940, 0.078626, 0.121636, -0.017395)
"""The object of the templeRing set lies between these corners of its frame."""
FAR_M = 2e-3
"""The box of the temple ends up to 2 mm above the cloth on which it stands."""


@dataclass(frozen=True)
class Agreement:
    """A run against the calibrated views."""

    pairs: tuple[int, int]
    """Compared, and in the truth"""
    displacement_mm: Array
    """(F - 1,) median over the landmarks, of each frame but the first"""
    rate_error: float
    """Relative"""
    axis_error_deg: float
    vertices_O: Array
    """(V, 3) of the mesh [m]"""

    def lines(self, box_O: Array | None) -> list[str]:
        """What the benchmark prints; box (2, 3) [m]."""
        out = [
            f"pairs: {self.pairs[0]} of {self.pairs[1]}",
            f"displacement of landmarks: {np.median(self.displacement_mm):.3f} mm (median of the frames), "
            f"{self.displacement_mm.max():.3f} mm (largest)",
            f"rate: {100 * self.rate_error:+.3f} %",
            f"axis: {self.axis_error_deg:.3f} deg",
        ]
        if box_O is not None:
            off_m = np.linalg.norm(self.vertices_O - np.clip(self.vertices_O, *box_O), axis=1)
            out.append(
                f"mesh outside the box: {100 * np.mean(off_m > 0.0):.2f} % of {len(off_m)} vertices, "
                f"{100 * np.mean(off_m > FAR_M):.2f} % by more than {1e3 * FAR_M:g} mm"
            )
        return out


def main(
    sequence: Positional[Path],
    run: Annotated[Path, arg(metavar="RUN", help="The run; made unless it exists.")] = Path("runs/temple"),
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        arg(help="Lower and upper corner of the object's box in its frame [m]; None: not known."),
    ] = TEMPLE_BOX_M,
) -> None:
    """Run, compare, print."""
    if not run.is_dir():
        polhode("run", DEFAULT, "--data", sequence, "-o", run)
    content, images = read_stored_run(run, run.name), open_sequence(sequence)
    if content.motion is None or content.landmarks is None or content.surface is None:
        raise InputError(f"{run}: the run found no motion or no surface")
    found = agreement(content, images, *true_views(sequence, images))
    print("\n".join(found.lines(None if box is None else np.reshape(box, (2, 3)))))


def true_views(folder: Path, images: StereoSequence) -> tuple[Ints, Array]:
    """Timestamps (F,) [ns] and X_CO (F, 4, 4) of the calibrated views."""
    path = folder / "truth.csv"
    if not path.is_file():
        return images.timestamps_ns, inverse_pose(images.X_NC) @ true_poses(images, read_truth(folder))
    table = read_table(path, columns=12, docs="docs/validation.md#photographs")
    rows = table.values
    return table.timestamps_ns, make_pose(rows[:, :9].reshape(-1, 3, 3), rows[:, 9:])


def agreement(content: StoredRun, images: StereoSequence, stamps: Ints, X_CO: Array) -> Agreement:
    """Compare a run with the views."""
    motion, landmarks, surface = content.motion, content.landmarks, content.surface
    assert motion is not None and landmarks is not None and surface is not None
    common, estimated, true = np.intersect1d(motion.trajectory.timestamps_ns, stamps, return_indices=True)
    cameras = np.searchsorted(images.timestamps_ns, common)
    X_CG, X_CO = inverse_pose(images.X_NC[cameras]) @ motion.X_NG[estimated], X_CO[true]
    p_G = landmarks.p_G
    first = transform_points(X_CG[0], p_G)
    moved = X_CO @ inverse_pose(X_CO[0])
    off = [
        np.median(np.linalg.norm(transform_points(X, p_G) - transform_points(D, first), axis=1))
        for X, D in zip(X_CG[1:], moved[1:], strict=True)
    ]
    w, w_true = (mean_rate(1e-9 * (common - common[0]), X[:, :3, :3]) for X in (X_CG, X_CO))
    cosine = float(w @ w_true / np.linalg.norm(w) / np.linalg.norm(w_true))
    # the frame O that fits all frames best
    seen_O = np.concatenate([transform_points(X, p_G) for X in inverse_pose(X_CO) @ X_CG])
    X_OG = fit_rigid(seen_O, np.tile(p_G, (len(X_CO), 1)))
    return Agreement(
        (len(common), len(stamps)),
        1e3 * np.array(off),
        float(np.linalg.norm(w) / np.linalg.norm(w_true) - 1.0),
        float(np.rad2deg(np.arccos(min(cosine, 1.0)))),
        transform_points(X_OG, np.asarray(surface.mesh.vertices)),
    )


def mean_rate(time_s: Array, R: Array) -> Array:
    """Constant angular velocity (3,) [rad/s] that fits rotations R (F, 3, 3) of a spin, by least squares.

    Successive frames turn by less than half a revolution per smallest interval, over gaps by as many
    revolutions as their rate says.
    """
    between = log_so3(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    step_s = np.diff(time_s)
    near = step_s < 1.5 * step_s.min()
    w = np.mean(between[near] / step_s[near, None], axis=0)
    for _ in range(5):
        # What the rate leaves over, from the first frame on, is small and grows in proportion to time.
        undone = exp_so3(-w * time_s[:, None]) @ R
        left = log_so3(undone @ undone[0].T)
        centred = time_s - time_s.mean()
        w = w + centred @ left / (centred @ centred)
    return np.asarray(w)


if __name__ == "__main__":
    command(main)
