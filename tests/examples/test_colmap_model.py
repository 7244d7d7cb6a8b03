"""The model for COLMAP: what it reads is what the run found."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import polhode
from examples import colmap_model
from polhode import stages
from polhode.geometry.lie import make_pose, matrix_from_wxyz, transform_points
from tests.pipeline.conftest import make_example


def test_a_model_of_colmap_projects_where_the_features_were() -> None:
    example = make_example()
    tracks, X_NG = example.tracks, example.estimate.X_NG
    files = colmap_model.model_of(tracks, X_NG)
    f, cx, cy = (float(files["cameras.txt"].split()[n]) for n in (4, 6, 7))
    points = {int(line.split()[0]): line.split() for line in files["points3D.txt"].splitlines()}
    lines, errors = files["images.txt"].splitlines(), []
    assert len(lines) == 2 * tracks.n_frames and len(points) == tracks.n_landmarks
    for head, body in zip(lines[::2], lines[1::2], strict=True):
        number, *pose = head.split()[:8]
        X_RG = make_pose(matrix_from_wxyz(np.array(pose[:4], float)), np.array(pose[4:], float))
        for place, (u, v, point) in enumerate(np.array(body.split(), float).reshape(-1, 3)):
            p = transform_points(X_RG, np.array(points[int(point)][1:4], float))[0]
            errors.append(np.hypot(f * p[0] / p[2] + cx - u, f * p[1] / p[2] + cy - v))
            track = np.array(points[int(point)][8:], int).reshape(-1, 2).tolist()
            assert [int(number), place] in track
    assert len(errors) == len(tracks.frame) and np.median(errors) < 1.0
    assert cx == tracks.rig.cx_px + 0.5  # COLMAP's pixels begin at their corner


def test_the_points_and_images_of_colmap_are_those_of_the_run_and_no_others(
    finished: Path,
    rendered_sequence: Path,
    small_sequence: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words, model = [str(finished), "-o", str(tmp_path / "colmap"), "--data"], tmp_path / "colmap"
    assert colmap_model.main([*words, str(small_sequence)]) == 2
    assert "not the sequence of" in capsys.readouterr().err and not model.exists()
    assert colmap_model.main([*words, str(rendered_sequence)]) == 0
    run = polhode.load(finished)
    lines = [line.split() for line in (model / "points3D.txt").read_text().splitlines()]
    count = len(run.landmarks.p_G)
    assert [int(line[0]) for line in lines] == list(range(1, count + 1))
    assert f"{run.measurements.n_frames} images, {count} points" in capsys.readouterr().out
    distance_m = np.linalg.norm(np.array([line[1:4] for line in lines], float) - run.landmarks.p_G, axis=1)
    assert np.median(distance_m) < 1e-3
    context = stages.open_sequence(rendered_sequence)
    for k, head in enumerate((model / "images.txt").read_text().splitlines()[::2]):
        name = head.split()[-1]
        assert name == f"{context.sequence.timestamps_ns[k]}.png"
        image = cv2.imread(str(model / "images" / name), cv2.IMREAD_GRAYSCALE)
        np.testing.assert_array_equal(image, stages.rectified_pair(context, k).left)


def test_a_folder_that_is_no_run_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert colmap_model.main([str(tmp_path), "-o", str(tmp_path / "m")]) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("error: ") and stderr.count("\n") == 1 and not (tmp_path / "m").exists()
