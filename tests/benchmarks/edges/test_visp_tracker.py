"""ViSP beside us: the model that it gets, what its covariance means, and its poses where it is installed."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.edges.tracking.calibrated_covariance import nees
from benchmarks.edges.views import SOLIDS, middle, perturbed, pose_errors, random_poses
from benchmarks.edges.visp_tracker import (
    Answer,
    NoVispError,
    Options,
    TrackerTrial,
    about_camera_axes,
    cao_text,
    our_answer,
    polygons_of,
    program,
    row,
    trial_of,
    visp_answer,
    visp_poses,
)
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, log_so3, make_pose

ROOT = Path(__file__).parents[3]


def area(polygon: Array) -> Array:
    return np.asarray(0.5 * np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0))


@pytest.mark.parametrize("name", list(SOLIDS))
def test_the_polygons_of_a_solid_close_around_its_volume(name: str) -> None:
    mesh = SOLIDS[name]()
    polygons = polygons_of(mesh)
    areas = np.array([area(polygon) for polygon in polygons])
    assert np.abs(areas.sum(axis=0)).max() < 1e-9
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(mesh.area)
    # wound outwards: the divergence theorem gives the volume with its sign
    volume = sum(polygon[0] @ vector for polygon, vector in zip(polygons, areas, strict=True)) / 3
    assert volume == pytest.approx(mesh.volume)


def test_flat_faces_are_whole_and_holes_are_closed() -> None:
    steps = polygons_of(SOLIDS["steps"]())
    assert sorted(len(polygon) for polygon in steps) == [4] * 8 + [8, 8]
    ring = trimesh.creation.annulus(r_min=0.1, r_max=0.3, height=0.2, sections=6)
    assert sorted(len(polygon) for polygon in polygons_of(ring)) == [4] * 12 + [6, 6]


def test_the_text_of_a_model_holds_points_lines_and_faces() -> None:
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    rows = cao_text([triangle, triangle[:2]]).splitlines()
    assert rows[:3] == ["V1", "# points", "3"]
    points = np.array([[float(word) for word in row.split()] for row in rows[3:6]])
    assert rows[6:8] == ["# lines", "1"]
    np.testing.assert_allclose(points[[int(k) for k in rows[8].split()]], triangle[:2])
    assert rows[9:13] == ["# faces of lines", "0", "# faces of points", "1"]
    count, *corners = (int(k) for k in rows[13].split())
    assert count == 3
    np.testing.assert_allclose(points[corners], triangle)
    with pytest.raises(InputError, match="needs polygons"):
        cao_text([triangle[:1]])


def test_a_covariance_is_turned_into_the_axes_of_the_errors() -> None:
    rng = np.random.default_rng(0)
    X_CG = random_poses(SOLIDS["wedge"](), trial_of("wedge", Options(views=0))[0].rig, 1, seed=4)[0]
    about_G = np.array([0.1, 0.4, -0.2])
    theta, step = log_so3(X_CG[:3, :3]), 1e-6
    columns = []
    for k in range(6):
        change = step * np.eye(6)[k]
        near = make_pose(exp_so3(theta + change[3:]), X_CG[:3, 3] + change[:3])
        columns.append(pose_errors(near[None], X_CG[None], about_G)[0] / step)
    T = np.array(columns).T
    A = rng.standard_normal((6, 6))
    np.testing.assert_allclose(
        about_camera_axes(A @ A.T, X_CG, about_G), T @ A @ A.T @ T.T, rtol=1e-4, atol=1e-5
    )


def test_a_row_counts_what_is_lost_and_what_is_wrong() -> None:
    mesh = SOLIDS["wedge"]()
    about_G = middle(mesh)
    X_CG = np.tile(make_pose(np.eye(3), [0.0, 0.0, 3.0]), (200, 1, 1))
    found = perturbed(X_CG, about_G, seed=1, angle_deg=0.1, shift_m=0.002)
    found[0, 2, 3] += 1.0
    found[1, 0, 3] += 9.0
    covariance = np.tile(np.diag([0.002**2] * 3 + [np.deg2rad(0.1) ** 2] * 3), (200, 1, 1))
    lost = np.zeros(200, dtype=bool)
    lost[1] = True
    covariance[lost] = np.nan
    cells = row("wedge", "none", Answer(found, lost, covariance), X_CG, about_G)
    assert cells[:4] == ["wedge", "none", "1", "1"]
    np.testing.assert_allclose([float(cell) for cell in cells[4:7]], 2.0, rtol=0.15)
    np.testing.assert_allclose([float(cell) for cell in cells[7:10]], 0.1, rtol=0.15)
    assert float(cells[10]) == pytest.approx(1.0, abs=0.15)
    assert nees(np.ones((1, 6)), 4.0 * np.eye(6)[None]) == pytest.approx([1.5])


def test_without_visp_or_a_compiler_there_is_one_line() -> None:
    words = [sys.executable, "-m", "benchmarks.edges.visp_tracker", "block", "--views", "1"]
    for compiler, message in (("no-such-compiler", "no C\\+\\+ compiler"), ("false", "ViSP is not here")):
        place = {"CXX": compiler, "PATH": "/usr/bin:/bin"}
        done = subprocess.run(words, cwd=ROOT, env=place, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert done.stdout == "" and len(done.stderr.splitlines()) == 1
        assert done.stderr.startswith("polhode: error: ")
        assert re.search(message, done.stderr)


@pytest.fixture(scope="module")
def visp() -> Path:
    try:
        return program()
    except NoVispError as missing:
        pytest.skip(str(missing))


@pytest.mark.usefixtures("visp")
def test_visp_comes_nearer_than_it_started() -> None:
    trial, X_CG = trial_of("wedge", Options(views=8, angle_deg=1.0, shift_m=0.01, seed=3))
    answer, about_G = visp_answer(trial), middle(trial.mesh)
    assert answer.statistics.keys() == {"sites", "weights", "residual", "projection_error_deg", "seconds"}
    assert (answer.statistics["sites"][~answer.lost] > 20).all()
    before, after = (np.abs(pose_errors(X, X_CG, about_G)) for X in (trial.X_start, answer.X_CG))
    assert (np.median(after, axis=0) < 0.5 * np.median(before, axis=0)).all()


@pytest.mark.usefixtures("visp")
def test_visp_says_when_it_sees_nothing() -> None:
    trial, _ = trial_of("wedge", Options(views=1))
    black = [np.zeros_like(trial.images[0])]
    X_CG, _, statistics = visp_poses(polygons_of(trial.mesh), trial.rig, black, trial.X_start)
    assert statistics["lost"].tolist() == [1.0]
    np.testing.assert_allclose(X_CG, trial.X_start, atol=1e-12)


def test_our_tracker_answers_the_same_question() -> None:
    trial, X_CG = trial_of("wedge", Options(views=3, seed=1))
    answer = our_answer(trial)
    errors = pose_errors(answer.X_CG, X_CG, middle(trial.mesh))
    assert not answer.lost.any()
    assert (np.abs(errors) < [1e-3, 1e-3, 5e-3, 2e-3, 2e-3, 2e-3]).all()
    assert (nees(errors, answer.covariance) < 60.0).all()


def test_a_pose_that_our_statistic_does_not_trust_is_lost() -> None:
    trial, X_CG = trial_of("wedge", Options(views=2, seed=1))
    turned = X_CG @ make_pose(exp_so3([0.0, 0.0, np.pi]), np.zeros(3))
    wrong = TrackerTrial(trial.mesh, trial.rig, trial.images, turned)
    assert our_answer(wrong, trusted=True).lost.all()
