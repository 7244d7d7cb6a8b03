"""polhode observability at its corners: doubtful meshes, camera poses and selections, thousands of edges."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.axes import Axes
from matplotlib.text import Text

from polhode.cli.main import main
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.observability.assess import Subject, assess, sun_direction
from polhode.planning.observability.pictures import (
    coloured_body,
    draw_contributions,
    draw_metric,
    draw_views,
)
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.planning.observability.test_observability import approach, trajectory

Capture = pytest.CaptureFixture[str]
BOX = trimesh.creation.box((1.0, 0.6, 0.4))
RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)


def assessed(mesh: trimesh.Trimesh, X_FR: Array, folder: Path, *options: str) -> dict[str, Any]:
    """What the command writes for a mesh and poses of the camera."""
    file = folder / "body.ply"
    mesh.export(file)
    poses = trajectory(folder / "poses.txt", X_FR)
    word = ["observability", str(file), "--trajectory", str(poses), "-o", str(folder / "out"), *options]
    assert main(word) == 0
    found: dict[str, Any] = json.loads((folder / "out" / "observability.json").read_text())
    return found


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("draw_metric", "draw_views", "draw_contributions"):
        monkeypatch.setattr(f"polhode.planning.observability.pictures.{name}", lambda *_: b"")


ASIDE = approach(1)
ASIDE[:, :3, 3] += 50.0 * ASIDE[:, :3, 0]


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
    assert f"at every pose: {words}" in capsys.readouterr().out


def test_a_trajectory_through_the_body_counts_its_poses(tmp_path: Path, capsys: Capture) -> None:
    found = assessed(BOX, approach(7, 3.0, -3.0), tmp_path)
    note = "the camera is inside the body at 1 of 7 poses"
    assert note in found["notes"]
    shown = capsys.readouterr().out
    assert f"Note: {note}\n" in shown
    assert "at 3 of 7 poses: no edge is visible (the body is behind the camera)" in shown


def test_inside_an_open_surface_is_doubtful(tmp_path: Path, capsys: Capture) -> None:
    without_lid = trimesh.Trimesh(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5], process=False)
    assessed(without_lid, approach(1, 0.0), tmp_path)
    assert "behind faces of the open surface that enclose it for the most part" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (1e3, "the camera is inside the body at every pose: are its unit and the trajectory right?"),
        (1e-3, "px across in the image: are its unit and the trajectory right?"),
    ],
    ids=["too large", "too small"],
)
def test_a_wrong_unit_is_suspected(size: float, words: str, tmp_path: Path, capsys: Capture) -> None:
    mesh = BOX.copy()
    mesh.apply_scale(size)
    found = assessed(mesh, approach(2), tmp_path)
    assert words in capsys.readouterr().out
    assert found["along"]["poses_that_tell_all"] == 0


def test_mixed_winding_gives_the_numbers_of_the_right_mesh(tmp_path: Path, capsys: Capture) -> None:
    right = assessed(BOX, approach(2), tmp_path)
    faces = np.array(BOX.faces)
    faces[::2] = faces[::2, ::-1]
    mixed = assessed(trimesh.Trimesh(BOX.vertices, faces, process=False), approach(2), tmp_path)
    for one, other in zip(right["poses"], mixed["poses"], strict=True):
        assert one["sigma"] == pytest.approx(other["sigma"], rel=1e-6)
    assert "Note: faces of the mesh turned so that neighbours agree" in capsys.readouterr().out
    assert right["notes"] == [] and len(mixed["notes"]) == 1


def test_a_single_triangle_and_faces_of_many_corners_are_answered(tmp_path: Path, capsys: Capture) -> None:
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert assessed(triangle, approach(1), tmp_path)["model"]["segments"] == 3
    pentagon = tmp_path / "pentagon.obj"
    pentagon.write_text("v 0 0 0\nv 1 0 0\nv 1.3 .8 0\nv .5 1.3 0\nv -.3 .8 0\nf 1 2 3 4 5\n")
    word = ["observability", str(pentagon), "--trajectory", str(tmp_path / "poses.txt"), "-o"]
    assert main([*word, str(tmp_path / "out")]) == 0
    assert "5 straight edges" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.stl", "", "cannot be read as a mesh"),
        ("empty.obj", "", "holds no triangles"),
        ("lines.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "holds no triangles"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has no area"),
        ("words.stl", "hello", "cannot be read as a mesh"),
        ("missing.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "cannot be read as a mesh"),
    ],
)
def test_what_is_no_mesh_is_one_line(
    name: str, content: str, words: str, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / name).write_text(content)
    poses = trajectory(tmp_path / "poses.txt", approach(1))
    word = ["observability", str(tmp_path / name), "--trajectory", str(poses), "-o", str(tmp_path / "out")]
    assert main(word) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_selections_that_are_impossible_or_too_large_are_said(tmp_path: Path, capsys: Capture) -> None:
    found = assessed(BOX, approach(2, -4.0, -3.0), tmp_path, "--edges", "3", "--fewest")
    assert "No set of edges can be selected: not even all edges determine" in capsys.readouterr().out
    assert found["choice"]["smallest_set"] is None
    found = assessed(BOX, approach(2), tmp_path, "--edges", "100")
    shown = capsys.readouterr().out
    assert "The best 9 edges: sigmas up to 1.00 times" in shown
    assert "9 edges instead of 100: no other is seen from these poses" in shown
    assessed(BOX, approach(2), tmp_path, "--edges", "1")
    assert "The best edge: it leaves the pose partly undetermined" in capsys.readouterr().out
    assessed(trimesh.creation.icosphere(2, 0.5), approach(1), tmp_path, "--fewest")
    assert "1 edge suffices" in capsys.readouterr().out


def rough(subdivisions: int) -> trimesh.Trimesh:
    """A sphere as photogrammetry might give it: most edges are sharp."""
    sphere = trimesh.creation.icosphere(subdivisions, 0.5)
    noise = np.random.default_rng(1).normal(size=sphere.vertices.shape) * 0.012
    return trimesh.Trimesh(sphere.vertices + noise, sphere.faces, process=False)


def subject_of_mesh(mesh: trimesh.Trimesh, X_FR: Array) -> Subject:
    model, X_RG = edge_model(mesh), inverse_pose(X_FR)
    return Subject("mesh", model, RIG, np.arange(float(len(X_RG))), X_RG, "o", np.zeros(3), None, model.notes)


def test_pictures_of_thousands_of_edges_are_drawn() -> None:
    assessment = assess(subject_of_mesh(rough(4), approach(6)), 10.0, 1.0, None, False, Silent())
    assert assessment.subject.model.size > 5000
    shares = np.nan_to_num(assessment.edges.share).max(axis=1)
    pictures = draw_metric(assessment), draw_views(assessment), draw_contributions(assessment, 5)
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    body, _ = coloured_body(assessment.subject.model, shares)
    assert len(body.faces) > 24 * len(assessment.subject.model.ends_G)


def test_pictures_of_nothing_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    panel_text = Axes.text

    def text(panel: Axes, x: float, y: float, words: str, **style: Any) -> Text:
        drawn.append(words)
        return panel_text(panel, x, y, words, **style)

    monkeypatch.setattr(Axes, "text", text)
    nothing = assess(subject_of_mesh(BOX, approach(1, 0.0)), 10.0, 1.0, None, False, Silent())
    draw_metric(nothing)
    draw_views(nothing)
    assert drawn == [
        "not determined at any pose",
        "not determined at any pose",
        "no visible edge:\nthe camera is inside the body",
    ]


def test_python_names_its_arguments() -> None:
    subject = subject_of_mesh(BOX, approach(1))
    for numbers, words in (((0.0, 1.0), "--spacing-px 0"), ((10.0, np.nan), "--sigma-px nan")):
        with pytest.raises(InputError, match=words):
            assess(subject, *numbers, None, False, Silent())
    with pytest.raises(InputError, match="--edges 0"):
        assess(subject, 10.0, 1.0, 0, False, Silent())
    for sun in ((0.0, 0.0, 0.0), (np.inf, 0.0, 0.0), (1.0, 0.0)):
        with pytest.raises(InputError, match="--sun"):
            sun_direction(sun)
