"""Faces that disagree or point inward are turned; whether a point is inside a body."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from polhode.geometry.lie import Bools, exp_so3, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.orientation import mesh_edges, winding_number
from polhode.planning.edges.visible_edges import control_points
from tests.planning.edges.views import RIG

BOX = trimesh.creation.box((1.0, 0.6, 0.4))
OPEN_BOX = trimesh.Trimesh(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5], process=False)
SOLIDS = {
    "box": BOX,
    "box without a lid": OPEN_BOX,
    "sphere": trimesh.creation.icosphere(3, 0.5),
    "cylinder": trimesh.creation.cylinder(0.4, 0.8, sections=48),
}


def turned(mesh: trimesh.Trimesh, which: Bools) -> trimesh.Trimesh:
    faces = np.array(mesh.faces)
    faces[which] = faces[which][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    whole = trimesh.util.concatenate(meshes)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def seen_px(model: EdgeModel) -> float:
    return float(control_points(model, RIG, make_pose(exp_so3((0.5, 0.4, 0.1)), [0, 0, 4.0])).weight.sum())


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("share", [0.5, 1.0], ids=["half of the faces", "all faces"])
def test_turned_faces_are_turned_back_and_said(name: str, share: float) -> None:
    mesh = SOLIDS[name]
    right = edge_model(mesh)
    assert right.notes == ()
    which = np.random.default_rng(3).random(len(mesh.faces)) < share
    found = edge_model(turned(mesh, which))
    assert_allclose(found.surface.face_normals, right.surface.face_normals, atol=1e-12)
    assert found.size == right.size and seen_px(found) == pytest.approx(seen_px(right), rel=1e-9)
    assert found.notes == (
        "faces of the mesh turned so that neighbours agree and normals point outward: "
        f"{which.sum()} of {len(mesh.faces)}",
    )


def test_each_part_of_a_body_is_turned_by_itself() -> None:
    aside = trimesh.creation.box((0.3, 0.3, 0.3))
    aside.apply_translation([0.9, 0.0, 0.0])
    both = joined(BOX, turned(aside, np.ones(12, dtype=bool)))
    found = edge_model(both)
    assert found.surface.volume == pytest.approx(BOX.volume + aside.volume)


def test_a_bowl_modelled_by_its_inside_stays_as_it_is() -> None:
    sphere = trimesh.creation.icosphere(3, 0.5)
    cap = trimesh.Trimesh(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] < -0.25])
    bowl = turned(cap, np.ones(len(cap.faces), dtype=bool))
    assert edge_model(bowl).notes == ()


def test_a_one_sided_surface_is_said_to_be_one() -> None:
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    along = np.stack([np.cos(around), np.sin(around), np.zeros(24)], axis=1)
    across = np.stack([np.cos(0.5 * around)] * 3, axis=1) * along
    across[:, 2] = np.sin(0.5 * around)
    vertices = np.vstack([along + 0.2 * across, along - 0.2 * across])
    up, down = np.arange(24), 24 + np.arange(24)
    next_up, next_down = np.append(up[1:], 24), np.append(down[1:], 0)
    faces = np.vstack([np.stack([up, down, next_up], 1), np.stack([next_up, down, next_down], 1)])
    model = edge_model(trimesh.Trimesh(vertices, faces, process=False))
    assert "48 of the mesh's 48 faces form a one-sided surface" in model.notes[0]


def test_separate_faces_and_noise_are_said() -> None:
    sphere = trimesh.creation.icosphere(4, 0.5)
    rng = np.random.default_rng(0)
    rough = trimesh.Trimesh(
        sphere.vertices + rng.normal(size=sphere.vertices.shape) * 0.012, sphere.faces, process=False
    )
    assert "as on a rough or noisy surface" in edge_model(rough).notes[0]
    corners = np.asarray(sphere.triangles).reshape(-1, 3)
    apart = corners + rng.normal(size=corners.shape) * 1e-5
    soup = trimesh.Trimesh(apart, np.arange(len(apart)).reshape(-1, 3), process=False)
    assert "neighbouring faces do not share their vertices" in edge_model(soup).notes[0]


def test_edges_have_the_faces_that_they_have() -> None:
    fin = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]],
        [[0, 1, 2], [1, 0, 3], [0, 1, 4]],
        process=False,
    )
    found = mesh_edges(fin)
    assert_array_equal(found.vertices, [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [1, 3], [1, 4]])
    assert_array_equal(found.count, [3, 1, 1, 1, 1, 1, 1])
    assert found.agree[0]


def test_inside_is_within_closed_parts_alone() -> None:
    outside = np.array([0.0, 0.0, 0.21])
    assert winding_number(np.asarray(BOX.triangles), np.zeros(3)) == pytest.approx(1.0)
    assert winding_number(np.asarray(BOX.triangles), outside) == pytest.approx(0.0, abs=1e-12)
    box = edge_model(BOX)
    assert box.encloses(np.array([0.49, 0.29, -0.19])) and not box.encloses(outside)
    assert not edge_model(OPEN_BOX).encloses(np.zeros(3))
    # An open fin on the box changes nothing, and two parts may overlap.
    fin = trimesh.Trimesh([[0, 0, 0.3], [1, 0, 0.3], [0, 1, 0.3]], [[0, 1, 2]])
    shifted = BOX.copy()
    shifted.apply_translation([0.5, 0.0, 0.0])
    whole = edge_model(joined(BOX, shifted, fin))
    assert whole.encloses(np.zeros(3)) and whole.encloses(np.array([0.25, 0.0, 0.0]))
    assert not whole.encloses(np.array([0.25, 0.25, 0.299]))
