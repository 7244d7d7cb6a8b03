"""A sequence in memory with its truth: what a fault of the data changes, and what the judge compares with."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import (
    image_path,
    write_camera_csv,
    write_inspector,
    write_png,
    write_sensor,
)
from polhode.records.metrics import States, truth_at
from polhode.records.truth import Truth
from polhode.report.evaluation import truth_of_frames

Images = NDArray[np.uint8]


@dataclass(frozen=True)
class Recording:
    """F pairs of a parallel rig, whose left camera is the inspector's body."""

    left: Images
    """(F, H, W)"""
    right: Images
    stamps_ns: Ints
    """(F,) as written"""
    truth: Truth
    """At the F instants at which the left images were taken; constants of the first of them"""
    later: Truth | None = None
    """Constants after a change of the target; None: they do not change"""
    focal_px: float = 0.0
    """As the calibration states it"""
    baseline_m: float = 0.0
    X_NB: Array | None = None
    """(F, 4, 4) reported poses of the inspector; None: it is at rest, and reports nothing"""
    sigma_theta_deg: float = 0.0
    """Of the reported poses, as stated"""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def true_K(self) -> Array:
        """(3, 3) of both cameras, whatever the calibration states."""
        height, width = self.left.shape[1:]
        return np.array(
            [[self.focal_px, 0, (width - 1) / 2], [0, self.focal_px, (height - 1) / 2], [0, 0, 1]]
        )

    def kept(self, frames: Ints | Bools) -> "Recording":
        """Only these frames; the others leave no trace."""
        return replace(
            self,
            left=self.left[frames],
            right=self.right[frames],
            stamps_ns=self.stamps_ns[frames],
            truth=_at(self.truth, frames),
            X_NB=None if self.X_NB is None else self.X_NB[frames],
        )


def read_recording(folder: Path) -> Recording:
    """A sequence that ``polhode simulate`` wrote, with its truth."""
    sequence = open_sequence(folder)
    pairs = [sequence.read_pair(k) for k in range(len(sequence))]
    stamps_ns, calibration = sequence.timestamps_ns, sequence.calibration
    truth = truth_of_frames(folder, stamps_ns)
    assert truth is not None
    return Recording(
        left=np.stack([pair.left for pair in pairs]),
        right=np.stack([pair.right for pair in pairs]),
        stamps_ns=stamps_ns,
        truth=truth,
        focal_px=float(calibration.K0[0, 0]),
        baseline_m=float(calibration.X_BC1[0, 3] - calibration.X_BC0[0, 3]),
        X_NB=sequence.X_NC if sequence.inspector_moves else None,
        sigma_theta_deg=float(np.rad2deg(sequence.sigma_camera_theta_rad)),
    )


def write_recording(recording: Recording, folder: Path) -> None:
    """The sequence as a user has it: without the truth."""
    mav0, K = folder / "mav0", recording.true_K
    interval_s = float(np.median(np.diff(recording.stamps_ns))) * 1e-9
    height, width = recording.left.shape[1:]
    for index, images in enumerate((recording.left, recording.right)):
        camera = mav0 / f"cam{index}"
        X_BC = np.eye(4)
        X_BC[0, 3] = index * recording.baseline_m
        write_sensor(camera, K, np.zeros(4), X_BC, (width, height), rate_hz=1.0 / interval_s)
        write_camera_csv(camera, recording.stamps_ns)
        for stamp, image in zip(recording.stamps_ns, images, strict=True):
            write_png(image_path(camera, int(stamp)), image)
    if recording.X_NB is not None:
        sigma_rad = float(np.deg2rad(recording.sigma_theta_deg))
        write_inspector(mav0, recording.stamps_ns, recording.X_NB, 0.0, sigma_rad)


def states_of(truth: Truth, rows: Ints) -> States:
    """The true states at some of its rows."""
    return truth_at(truth, truth.timestamps_ns[rows])


def _at(truth: Truth, frames: Ints | Bools) -> Truth:
    return replace(
        truth,
        timestamps_ns=truth.timestamps_ns[frames],
        r_N=truth.r_N[frames],
        v_N=truth.v_N[frames],
        R_NP=truth.R_NP[frames],
        w_P=truth.w_P[frames],
    )
