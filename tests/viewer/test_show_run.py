"""A finished run in Rerun: what was logged is what the run stored."""

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import inverse_pose
from polhode.records.dataset import open_sequence
from polhode.records.estimate import OnlineEstimate
from polhode.report.residual_figures import INLIER_WEIGHT
from polhode.run_directory.archives import write_online
from polhode.run_directory.stored_run import read_stored_run
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.viewer import show_run as module
from polhode.viewer.mesh_growth import first_seen, growth
from polhode.viewer.recorder import BAND, INLIER, TRACK_FRAMES
from polhode.viewer.show_run import pictures_of, show_run
from polhode.viewer.target import ViewTarget
from tests.conftest import MakeOnce
from tests.pipeline.conftest import N_FRAMES, RIG, Example, write_example
from tests.viewer.read_recording import values_of

FLOAT = 1e-6
"""Relative error of single precision, in which Rerun holds what is drawn"""


def recorded(run: Path, file: Path, data: Path | None = None) -> Path:
    show_run(run, data, ViewTarget(file, window=False), Silent())
    return file


@pytest.fixture(scope="module")
def run(make_once: MakeOnce, example: Example) -> Path:
    """A run whose ratios are determined from the tenth frame on."""

    def write(folder: Path) -> None:
        folder.mkdir()
        write_online(_online(example), folder / "online.npz")
        write_example(folder, example)

    return make_once("viewed_run", write)


@pytest.fixture(scope="module")
def recording(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(run, tmp_path_factory.mktemp("view") / "run.rrd")


def _online(example: Example) -> OnlineEstimate:
    estimate, mass = example.estimate, example.estimate.mass
    n = N_FRAMES
    known = np.tile(np.arange(n)[:, None] >= 10, (1, 4))
    return OnlineEstimate(
        estimate.timestamps_ns, estimate.r_N, estimate.v_N, estimate.R_NP, estimate.w_P, estimate.covariance,
        estimate.X_NG, np.tile([mass.k1, mass.k2], (n, 1)), np.tile(mass.cov_k, (n, 1, 1)),
        np.tile(mass.com_G, (n, 1)), np.tile(mass.cov_com_G, (n, 1, 1)), np.tile(mass.R_GP, (n, 1, 1)),
        np.tile(mass.cov_R_GP, (n, 1, 1)), known,
    )  # fmt: skip


def test_states_and_poses_are_those_of_the_run(run: Path, recording: Path) -> None:
    motion = read_stored_run(run, "run").motion
    assert motion is not None
    path = motion.trajectory
    for entity, expected in (("r_N_m", path.r_N), ("v_N_m_s", path.v_N), ("w_P_deg_s", np.rad2deg(path.w_P))):
        logged = values_of(recording, f"/plots/{entity}", "Scalars:scalars")
        assert list(logged) == [-1, *range(N_FRAMES)][1:]
        np.testing.assert_allclose(np.array(list(logged.values())), expected, rtol=1e-15)
    poses = values_of(recording, "/N/target", "Transform3D:translation")
    np.testing.assert_allclose(
        np.array(list(poses.values()))[:, 0], motion.X_NG[:, :3, 3], rtol=FLOAT, atol=1e-9
    )
    turns = np.array(list(values_of(recording, "/N/target", "Transform3D:mat3x3").values()))
    # column by column
    np.testing.assert_allclose(turns.reshape(-1, 3, 3).swapaxes(1, 2), motion.X_NG[:, :3, :3], atol=FLOAT)


def test_bands_are_three_standard_deviations(run: Path, recording: Path) -> None:
    motion = read_stored_run(run, "run").motion
    assert motion is not None
    band = np.array(list(values_of(recording, f"/plots/r_N_m/{BAND}", "Scalars:scalars").values()))
    sigma = motion.trajectory.sigma_r
    np.testing.assert_allclose(band[:, :3] - motion.trajectory.r_N, 3.0 * sigma, rtol=1e-9)
    np.testing.assert_allclose(motion.trajectory.r_N - band[:, 3:], 3.0 * sigma, rtol=1e-9)
    ratios = np.array(list(values_of(recording, f"/plots/k/{BAND}", "Scalars:scalars").values()))
    assert np.isnan(ratios[:10]).all() and np.isfinite(ratios[10:]).all()


def test_the_ellipsoid_has_the_covariance_that_its_label_states(run: Path, recording: Path) -> None:
    motion = read_stored_run(run, "run").motion
    assert motion is not None
    entity = "/N/position_three_sigma"
    half = np.array(list(values_of(recording, entity, "Ellipsoids3D:half_sizes").values()))[:, 0]
    largest = 3.0 * motion.trajectory.sigma_r.max(axis=1)
    labels = values_of(recording, entity, "Ellipsoids3D:labels")
    enlarged = half.max(axis=1) / largest
    np.testing.assert_allclose(enlarged, 10.0, rtol=1e-5)
    assert labels[0] == [f"3σ ×10: {1e3 * largest[0]:.2g} mm"]


def test_an_undetermined_position_has_no_ellipsoid_and_no_band(undetermined: Example, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    write_example(folder, undetermined)
    file = recorded(folder, tmp_path / "run.rrd")
    half = values_of(file, "/N/position_three_sigma", "Ellipsoids3D:half_sizes")
    assert list(half.values()) == [[]] * N_FRAMES
    band = np.array(list(values_of(file, f"/plots/r_N_m/{BAND}", "Scalars:scalars").values()))
    assert (np.isnan(band) == np.tile([False, True, False], (N_FRAMES, 2))).all()


def test_features_and_tracks_of_each_frame(recording: Path, example: Example) -> None:
    tracks, weights = example.tracks, example.estimate.inlier_weight
    points = values_of(recording, "/N/camera/left/features", "Points2D:positions")
    colors = values_of(recording, "/N/camera/left/features", "Points2D:colors")
    lines = values_of(recording, "/N/camera/left/tracks", "LineStrips2D:strips")
    green = int.from_bytes(bytes((*INLIER, 255)), "big")
    for k in range(N_FRAMES):
        rows = tracks.frame == k
        np.testing.assert_allclose(
            np.array(points[k]).reshape(-1, 2), tracks.uvd_px[rows, :2] + 0.5, rtol=FLOAT
        )
        assert sum(color == green for color in colors[k]) == int((weights[rows] >= INLIER_WEIGHT).sum())
        recent = (tracks.frame >= k - TRACK_FRAMES) & (tracks.frame <= k)
        seen = np.bincount(tracks.landmark[recent], minlength=tracks.n_landmarks)[tracks.landmark[rows]]
        assert [len(line) for line in lines[k]] == seen[seen > 1].tolist()


def test_each_landmark_appears_with_the_first_frame_that_observes_it(
    recording: Path, example: Example
) -> None:
    shown = values_of(recording, "/N/target/landmarks", "Points3D:positions")
    tracks = example.tracks
    first = [int(tracks.frame[tracks.landmark == n].min()) for n in range(tracks.n_landmarks)]
    assert {k: len(points) for k, points in shown.items()} == {k: first.count(k) for k in sorted(set(first))}


def test_the_mesh_grows_by_what_the_frames_have_seen(recording: Path, example: Example) -> None:
    faces = values_of(recording, "/N/target/mesh", "Mesh3D:triangle_indices")
    counts = list(faces.values())
    assert min(faces) == 0
    assert all(len(a) < len(b) for a, b in pairwise(counts))
    assert len(counts[-1]) == len(example.surface.mesh.faces) > 2 * len(counts[0]) > 0
    vertices = values_of(recording, "/N/target/mesh", "Mesh3D:vertex_positions")[-1]
    np.testing.assert_allclose(vertices, example.surface.mesh.vertices, atol=FLOAT)


def test_a_vertex_is_seen_from_the_side_of_the_camera_alone(example: Example) -> None:
    ball = trimesh.creation.icosphere(3, 0.1)
    X_RG = np.tile(np.eye(4), (2, 1, 1))
    X_RG[:, 2, 3] = 0.6
    # the second frame looks from behind
    X_RG[1, :3, :3] = np.diag([-1.0, 1.0, -1.0])
    first, depth = first_seen(ball, X_RG, RIG), ball.vertices[:, 2]
    assert (first[depth < -0.05] == 0).all() and (first[depth > 0.05] == 1).all()
    # behind the camera nothing is seen, and the last frame shows the mesh all the same
    away = np.tile(inverse_pose(X_RG[0]), (3, 1, 1))
    assert (first_seen(ball, away, RIG) == 3).all()
    assert [(k, len(faces)) for k, faces in growth(ball, away, RIG)] == [(0, 0), (2, len(ball.faces))]


def test_images_come_from_the_sequence_of_the_run_alone(
    run: Path, small_sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = read_stored_run(run, "run")
    assert stored.tracks is not None
    sequence = open_sequence(small_sequence)
    pictures = pictures_of(sequence, stored.tracks)
    assert pictures(0) is None, "no pair has the time of this frame"
    monkeypatch.setattr(module, "MAX_PICTURES", 3)
    shown = pictures_of(sequence, replace(stored.tracks, timestamps_ns=sequence.timestamps_ns))
    assert [shown(k) is not None for k in range(len(sequence))] == [True, False] * 3


def test_a_run_without_a_motion_is_refused(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "trajectory.csv").unlink()
    with pytest.raises(InputError, match="has no motion to show"):
        recorded(folder, tmp_path / "run.rrd")
