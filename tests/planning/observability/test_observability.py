"""polhode observability through the real command line: its files, degenerate bodies and poses, its errors."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.axes import Axes

from polhode.cli.main import main
from polhode.files.output.marked_folder import MARK
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.exports.ccsds import tum
from polhode.planning.observability.assess import DEFAULT_RIG, Subject, assess, sun_direction
from polhode.planning.observability.files import FILES
from polhode.planning.observability.pictures import (
    coloured_body,
    draw_contributions,
    draw_metric,
    draw_views,
)
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.pipeline.conftest import Example

Capture = pytest.CaptureFixture[str]
BOX = trimesh.creation.box((1.0, 0.6, 0.4))
SPHERE = trimesh.creation.icosphere(2, 0.5)


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
    found, out = assessed(BOX, approach(), tmp_path, "--edges", "5", "--fewest"), tmp_path / "out"
    shown = capsys.readouterr().out
    assert "12 straight edges" in shown and "about z" in shown and shown.rstrip().endswith(str(out))
    assert "edges suffice" in shown and "The best 5 edges" in shown
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
    assert len(trimesh.load_mesh(out / "edges.ply").faces) > 12
    assert isinstance(trimesh.load(out / "edges.glb"), trimesh.Scene)
    smallest, best = found["choice"]["smallest_set"], found["choice"]["best"]
    assert max(smallest["ratio"]) <= 1.1 and smallest["at_least"] <= len(smallest["edges"]) <= 9
    assert len(best["edges"]) == 5 and min(best["ratio"]) >= 1.0 and best["value"] <= best["bound"]
    for name, chosen in ("in_smallest_set", smallest["edges"]), ("in_best", best["edges"]):
        assert [int(row["edge"]) for row in edges if row[name] == "1"] == sorted(chosen)


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
    # an edge every five pixels instead of ten is twice the information
    assert pose("--spacing-px", "5")["sigma"] == pytest.approx(sigma / np.sqrt(2), rel=0.1)
    assert pose("--unit", "mm", size=1000.0)["sigma"] == pytest.approx(sigma, rel=1e-4)
    to_camera = approach(1, 3.0)[0, :3, 3]
    lit, dark = (pose("--sun", *(f"{x:.6f}" for x in sun)) for sun in (to_camera, -to_camera))
    assert lit["sunlit"] and not plain["sunlit"] and dark["points"] < lit["points"] <= plain["points"]


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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "contains no pose"),
        ("0 0 0 4 0 0 0\n", "8 finite numbers"),
        ("nan 0 0 4 0 0 0 1\n", "8 finite numbers"),
        ("0 0 0 4 0 0 0 1_0\n", "8 finite numbers"),
        ("0 " * 5000, "longer than 4096 characters"),
        ("0 0 0 4 0 0 0 x\n", "line 1"),
        ("# t\n0 0 0 4 0 0 0 nan\n", "line 2"),
        ("0 0 0 4 0 0 0 2\n", "length 2"),
        ("\ufeff0 0 0 4 0 0 0 2\n", "length 2"),
        ("0 1e200 0 4 0 0 0 1\n", "above 1e+12"),
        ("0 0 0 4 0 0 1e200 1e200\n", "above 1e+12"),
        ("1 0 0 4 0 0 0 1\n1 0 0 4 0 0 0 1\n", "not later"),
    ],
)
def test_wrong_trajectories(content: str, words: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "poses.txt").write_text(content)
    require_one_line(words, tmp_path, capsys, "--trajectory", str(tmp_path / "poses.txt"))


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
    ("options", "words"),
    [
        (["--sigma-px", "0"], "--sigma-px"),
        (["--spacing-px", "-1"], "--spacing-px"),
        (["--crease-deg", "180"], "--crease-deg"),
        (["--sun", "0", "0", "0"], "--sun"),
        (["--sun", "1e200", "1e200", "0"], "--sun"),
        (["--sigma-px", "1e300"], "--sigma-px"),
        (["--spacing-px", "1e-3"], "--spacing-px"),
        (["--about", "1e300", "0", "0"], "--about"),
        (["--width-px", "9" * 23], "--width-px"),
        (["--edges", "0"], "--edges 0"),
        (["--edges", "9" * 400], "--edges 99999999999999999999: give a number from 1 to"),
        (["--focal-px", "1e308"], "give a number from 1 to 1e+09"),
        (["--focal-px", "nan"], "give a number from 1 to 1e+09"),
        (["--height-px", "1"], "--height-px 1: give a whole number from 16 to 100000"),
        (["--about", "nan", "0", "0"], "--about"),
        (["--focal-px", "0"], "--focal-px"),
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
        ("empty.obj", "", "holds no triangles"),
        ("lines.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "holds no triangles"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has no area"),
        ("words.stl", "hello", "cannot be read as a mesh"),
        ("poses.txt", "0 0 0 4 0 0 0 1", "cannot be read as a mesh"),
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
    ("X_FR", "options", "reason"),
    [
        (approach(2, 0.0, 0.1), [], "the camera is inside the body"),
        (approach(2, -4.0, -3.0), [], "the body is behind the camera"),
        (ASIDE, [], "the body is outside the image"),
        (approach(2, 0.66, 0.64), [], "all edges are hidden or outside the image"),
        (approach(2), ["--sun", *map(str, -approach(1)[0, :3, 3])], "none has contrast in this sunlight"),
    ],
    ids=["inside", "behind", "aside", "too near", "dark"],
)
def test_why_no_edge_is_visible_is_said(
    X_FR: Array, options: list[str], reason: str, tmp_path: Path, capsys: Capture
) -> None:
    found = assessed(BOX, X_FR, tmp_path, *options)
    words = f"no edge is visible ({reason}): the whole pose is unobservable"
    assert [pose["not_told"] for pose in found["poses"]] == [words] * len(X_FR)
    shown = capsys.readouterr().out
    assert f"at every pose: {words}" in shown and "undetermined at every pose" in shown
    assert found["poses"][0]["sigma"] == [None] * 6
    assert "inf" in (tmp_path / "out" / "observability.csv").read_text()


@pytest.mark.usefixtures("no_pictures")
def test_doubts_are_said(tmp_path: Path, capsys: Capture) -> None:
    without_lid = trimesh.Trimesh(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5], process=False)
    trust = "are its unit and the trajectory right?"
    cylinder = trimesh.creation.cylinder(0.4, 0.8, sections=64)
    for mesh, X_FR, words in (
        (BOX, approach(7, 3.0, -3.0), "Note: the camera is inside the body at 1 of 7 poses\n"),
        (BOX, approach(7, 3.0, -3.0), "at 3 of 7 poses: no edge is visible (the body is behind the camera)"),
        (without_lid, approach(1, 0.0), "faces of the open surface that enclose it for the most part"),
        (BOX.copy().apply_scale(1e3), approach(2), f"the camera is inside the body at every pose: {trust}"),
        (BOX.copy().apply_scale(1e-3), approach(2), f"px across in the image: {trust}"),
        (SPHERE, approach(2), "rotation about"),
        (cylinder, approach(2), "is unobservable"),
    ):
        assessed(mesh, X_FR, tmp_path)
        assert words in capsys.readouterr().out


@pytest.mark.usefixtures("no_pictures")
def test_unusual_faces_are_answered(tmp_path: Path, capsys: Capture) -> None:
    right = assessed(BOX, approach(2), tmp_path)
    faces = np.array(BOX.faces)
    faces[::2] = faces[::2, ::-1]
    mixed = assessed(trimesh.Trimesh(BOX.vertices, faces, process=False), approach(2), tmp_path)
    for one, other in zip(right["poses"], mixed["poses"], strict=True):
        assert one["sigma"] == pytest.approx(other["sigma"], rel=1e-6)
    assert "Note: faces of the mesh turned so that neighbours agree" in capsys.readouterr().out
    assert right["notes"] == [] and len(mixed["notes"]) == 1
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert assessed(triangle, approach(1), tmp_path)["model"]["segments"] == 3
    pentagon = tmp_path / "pentagon.obj"
    pentagon.write_text("v 0 0 0\nv 1 0 0\nv 1.3 .8 0\nv .5 1.3 0\nv -.3 .8 0\nf 1 2 3 4 5\n")
    words = ["observability", str(pentagon), "--trajectory", str(tmp_path / "poses.txt"), "-o"]
    assert main([*words, str(tmp_path / "out")]) == 0
    assert "5 straight edges" in capsys.readouterr().out


@pytest.mark.usefixtures("no_pictures")
def test_selections_that_are_impossible_or_too_large_are_said(tmp_path: Path, capsys: Capture) -> None:
    found = assessed(BOX, approach(2, -4.0, -3.0), tmp_path, "--edges", "3", "--fewest")
    assert "No set of edges can be selected: not even all edges determine" in capsys.readouterr().out
    assert found["choice"]["smallest_set"] is None
    for mesh, count, options, words in (
        (BOX, 2, ["--edges", "100"], "The best 9 edges: sigmas up to 1.00 times"),
        (BOX, 2, ["--edges", "100"], "9 edges instead of 100: no other is seen from these poses"),
        (BOX, 2, ["--edges", "1"], "The best edge: it leaves the pose partly undetermined"),
        (SPHERE, 1, ["--fewest"], "1 edge suffices"),
    ):
        assessed(mesh, approach(count), tmp_path, *options)
        assert words in capsys.readouterr().out


def subject_of_mesh(mesh: trimesh.Trimesh, X_FR: Array) -> Subject:
    model, X_RG, time_s = edge_model(mesh), inverse_pose(X_FR), np.arange(float(len(X_FR)))
    return Subject("mesh", model, DEFAULT_RIG, time_s, X_RG, "o", np.zeros(3), None, model.notes)


def test_pictures_of_thousands_of_edges_and_of_nothing_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    sphere = trimesh.creation.icosphere(4, 0.5)
    # as photogrammetry might give it: most edges are sharp
    noise = np.random.default_rng(1).normal(size=sphere.vertices.shape) * 0.012
    rough = subject_of_mesh(trimesh.Trimesh(sphere.vertices + noise, sphere.faces), approach(2))
    assessment = assess(rough, 10.0, 1.0, None, False, Silent())
    assert rough.model.size > 5000
    pictures = draw_metric(assessment), draw_views(assessment), draw_contributions(assessment, 1)
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    body, _ = coloured_body(rough.model, np.nan_to_num(assessment.edges.share).max(axis=1))
    assert len(body.faces) > 24 * len(rough.model.ends_G)
    drawn, panel_text = list[str](), Axes.text

    def text(panel: Axes, x: float, y: float, words: str, **style: Any) -> object:
        drawn.append(words)
        return panel_text(panel, x, y, words, **style)

    monkeypatch.setattr(Axes, "text", text)
    nothing = assess(subject_of_mesh(BOX, approach(1, 0.0)), 10.0, 1.0, None, False, Silent())
    draw_metric(nothing)
    draw_views(nothing)
    unseen = "no visible edge:\nthe camera is inside the body"
    assert drawn == ["not determined at any pose", "not determined at any pose", unseen]


def test_python_names_its_arguments() -> None:
    subject = subject_of_mesh(BOX, approach(1))
    for spacing_px, sigma_px, edges, words in (
        (0.0, 1.0, None, "--spacing-px 0"),
        (10.0, np.nan, None, "--sigma-px nan"),
        (10.0, 1.0, 0, "--edges 0"),
    ):
        with pytest.raises(InputError, match=words):
            assess(subject, spacing_px, sigma_px, edges, False, Silent())
    for sun in ((0.0, 0.0, 0.0), (np.inf, 0.0, 0.0), (1.0, 0.0)):
        with pytest.raises(InputError, match="--sun"):
            sun_direction(sun)
