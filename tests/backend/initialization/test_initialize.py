"""A first motion from relative poses, good ones and bad ones."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.initialization import initialize
from polhode.backend.initialization.initialize import bridge, initialize_motion, nearest_branch
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, log_so3, make_pose
from polhode.records.tracks import RelativePoses
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(frames=30, landmarks=400, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2)


def rotation_errors_deg(sequence: SyntheticSequence, X_RG: Array) -> Array:
    """After the one constant rotation of the freely chosen G."""
    D = inverse_pose(sequence.tracks.X_NR @ X_RG) @ sequence.X_NG
    middle = D[len(D) // 2, :3, :3]
    return np.asarray(np.rad2deg(np.linalg.norm(log_so3(middle.T @ D[:, :3, :3]), axis=1)))


@pytest.mark.parametrize(
    ("scene", "seed", "limit_deg"),
    [(SCENE, 0, 1.5), (replace(SCENE, camera_moves=True), 0, 1.5),
     (replace(SCENE, wrong_pairs=0.25, outliers=0.1), 1, 3.0),
     (replace(SCENE, dropped=(0, 12, 13), camera_moves=True), 3, 12.0)],
    ids=["still camera", "moving camera", "wrong pairs and outliers", "frames without measurements"],
)  # fmt: skip
def test_poses_are_found_without_a_guess(scene: SyntheticScene, seed: int, limit_deg: float) -> None:
    sequence = generate(scene, seed)
    initial = initialize_motion(sequence.tracks, sequence.relative, Backend())
    assert np.flatnonzero(~initial.connected).tolist() == list(scene.dropped)
    assert rotation_errors_deg(sequence, initial.X_RG).max() < limit_deg


def test_bridge_follows_a_constant_rate_through_more_than_half_a_turn() -> None:
    time_s, w = np.linspace(0.0, 5.5, 12, dtype=np.float64), np.array([0.0, 1.2, 0.1])
    X = make_pose(exp_so3(time_s[:, None] * w), np.zeros((12, 3)))
    connected = np.ones(12, bool)
    connected[4:10] = False
    filled = bridge(time_s, np.where(connected[:, None, None], X, np.eye(4)), connected)
    np.testing.assert_allclose(filled, X, atol=1e-9)

    # full revolutions are added towards the expected rotation
    turn = np.array([0.0, 0.0, -1.0])
    np.testing.assert_allclose(nearest_branch(turn, np.array([0.0, 0.0, 5.0])), [0.0, 0.0, 2 * np.pi - 1.0])


def test_unconnected_frames_and_those_that_the_map_does_not_confirm_are_a_failed_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sequence, none = generate(SCENE, 4), np.zeros(0, dtype=np.int64)
    with pytest.raises(RunFailure, match="no consistent motion"):
        initialize_motion(sequence.tracks, RelativePoses(none, none, np.zeros((0, 4, 4)), none), Backend())

    def all_but_one_lost(tracks: object, X_RG: Array, connected: Bools, *_: object) -> tuple[Array, Bools]:
        return X_RG, np.arange(len(connected)) == 3

    monkeypatch.setattr(initialize, "relocalize", all_but_one_lost)
    with pytest.raises(RunFailure, match="only 1 of 30 frames agree"):
        initialize_motion(sequence.tracks, sequence.relative, Backend())
