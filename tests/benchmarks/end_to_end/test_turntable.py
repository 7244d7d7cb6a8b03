"""The turntable's camera is found again from its matrices, whatever they leave open."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

from benchmarks.end_to_end.photographs import mean_rate, read_poses
from benchmarks.end_to_end.turntable import euclidean, main
from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, make_pose

VIEWS, STEP_RAD = 12, np.deg2rad(10.0)
K = np.array([[900.0, 0.0, 41.0], [0.0, 960.0, 23.5], [0.0, 0.0, 1.0]])


def poses() -> Array:
    """(F, 4, 4) of a table that is seen from above, at a distance of 1."""
    R_0 = exp_so3([2.0, 0.1, -0.05])
    turned = exp_so3(STEP_RAD * np.arange(VIEWS)[:, None] * [0.0, 0.0, 1.0])
    return make_pose(R_0 @ turned, np.array([0.0, 0.1, np.sqrt(0.99)]))


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_projective_map_along_the_axis_is_undone(mirrored: bool) -> None:
    X_CO = poses()
    H = np.eye(4)
    H[2, 2], H[3, 2] = (-1.0 if mirrored else 1.0) * 1.4, 0.2
    table = euclidean(np.array([1.0, -3.0] * 6)[:, None, None] * (K @ X_CO[:, :3] @ H), 23.5)
    np.testing.assert_allclose(table.K, K, rtol=1e-6, atol=1e-4)
    # the frame of the object is free but for its axis
    found, true = (X[1:, :3, :3] @ np.swapaxes(X[:-1, :3, :3], 1, 2) for X in (table.X_CO, X_CO))
    np.testing.assert_allclose(found, true, atol=1e-6)
    np.testing.assert_allclose(table.X_CO[:, :3, 3], X_CO[:, :3, 3], atol=1e-6)


def test_matrices_of_two_cameras_are_refused() -> None:
    P = K @ poses()[:, :3]
    P[5] = np.diag([1.1, 1.0, 1.0]) @ P[5]
    with pytest.raises(InputError, match="not those of one camera before a turntable"):
        euclidean(P, 23.5)


def test_the_sequence_has_the_pairs_and_their_motion(tmp_path: Path) -> None:
    views = tmp_path / "views"
    views.mkdir()
    grey = np.random.default_rng(1).integers(0, 255, (VIEWS, 48, 64), dtype=np.uint8)
    for k in range(VIEWS):
        Image.fromarray(grey[k]).save(views / f"{k:02d}.png")
    cell = np.empty((1, VIEWS), dtype=object)
    for k, X in enumerate(poses()):
        cell[0, k] = K @ X[:3]
    savemat(tmp_path / "P.mat", {"P": cell})
    main(views, tmp_path / "P.mat", tmp_path / "seq")
    sequence = open_sequence(tmp_path / "seq")
    assert len(sequence) == VIEWS - 1
    stamps, X_CO = read_poses(tmp_path / "seq" / "truth.csv")
    w = mean_rate(1e-9 * (stamps - stamps[0]), X_CO[:, :3, :3])
    assert np.linalg.norm(w) == pytest.approx(STEP_RAD, rel=1e-6)
    # the right camera of a pair sees the object as the left one of the next does
    X_BC1 = sequence.calibration.X_BC1
    np.testing.assert_allclose(X_BC1 @ X_CO[1:], X_CO[:-1], atol=1e-6)
