"""A run and a bare sequence in Rerun: what was logged is what was stored or recorded, and no truth."""

import shutil
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.geometry.lie import exp_so3, make_pose
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import mask_path, write_inspector, write_png
from polhode.report.residual_figures import INLIER_WEIGHT
from polhode.run_directory.archives import write_online
from polhode.run_directory.stored_run import StoredMotion, read_stored_run
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.viewer import recorder as recorder_module
from polhode.viewer import show_run as module
from polhode.viewer.recorder import BAND, INLIER, TRACK_FRAMES
from polhode.viewer.show_run import pictures_of, show_run, show_sequence
from polhode.viewer.target import ViewTarget
from tests.conftest import BASELINE_M, HEIGHT_PX, TIMESTAMPS_NS, WIDTH_PX, MakeOnce
from tests.pipeline.conftest import N_FRAMES, REST_FRAMES, Example, write_example
from tests.report.conftest import UNKNOWN_UNTIL, online_of
from tests.viewer.read_recording import rows_of, values_of

FLOAT = 1e-6
"""Relative error of single precision, in which Rerun holds what is drawn"""


def recorded(run: Path, file: Path) -> Path:
    show_run(run, None, ViewTarget(file, window=False), Silent())
    return file


def recorded_sequence(sequence: Path, file: Path) -> Path:
    show_sequence(sequence, ViewTarget(file, window=False), Silent())
    return file


def series(recording: Path, entity: str) -> np.ndarray:
    return np.array(list(values_of(recording, entity, "Scalars:scalars").values()))


@pytest.fixture(scope="module")
def run(make_once: MakeOnce, example: Example) -> Path:
    """A run whose ratios are determined from ``UNKNOWN_UNTIL`` on."""

    def write(folder: Path) -> None:
        folder.mkdir()
        write_online(online_of(example.estimate), folder / "online.npz")
        write_example(folder, example)

    return make_once("viewed_run", write)


@pytest.fixture(scope="module")
def motion(run: Path) -> StoredMotion:
    found = read_stored_run(run, "run").motion
    assert found is not None
    return found


@pytest.fixture(scope="module")
def recording(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(run, tmp_path_factory.mktemp("view") / "run.rrd")


def test_states_poses_and_bands_are_those_of_the_run(motion: StoredMotion, recording: Path) -> None:
    path = motion.trajectory
    for entity, stored in (
        ("/plots/r_N_m", path.r_N), ("/plots/v_N_m_s", path.v_N), ("/plots/w_P_deg_s", np.rad2deg(path.w_P)),
    ):  # fmt: skip
        np.testing.assert_allclose(series(recording, entity), stored, rtol=1e-15)
    poses = values_of(recording, "/N/target", "Transform3D:translation")
    translations = np.array(list(poses.values()))[:, 0]
    np.testing.assert_allclose(translations, motion.X_NG[:, :3, 3], rtol=FLOAT, atol=1e-9)
    turns = np.array(list(values_of(recording, "/N/target", "Transform3D:mat3x3").values()))
    # column by column
    np.testing.assert_allclose(turns.reshape(-1, 3, 3).swapaxes(1, 2), motion.X_NG[:, :3, :3], atol=FLOAT)
    band = series(recording, f"/plots/r_N_m/{BAND}")
    np.testing.assert_allclose(band[:, :3] - path.r_N, 3.0 * path.sigma_r, rtol=1e-9)
    np.testing.assert_allclose(path.r_N - band[:, 3:], 3.0 * path.sigma_r, rtol=1e-9)
    ratios = series(recording, f"/plots/k/{BAND}")
    assert np.isnan(ratios[:UNKNOWN_UNTIL]).all() and np.isfinite(ratios[UNKNOWN_UNTIL:]).all()


def test_the_ellipsoid_has_the_covariance_of_its_label_and_an_undetermined_position_none(
    motion: StoredMotion, recording: Path, undetermined: Example, tmp_path: Path
) -> None:
    entity = "/N/position_three_sigma"
    half = np.array(list(values_of(recording, entity, "Ellipsoids3D:half_sizes").values()))[:, 0]
    largest = 3.0 * motion.trajectory.sigma_r.max(axis=1)
    np.testing.assert_allclose(half.max(axis=1) / largest, 10.0, rtol=1e-5)
    labels = values_of(recording, entity, "Ellipsoids3D:labels")
    assert labels[0] == [f"3σ ×10: {1e3 * largest[0]:.2g} mm"]
    folder = tmp_path / "run"
    folder.mkdir()
    write_example(folder, undetermined)
    file = recorded(folder, tmp_path / "run.rrd")
    assert [*values_of(file, entity, "Ellipsoids3D:half_sizes").values()] == [[]] * N_FRAMES
    band = series(file, f"/plots/r_N_m/{BAND}")
    assert (np.isnan(band) == np.tile([False, True, False], (N_FRAMES, 2))).all()
    (folder / "trajectory.csv").unlink()
    with pytest.raises(InputError, match="has no motion to show"):
        recorded(folder, tmp_path / "run.rrd")


def test_features_tracks_landmarks_and_mesh(recording: Path, example: Example) -> None:
    tracks, weights = example.tracks, example.estimate.inlier_weight
    points = values_of(recording, "/N/camera/left/features", "Points2D:positions")
    colors = values_of(recording, "/N/camera/left/features", "Points2D:colors")
    lines = values_of(recording, "/N/camera/left/tracks", "LineStrips2D:strips")
    green = int.from_bytes(bytes((*INLIER, 255)), "big")
    for k in range(N_FRAMES):
        rows = tracks.frame == k
        uv_px = np.array(points[k]).reshape(-1, 2)
        np.testing.assert_allclose(uv_px, tracks.uvd_px[rows, :2] + 0.5, rtol=FLOAT)
        assert sum(color == green for color in colors[k]) == int((weights[rows] >= INLIER_WEIGHT).sum())
        recent = (tracks.frame >= k - TRACK_FRAMES) & (tracks.frame <= k)
        seen = np.bincount(tracks.landmark[recent], minlength=tracks.n_landmarks)[tracks.landmark[rows]]
        assert [len(line) for line in lines[k]] == seen[seen > 1].tolist()
    # each landmark with the first frame that observes it, the mesh throughout
    shown = values_of(recording, "/N/target/landmarks", "Points3D:positions")
    first = [int(tracks.frame[tracks.landmark == n].min()) for n in range(tracks.n_landmarks)]
    assert {k: len(points) for k, points in shown.items()} == {k: first.count(k) for k in sorted(set(first))}
    mesh = example.surface.mesh
    (vertices,) = values_of(recording, "/N/target/mesh", "Mesh3D:vertex_positions").values()
    np.testing.assert_allclose(vertices, mesh.vertices, atol=FLOAT)
    (faces,) = values_of(recording, "/N/target/mesh", "Mesh3D:triangle_indices").values()
    np.testing.assert_array_equal(faces, mesh.faces)


def test_images_come_from_the_sequence_of_the_run_alone(
    run: Path, small_sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = read_stored_run(run, "run")
    assert stored.tracks is not None
    sequence = open_sequence(small_sequence)
    assert pictures_of(sequence, stored.tracks)(0) is None, "no pair has the time of this frame"
    monkeypatch.setattr(module, "MAX_PICTURES", 3)
    shown = pictures_of(sequence, replace(stored.tracks, timestamps_ns=sequence.timestamps_ns))
    assert [shown(k) is not None for k in range(len(sequence))] == [True, False] * 3


def picture(blob: list[list[int]]) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(bytes(blob[0]))))


def test_a_sequence_is_shown_as_recorded(
    small_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mask = np.zeros((HEIGHT_PX, WIDTH_PX), dtype=np.uint8)
    mask[12:36, 20:44] = 255
    write_png(mask_path(small_sequence / "mav0", 0, int(TIMESTAMPS_NS[1])), mask)
    X_NB = np.stack([make_pose(exp_so3([0.0, 0.1 * k, 0.0]), [0.2 * k, 0.0, 0.0]) for k in range(6)])
    write_inspector(small_sequence / "mav0", TIMESTAMPS_NS, X_NB, 0.0, 0.0)
    file, sequence = recorded_sequence(small_sequence, tmp_path / "s.rrd"), open_sequence(small_sequence)
    for side, name in enumerate(("left", "right")):
        blobs = values_of(file, f"/N/camera/{name}", "EncodedImage:blob")
        assert list(blobs) == list(range(len(TIMESTAMPS_NS)))
        pair = sequence.read_pair(2)
        error = picture(blobs[2]).astype(float) - (pair.left, pair.right)[side]
        # single pixels of noise are what JPEG keeps least
        assert np.abs(error).mean() < 6.0
        camera = values_of(file, f"/N/camera/{name}", "Pinhole:image_from_camera")[-1][0]
        np.testing.assert_allclose(camera, [50, 0, 0, 0, 51, 0, 32, 24, 1])
    right = values_of(file, "/N/camera/right", "Transform3D:translation")[-1][0]
    np.testing.assert_allclose(right, [BASELINE_M, 0, 0], rtol=1e-6)
    times = [row["time"].total_seconds() for _, row in rows_of(file)["/N/camera"]]
    np.testing.assert_allclose(times, 1e-9 * (TIMESTAMPS_NS - TIMESTAMPS_NS[0]))
    lines = values_of(file, "/N/camera/left/mask", "LineStrips2D:strips")
    assert [len(lines[k]) for k in range(6)] == [0, 1, 0, 0, 0, 0]
    corners = np.array(lines[1][0])
    assert corners.min(axis=0).tolist() == [20.5, 12.5] and corners.max(axis=0).tolist() == [43.5, 35.5]
    poses = values_of(file, "/N/camera", "Transform3D:translation")
    np.testing.assert_allclose([poses[k][0] for k in range(6)], X_NB[:, :3, 3], atol=1e-6)
    path = values_of(file, "/N/camera_path", "LineStrips3D:strips")
    np.testing.assert_allclose([line[0][1] for line in path.values()], X_NB[1:, :3, 3], atol=1e-6)
    # large images are shown smaller and agree with their camera
    monkeypatch.setattr(recorder_module, "MAX_SIDE_PX", 40)
    file = recorded_sequence(small_sequence, tmp_path / "s.rrd")
    blob = values_of(file, "/N/camera/left", "EncodedImage:blob")[0]
    assert picture(blob).shape == (HEIGHT_PX // 2, WIDTH_PX // 2)
    camera = values_of(file, "/N/camera/left", "Pinhole:image_from_camera")[-1][0]
    np.testing.assert_allclose(camera, [25, 0, 0, 0, 25.5, 0, 16, 12, 1])


def test_truth_is_not_shown(at_rest: Path, tmp_path: Path) -> None:
    without = tmp_path / "without"
    shutil.copytree(at_rest, without)
    shutil.rmtree(without / "mav0" / "target0")
    first, second = (recorded_sequence(at_rest, tmp_path / "a"), recorded_sequence(without, tmp_path / "b"))
    assert repr(rows_of(first)) == repr(rows_of(second))
    assert len(values_of(first, "/N/camera/left", "EncodedImage:blob")) == REST_FRAMES
