"""Edges of meshes whose edges are known: what a camera sees of them, and their orientation."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from polhode.geometry.lie import Array, Bools, exp_so3, make_pose
from polhode.planning.edges.edge_model import EdgeKind, EdgeModel, chains_of, edge_model, straight_pieces
from polhode.planning.edges.measured_edges import measured_edge_model, simplified
from polhode.planning.edges.orientation import mesh_edges, winding_number
from polhode.planning.edges.visible_edges import control_points, outlines
from polhode.runtime.errors import InputError
from tests.planning.edges.scenes import RIG

BOX = trimesh.creation.box((1.0, 0.6, 0.4))
CUBE = trimesh.creation.box((1.0, 1.0, 1.0))
SPHERE = trimesh.creation.icosphere(3, 0.5)
OPEN_BOX = trimesh.Trimesh(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5], process=False)
ASKEW = make_pose(exp_so3((0.4, 0.5, 0.2)), [0.05, 0.02, 3.0])


def finely(mesh: trimesh.Trimesh, edge_m: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge_m))


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    whole = trimesh.util.concatenate(meshes)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def shifted(mesh: trimesh.Trimesh, p: list[float]) -> trimesh.Trimesh:
    copy = mesh.copy()
    copy.apply_translation(p)
    return copy


def seen_px(model: EdgeModel) -> float:
    return float(control_points(model, RIG, make_pose(exp_so3((0.5, 0.4, 0.1)), [0, 0, 4.0])).weight.sum())


def test_a_box_has_twelve_edges_however_it_is_cut_into_faces_and_without_a_lid_a_rim() -> None:
    for edge_m in (2.0, 0.1):
        model = edge_model(finely(BOX, edge_m))
        assert_allclose(np.sort(model.lengths_m), np.repeat([0.4, 0.6, 1.0], 4), atol=1e-12)
        assert not model.outlined.any()
        # the two normals of an edge are across it and across each other
        along = model.ends_G[:, 1] - model.ends_G[:, 0]
        assert_allclose(np.einsum("nk,nsk->ns", along, model.sides_G), 0.0, atol=1e-12)
        assert_allclose(np.einsum("nk,nk->n", model.sides_G[:, 0], model.sides_G[:, 1]), 0.0, atol=1e-12)
    model = edge_model(OPEN_BOX)
    rim = model.kind == EdgeKind.BOUNDARY
    assert (rim.sum(), (~rim).sum()) == (4, 8)
    assert_allclose(model.ends_G[rim][..., 2], 0.2)


def test_smooth_parts_have_rims_and_outlines() -> None:
    model = edge_model(trimesh.creation.cylinder(0.4, 0.8, sections=128))
    assert model.outlined.sum() == 1
    assert_allclose(np.linalg.norm(model.ends_G[..., :2], axis=-1), 0.4, atol=1e-6)
    assert_allclose(np.abs(model.ends_G[..., 2]), 0.4, atol=1e-9)
    # arcs know their direction: across the radius at both ends
    radial = np.einsum("nsk,nsk->ns", model.ends_G[..., :2], model.tangents_G[..., :2])
    assert_allclose(radial, 0.0, atol=1e-4)
    eye = np.array([0.3, -0.4, 3.0])
    found = outlines(edge_model(trimesh.creation.icosphere(4, 0.5)), eye)
    places, normals = found.ends_G.reshape(-1, 3), found.normals_G.reshape(-1, 3)
    assert_allclose(np.linalg.norm(places, axis=1), 0.5, atol=2e-3)
    assert_allclose(np.einsum("nk,nk->n", normals, places - eye), 0.0, atol=1e-9)
    # tangents from the eye touch a sphere at the height r^2 / d above its middle
    distance = np.linalg.norm(eye)
    assert_allclose(places @ eye / distance, 0.25 / distance, atol=2e-3)


def test_hidden_edges_those_that_fall_together_and_those_outside_of_the_image_are_removed() -> None:
    model = edge_model(CUBE)
    front = control_points(model, RIG, make_pose(np.eye(3), [0.0, 0.0, 3.0]))
    # face on: four of the twelve edges, at the near side
    assert len(np.unique(front.feature)) == 4
    assert_allclose(front.p_G[:, 2], -0.5)
    assert len(np.unique(control_points(model, RIG, ASKEW).feature)) == 9
    # another body hides what is behind it
    far = shifted(trimesh.creation.box((0.2, 0.2, 0.1)), [0.0, 0.0, 1.0])
    both = edge_model(joined(trimesh.creation.box((0.5, 0.5, 0.1)), far))
    assert control_points(both, RIG, make_pose(np.eye(3), [0, 0, 3.0])).p_G[:, 2].max() < 0.1
    aside = make_pose(exp_so3((0.0, 0.5, 0.0)), [-0.4, 0.0, 3.0])
    assert control_points(both, RIG, aside).p_G[:, 2].max() > 0.9
    X_RG = make_pose(exp_so3((0.6, 0.5, 0.0)), [0.0, 0.0, 3.0])
    for thickness, count in ((0.002, 4), (0.2, 9)):
        plate = edge_model(trimesh.creation.box((1.0, 1.0, thickness)))
        assert len(np.unique(control_points(plate, RIG, X_RG).feature)) == count
    for p in ((0.0, 0.0, -3.0), (9.0, 0.0, 3.0)):
        for mesh in (CUBE, SPHERE):
            assert len(control_points(edge_model(mesh), RIG, make_pose(exp_so3((0.1, 0.2, 0.3)), p))) == 0
    passing = edge_model(trimesh.creation.box((0.1, 0.1, 10.0)))
    points = control_points(passing, RIG, make_pose(np.eye(3), [0.4, 0.3, 0.0]))
    assert len(points) > 10 and np.isfinite(points.uv_px).all()
    assert (points.uv_px > -0.5).all() and (points.uv_px < [639.5, 479.5]).all()


def test_control_points_lie_on_edges_and_stand_for_their_length() -> None:
    model = edge_model(BOX)
    points = control_points(model, RIG, ASKEW, 10.0)
    a, b = (model.ends_G[points.feature, side] for side in (0, 1))
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    assert_allclose(np.linalg.norm(np.cross(points.p_G - a, along), axis=1), 0.0, atol=1e-12)
    p_R = points.p_G @ ASKEW[:3, :3].T + ASKEW[:3, 3]
    assert_allclose(points.uv_px, RIG.project(p_R)[:, :2])
    assert_allclose(np.linalg.norm(points.normal_px, axis=1), 1.0)
    # the sum of the weights does not depend on the steps
    coarse = control_points(model, RIG, ASKEW, 25.0)
    assert coarse.weight.sum() * 25.0 == pytest.approx(points.weight.sum() * 10.0, rel=0.03)


def test_a_measured_box_gets_its_edges_back_and_what_cannot_be_simpler_stays() -> None:
    fine = finely(BOX, 0.03)
    noise = np.random.default_rng(3).normal(0.0, 3e-4, fine.vertices.shape)
    shaken = trimesh.Trimesh(fine.vertices + noise, fine.faces)
    model = measured_edge_model(shaken, np.full(len(shaken.vertices), 3e-4))
    assert len(model.surface.faces) < 0.1 * len(shaken.faces)
    # what is found lies on true edges, and they are all found
    found, expected = control_points(model, RIG, ASKEW), control_points(edge_model(BOX), RIG, ASKEW)
    gap = np.linalg.norm(found.uv_px[:, None] - expected.uv_px, axis=2)
    assert np.mean(gap.min(axis=1) < 6.0) > 0.95 and np.mean(gap.min(axis=0) < 8.0) > 0.95
    assert simplified(CUBE, 1e-3) is CUBE
    assert len(simplified(SPHERE, 1e-6).faces) == len(SPHERE.faces)
    assert len(simplified(SPHERE, 2e-2).faces) < 0.5 * len(SPHERE.faces)


def test_edges_of_faces_chains_and_straight_pieces() -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    found = mesh_edges(trimesh.Trimesh(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]], process=False))
    assert_array_equal(found.vertices, [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [1, 3], [1, 4]])
    assert_array_equal(found.count, [3, 1, 1, 1, 1, 1, 1])
    assert found.agree[0]
    cross = np.array([[0, 1], [1, 2], [1, 3], [3, 4], [5, 6], [6, 7], [7, 5]])
    assert sorted(len(chain) for chain, _ in chains_of(cross)) == [2, 2, 3, 4]
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0]])
    assert straight_pieces(corner, 1e-6) == [(0, 2), (2, 4)]


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3), dtype=int), "no faces"),
        (np.diag([1.0, 1.0, np.nan]), [[0, 1, 2]], "non-finite"),
        (np.zeros((3, 3)), [[0, 1, 2]], "degenerate"),
    ],
)
def test_what_is_no_surface_is_refused(vertices: Array, faces: Array, words: str) -> None:
    with pytest.raises(InputError, match=words):
        edge_model(trimesh.Trimesh(vertices, faces, process=False))


def turned(mesh: trimesh.Trimesh, which: Bools) -> trimesh.Trimesh:
    faces = np.where(which[:, None], mesh.faces[:, ::-1], mesh.faces)
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


@pytest.mark.parametrize("mesh", [OPEN_BOX, trimesh.creation.cylinder(0.4, 0.8, sections=48)])
def test_faces_that_point_inward_are_turned_and_said_and_faces_twice_count_once(
    mesh: trimesh.Trimesh,
) -> None:
    right = edge_model(mesh)
    assert right.notes == () and seen_px(right) > 10.0
    for share in (0.5, 1.0):
        which = np.random.default_rng(3).random(len(mesh.faces)) < share
        found = edge_model(turned(mesh, which))
        assert_allclose(found.surface.face_normals, right.surface.face_normals, atol=1e-12)
        assert found.size == right.size and seen_px(found) == pytest.approx(seen_px(right), rel=1e-9)
        assert found.notes == (
            "faces of the mesh turned so that neighbours agree and normals point outward: "
            f"{which.sum()} of {len(mesh.faces)}",
        )
    for faces in np.vstack([mesh.faces, mesh.faces]), np.vstack([mesh.faces[:, ::-1], mesh.faces]):
        again = edge_model(trimesh.Trimesh(mesh.vertices, faces, process=False))
        assert seen_px(again) == pytest.approx(seen_px(right), rel=1e-9)


def test_parts_are_turned_by_themselves_and_a_bowl_stays_as_it_is() -> None:
    aside = shifted(trimesh.creation.box((0.3, 0.3, 0.3)), [0.9, 0.0, 0.0])
    found = edge_model(joined(BOX, turned(aside, np.ones(12, dtype=bool))))
    assert found.surface.volume == pytest.approx(BOX.volume + aside.volume)
    cap = trimesh.Trimesh(SPHERE.vertices, SPHERE.faces[SPHERE.triangles_center[:, 2] < -0.25])
    assert edge_model(turned(cap, np.ones(len(cap.faces), dtype=bool))).notes == ()


def test_doubtful_meshes_are_said() -> None:
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    along = np.stack([np.cos(around), np.sin(around), np.zeros(24)], axis=1)
    across = np.stack([np.cos(0.5 * around)] * 3, axis=1) * along
    across[:, 2] = np.sin(0.5 * around)
    up, down = np.arange(24), 24 + np.arange(24)
    next_up, next_down = np.append(up[1:], 24), np.append(down[1:], 0)
    faces = np.vstack([np.stack([up, down, next_up], 1), np.stack([next_up, down, next_down], 1)])
    moebius = np.vstack([along + 0.2 * across, along - 0.2 * across])
    sphere, rng = trimesh.creation.icosphere(4, 0.5), np.random.default_rng(0)
    bumpy = sphere.vertices + rng.normal(size=sphere.vertices.shape) * 0.012
    apart = np.asarray(sphere.triangles).reshape(-1, 3)
    apart = apart + rng.normal(size=apart.shape) * 1e-5
    for vertices, which, words in (
        (moebius, faces, "48 of the mesh's 48 faces form a one-sided surface"),
        (bumpy, sphere.faces, "as on a rough or noisy surface"),
        (apart, np.arange(len(apart)).reshape(-1, 3), "neighbouring faces do not share their vertices"),
    ):
        assert words in edge_model(trimesh.Trimesh(vertices, which, process=False)).notes[0]


def test_inside_is_within_closed_parts_alone() -> None:
    outside = np.array([0.0, 0.0, 0.21])
    assert winding_number(np.asarray(BOX.triangles), np.zeros(3)) == pytest.approx(1.0)
    assert winding_number(np.asarray(BOX.triangles), outside) == pytest.approx(0.0, abs=1e-12)
    box = edge_model(BOX)
    assert box.encloses(np.array([0.49, 0.29, -0.19])) and not box.encloses(outside)
    assert not edge_model(OPEN_BOX).encloses(np.zeros(3))
    # an open fin on the box changes nothing, and two parts may overlap
    fin = trimesh.Trimesh([[0, 0, 0.3], [1, 0, 0.3], [0, 1, 0.3]], [[0, 1, 2]])
    whole = edge_model(joined(BOX, shifted(BOX, [0.5, 0.0, 0.0]), fin))
    assert whole.encloses(np.zeros(3)) and whole.encloses(np.array([0.25, 0.0, 0.0]))
    assert not whole.encloses(np.array([0.25, 0.25, 0.299]))
