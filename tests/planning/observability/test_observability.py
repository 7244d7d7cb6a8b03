"""polhode observability through the real command line: its files, degenerate bodies and poses, its errors."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.cli.main import main
from polhode.files.output.marked_folder import MARK
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.exports.ccsds import tum
from polhode.planning.observability.assess import DEFAULT_RIG, Subject, assess
from polhode.planning.observability.files import FILES
from polhode.planning.observability.pictures import draw_contributions, draw_metric
from polhode.runtime.progress import Silent
from tests.pipeline.conftest import Example

Capture = pytest.CaptureFixture[str]
BOX = trimesh.creation.box((1.0, 0.6, 0.4))
SPHERE = trimesh.creation.icosphere(2, 0.5)
BOX_INSIDE_OUT = trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False)


def trajectory(path: Path, X_FR: Array) -> str:
    path.write_text(tum(10**9 * np.arange(len(X_FR)), X_FR, []))
    return str(path)


def approach(count: int = 5, far: float = 4.0, near: float = 2.0) -> Array:
    """Camera places in G on the way to a body at its origin, the body seen askew."""
    z = np.linspace(far, near, count)
    return inverse_pose(make_pose(np.tile(exp_so3([0.5, 0.4, 0.1]), (count, 1, 1)), np.outer(z, [0, 0, 1.0])))


def assessed(mesh: trimesh.Trimesh, X_FR: Array, folder: Path, *options: str) -> dict[str, Any]:
    """What the command writes for a mesh and poses of the camera."""
    mesh.export(folder / "body.ply")
    poses, out = trajectory(folder / "poses.txt", X_FR), folder / "out"
    words = ["observability", str(folder / "body.ply"), "--trajectory", poses, "-o", str(out), *options]
    assert main(words) == 0
    found: dict[str, Any] = json.loads((out / "observability.json").read_text())
    return found


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open() as stream:
        return list(csv.DictReader(stream))


def test_a_mesh_along_an_approach_with_its_best_edges(tmp_path: Path, capsys: Capture) -> None:
    found, out = assessed(BOX, approach(), tmp_path, "--edges", "5"), tmp_path / "out"
    shown = capsys.readouterr().out
    assert "12 straight edges" in shown and "about z" in shown and shown.rstrip().endswith(str(out))
    assert "The best 5 edges" in shown
    assert {path.name for path in out.iterdir()} == {*FILES, MARK}
    assert found["along"]["poses_that_tell_all"] == 5
    assert [pose["range_m"] for pose in found["poses"]] == pytest.approx([4.0, 3.5, 3.0, 2.5, 2.0])
    for pose in found["poses"]:
        C, covariance = np.array(pose["C"]), np.array(pose["covariance"])
        assert np.allclose(C @ covariance, np.eye(6), atol=1e-8)
        assert np.allclose(np.sqrt(np.diagonal(covariance)), pose["sigma"])
    depth = [pose["sigma"][2] for pose in found["poses"]]
    assert (np.diff(depth) < 0.0).all()
    views, edges = rows_of(out / "observability.csv"), rows_of(out / "edges.csv")
    assert [float(row["sigma_z_m"]) for row in views] == pytest.approx(depth, rel=1e-5)
    assert len(edges) == 12
    assert sum(float(edge["share_about_x"]) for edge in edges) == pytest.approx(1.0, abs=1e-4)
    best = found["best"]
    assert len(best["edges"]) == 5 and min(best["ratio"]) >= 1.0
    assert [int(row["edge"]) for row in edges if row["in_best"] == "1"] == sorted(best["edges"])


@pytest.mark.usefixtures("no_pictures")
def test_noise_point_unit_and_sunlight_change_what_they_should(tmp_path: Path) -> None:
    def pose(*options: str, size: float = 1.0) -> dict[str, Any]:
        found = assessed(BOX.copy().apply_scale(size), approach(1, 3.0), tmp_path, *options)
        return {**found["poses"][0], "sunlit": found["sunlit"]}

    plain = pose()
    sigma = np.array(plain["sigma"])
    assert pose("--sigma-px", "0.3")["sigma"] == pytest.approx(0.3 * sigma)
    # about another point turns are as well known, shifts are not
    aside = np.array(pose("--about", "1", "0", "0")["sigma"])
    assert aside[3:] == pytest.approx(sigma[3:]) and (aside[:3] > sigma[:3]).any()
    assert pose("--unit", "mm", size=1000.0)["sigma"] == pytest.approx(sigma, rel=1e-4)
    to_camera = approach(1, 3.0)[0, :3, 3]
    lit, dark = (pose("--sun", *(f"{x:.6f}" for x in sun)) for sun in (to_camera, -to_camera))
    assert lit["sunlit"] and not plain["sunlit"] and lit["sigma"] == dark["sigma"] == plain["sigma"]
    assert np.isfinite(lit["expected_sigma"]).all() and lit["expected_sigma"] != dark["expected_sigma"]


@pytest.mark.usefixtures("no_pictures")
def test_a_run_by_its_own_places_and_by_planned_ones(
    run: Path, bare: Path, example: Example, tmp_path: Path, capsys: Capture
) -> None:
    words = ["observability", str(run), "-o", str(tmp_path / "out")]
    assert main([*words, "--crease-deg", "5"]) == 2
    assert "--crease-deg is for a mesh" in capsys.readouterr().err
    assert main(words) == 0
    found = json.loads((tmp_path / "out" / "observability.json").read_text())
    assert len(found["poses"]) == len(example.tracks.timestamps_ns)
    assert found["about"]["o_G"] == pytest.approx(example.estimate.mass.com_G.tolist())
    assert found["camera"]["focal_px"] == example.tracks.rig.focal_px
    # at the last pair the prediction is the estimate: the camera of that pair, in N
    last = trajectory(tmp_path / "last.txt", example.tracks.X_NR[-1:])
    assert main([*words, "--trajectory", last, "--frame", "N"]) == 0
    forecast = json.loads((tmp_path / "out" / "observability.json").read_text())["poses"]
    assert forecast[0]["sigma"] == pytest.approx(found["poses"][-1]["sigma"], rel=1e-6)
    assert "measured" in capsys.readouterr().out
    assert main(["observability", str(bare), "-o", str(tmp_path / "out")]) == 2
    assert "has no mesh" in capsys.readouterr().err


def require_one_line(
    words: str, folder: Path, capsys: Capture, *options: str, source: Path | None = None
) -> None:
    """An error without output."""
    if source is None:
        source = folder / "box.stl"
        BOX.export(source)
    assert main(["observability", str(source), "-o", str(folder / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1 and not (folder / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "contains no pose"),
        ("nan 0 0 4 0 0 0 1\n", "8 finite numbers"),
        ("0 0 0 4 0 0 0 x\n", "line 1"),
        ("\ufeff0 0 0 4 0 0 0 2\n", "length 2"),
        ("0 1e200 0 4 0 0 0 1\n", "above 1e+12"),
        ("0 0 0 4 0 0 1e200 1e200\n", "above 1e+12"),
        ("1 0 0 4 0 0 0 1\n1 0 0 4 0 0 0 1\n", "not later"),
    ],
)
def test_wrong_trajectories(content: str, words: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "poses.txt").write_text(content)
    require_one_line(words, tmp_path, capsys, "--trajectory", str(tmp_path / "poses.txt"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--sigma-px", "0"], "--sigma-px"),
        (["--sigma-px", "1e300"], "--sigma-px"),
        (["--crease-deg", "180"], "--crease-deg"),
        (["--sun", "0", "0", "0"], "--sun"),
        (["--sun", "1e200", "1e200", "0"], "--sun"),
        (["--about", "1e300", "0", "0"], "--about"),
        (["--width-px", "9" * 23], "--width-px"),
        (["--edges", "0"], "--edges 0"),
        (["--edges", "9" * 400], "--edges 99999999999999999999: give a number from 1 to"),
        (["--focal-px", "nan"], "give a number from 1 to 1e+09"),
        (["--height-px", "1"], "--height-px 1: give a whole number from 16 to 100000"),
        (["--frame", "N"], "--frame inertial is for a run"),
    ],
)
def test_wrong_options(options: list[str], words: str, tmp_path: Path, capsys: Capture) -> None:
    poses = trajectory(tmp_path / "poses.txt", approach(1))
    require_one_line(words, tmp_path, capsys, "--trajectory", poses, *options)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.stl", "", "cannot be read as a mesh"),
        ("lines.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "holds no triangles"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has no area"),
        ("missing.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "cannot be read as a mesh"),
        ("none.stl", None, "no such run or mesh"),
        (".", None, "summary.json"),
    ],
)
def test_what_is_no_mesh_is_one_line(
    name: str, content: str | None, words: str, tmp_path: Path, capsys: Capture
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    poses = trajectory(tmp_path / "way.txt", approach(1))
    require_one_line(words, tmp_path, capsys, "--trajectory", poses, source=tmp_path / name)


def test_a_mesh_needs_a_trajectory_and_a_folder(tmp_path: Path, capsys: Capture) -> None:
    require_one_line("--trajectory", tmp_path, capsys)
    file = str(tmp_path / "box.stl")
    poses = trajectory(tmp_path / "poses.txt", approach(1))
    assert main(["observability", file, "--trajectory", poses, "-o", file]) == 2
    assert "this is a file" in capsys.readouterr().err


ASIDE = approach(1)
ASIDE[:, :3, 3] += 50.0 * ASIDE[:, :3, 0]


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize(
    ("X_FR", "reason"),
    [
        (approach(2, 0.0, 0.1), "the camera is inside the body"),
        (approach(2, -4.0, -3.0), "the body is behind the camera"),
        (ASIDE, "the body is outside the image"),
        (approach(2, 0.66, 0.64), "all edges are hidden or outside the image"),
    ],
    ids=["inside", "behind", "aside", "too near"],
)
def test_why_no_edge_is_visible_is_said(X_FR: Array, reason: str, tmp_path: Path, capsys: Capture) -> None:
    found = assessed(BOX, X_FR, tmp_path, "--edges", "3")
    words = f"no edge is visible ({reason}): the whole pose is unobservable"
    assert [pose["not_told"] for pose in found["poses"]] == [words] * len(X_FR)
    shown = capsys.readouterr().out
    assert f"at every pose: {words}" in shown and "undetermined at every pose" in shown
    assert "No set of edges can be selected: not even all edges determine" in shown
    assert found["poses"][0]["sigma"] == [None] * 6 and found["best"]["edges"] == []
    assert "inf" in (tmp_path / "out" / "observability.csv").read_text()


@pytest.mark.usefixtures("no_pictures")
def test_doubts_are_said(tmp_path: Path, capsys: Capture) -> None:
    trust = "are its unit and the trajectory right?"
    for mesh, X_FR, options, words in (
        (BOX, approach(7, 3.0, -3.0), [], "Note: the camera is inside the body at 1 of 7 poses\n"),
        (BOX, approach(7, 3.0, -3.0), [], "3 of 7 poses: no edge is visible (the body is behind the camera)"),
        (BOX.copy().apply_scale(1e3), approach(2), [], f"is inside the body at every pose: {trust}"),
        (BOX.copy().apply_scale(1e-3), approach(2), [], f"px across in the image: {trust}"),
        (SPHERE, approach(2), [], "rotation about"),
        (BOX_INSIDE_OUT, approach(2), [], "Note: faces of the mesh turned so that neighbours agree"),
        (BOX, approach(2), ["--edges", "100"], "The best 9 edges: sigmas up to 1.00 times"),
        (BOX, approach(2), ["--edges", "100"], "no other is seen, so these are fewer than 100"),
        (BOX, approach(2), ["--edges", "1"], "The best edge: it leaves the pose partly undetermined"),
    ):
        assessed(mesh, X_FR, tmp_path, *options)
        assert words in capsys.readouterr().out


def subject_of_mesh(mesh: trimesh.Trimesh, X_FR: Array) -> Subject:
    model, X_RG, time_s = edge_model(mesh), inverse_pose(X_FR), np.arange(float(len(X_FR)))
    return Subject("mesh", model, DEFAULT_RIG, time_s, X_RG, "o", np.zeros(3), None, model.notes)


def test_pictures_of_many_faces_and_of_nothing_are_drawn() -> None:
    sphere = subject_of_mesh(trimesh.creation.icosphere(4, 0.5), approach(2))
    assessment = assess(sphere, 1.0, None, Silent())
    nothing = assess(subject_of_mesh(BOX, approach(1, 0.0)), 1.0, None, Silent())
    for picture in draw_metric(assessment), draw_contributions(assessment, 1), draw_metric(nothing):
        assert picture.startswith(b"\x89PNG")
