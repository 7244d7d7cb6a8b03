"""Examples that hand a run to other programs: what they read is what the run found."""

from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest

import polhode
from examples import basilisk_state, colmap_model, tracks_in_gtsam
from examples.basilisk_state import hub_state, rodrigues_parameters
from polhode import stages
from polhode.geometry.lie import (
    exp_so3,
    hat,
    inverse_pose,
    make_pose,
    matrix_from_wxyz,
    transform_points,
    wxyz_from_matrix,
)
from tests.pipeline.conftest import Example, make_example


@pytest.fixture(scope="module")
def example() -> Example:
    return make_example()


def test_a_model_of_colmap_projects_where_the_features_were(example: Example) -> None:
    tracks, X_NG = example.tracks, example.estimate.X_NG
    files = colmap_model.model_of(tracks, X_NG)
    f, cx, cy = (float(files["cameras.txt"].split()[n]) for n in (4, 6, 7))
    points = {int(line.split()[0]): line.split() for line in files["points3D.txt"].splitlines()}
    lines = files["images.txt"].splitlines()
    assert len(lines) == 2 * tracks.n_frames and len(points) == tracks.n_landmarks
    errors, seen = [], 0
    for head, body in zip(lines[::2], lines[1::2], strict=True):
        number, *pose = head.split()[:8]
        X_RG = make_pose(matrix_from_wxyz(np.array(pose[:4], float)), np.array(pose[4:], float))
        marks = np.array(body.split(), float).reshape(-1, 3)
        for place, (u, v, point) in enumerate(marks):
            p = transform_points(X_RG, np.array(points[int(point)][1:4], float))[0]
            errors.append(np.hypot(f * p[0] / p[2] + cx - u, f * p[1] / p[2] + cy - v))
            track = np.array(points[int(point)][8:], int).reshape(-1, 2).tolist()
            assert [int(number), place] in track
            seen += 1
    assert seen == len(tracks.frame) and np.median(errors) < 1.0
    assert cx == tracks.rig.cx_px + 0.5  # COLMAP's pixels begin at their corner


def test_the_points_of_colmap_are_those_of_the_map_in_its_order(
    finished: Path, rendered_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(finished), "--data", str(rendered_sequence), "-o", str(tmp_path / "colmap")]
    assert colmap_model.main(words) == 0
    run = polhode.load(finished)
    lines = [line.split() for line in (tmp_path / "colmap" / "points3D.txt").read_text().splitlines()]
    count = len(run.landmarks.p_G)
    assert [int(line[0]) for line in lines] == list(range(1, count + 1))
    assert f"{run.measurements.n_frames} images, {count} points" in capsys.readouterr().out
    distance_m = np.linalg.norm(np.array([line[1:4] for line in lines], float) - run.landmarks.p_G, axis=1)
    assert np.median(distance_m) < 1e-3
    heads = (tmp_path / "colmap" / "images.txt").read_text().splitlines()[::2]
    images = {
        name: cv2.imread(str(tmp_path / "colmap" / "images" / name), cv2.IMREAD_GRAYSCALE)
        for name in (head.split()[-1] for head in heads)
    }
    context = stages.open_sequence(rendered_sequence)
    for k, (name, image) in enumerate(images.items()):
        assert name == f"{context.sequence.timestamps_ns[k]}.png"
        np.testing.assert_array_equal(image, stages.rectified_pair(context, k).left)


def test_images_of_another_sequence_are_refused(
    finished: Path, small_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(finished), "--data", str(small_sequence), "-o", str(tmp_path / "colmap")]
    assert colmap_model.main(words) == 2
    assert "not the sequence of" in capsys.readouterr().err and not (tmp_path / "colmap").exists()


def test_gtsam_finds_the_poses_of_the_run(example: Example) -> None:
    tracks, X_GR = example.tracks, tracks_in_gtsam.camera_poses(example.tracks, example.estimate.X_NG)
    np.testing.assert_allclose(tracks.X_NR @ inverse_pose(X_GR), example.estimate.X_NG, atol=1e-12)
    graph, values = tracks_in_gtsam.graph_of(tracks, X_GR[0]), tracks_in_gtsam.start(tracks, X_GR)
    assert graph.size() == len(tracks.frame) + 1
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert graph.error(found) < graph.error(values)
    # of residuals of three components with noise of unit variance, under the kernel
    assert graph.error(found) < 1.5 * len(tracks.frame)
    measured = np.unique(tracks.frame)
    shift_m, turn_deg = tracks_in_gtsam.differences(found, X_GR)
    assert np.median(shift_m[measured]) < 3e-3 and np.median(turn_deg[measured]) < 0.5


def test_rodrigues_parameters_are_those_of_basilisk() -> None:
    """[BN] = I + (8 S S - 4 (1 - s2) S) / (1 + s2)^2, S = hat(sigma), s2 its square (Schaub and Junkins)."""
    for turn in ([0.3, -0.8, 1.1], [2.0, 2.0, 0.5], [0.0, 0.0, 0.0]):
        R_NB = exp_so3(turn)
        sigma = rodrigues_parameters(wxyz_from_matrix(R_NB))
        S, s2 = hat(sigma), float(sigma @ sigma)
        BN = np.eye(3) + (8.0 * S @ S - 4.0 * (1.0 - s2) * S) / (1.0 + s2) ** 2
        np.testing.assert_allclose(BN, R_NB.T, atol=1e-12)
        assert s2 <= 1.0
        np.testing.assert_allclose(rodrigues_parameters(-wxyz_from_matrix(R_NB)), sigma)


def test_the_hub_has_the_state_of_the_export() -> None:
    last = {"r_N": [1.0, 2.0, 3.0], "v_N": [0.1, 0.2, 0.3], "q_NP_wxyz": [1.0, 0, 0, 0], "w_P": [0, 0, 0.4]}
    state = hub_state({"last": last, "inertial": {"mass_kg": 5.0, "moments_kg_m2": [3.0, 2.0, 1.5]}})
    assert state["mHub"] == 5.0 and state["r_CN_NInit"].tolist() == [[1.0], [2.0], [3.0]]
    assert state["IHubPntBc_B"].tolist() == [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.5]]
    assert state["omega_BN_BInit"].tolist() == [[0.0], [0.0], [0.4]]
    assert state["v_CN_NInit"].tolist() == [[0.1], [0.2], [0.3]]
    assert state["sigma_BNInit"].tolist() == [[0.0], [0.0], [0.0]]


def test_a_folder_that_is_no_run_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert colmap_model.main([str(tmp_path), "-o", str(tmp_path / "m")]) == 2
    assert tracks_in_gtsam.main([str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and all(line.startswith("error: ") for line in lines)
    assert not (tmp_path / "m").exists()
    with pytest.raises(FileNotFoundError):
        basilisk_state.main([str(tmp_path / "none.json")])
