"""Edges of meshes whose edges are known, and what a camera sees of them."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.planning.edges.edge_model import EdgeKind, chains_of, edge_model, straight_pieces
from polhode.planning.edges.measured_edges import measured_edge_model, simplified
from polhode.planning.edges.visible_edges import control_points, outlines
from polhode.runtime.errors import InputError

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)


def pose(turn: tuple[float, float, float], p: tuple[float, float, float]) -> Array:
    return make_pose(exp_so3(turn), p)


def finely(mesh: trimesh.Trimesh, edge_m: float) -> trimesh.Trimesh:
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge_m)
    return trimesh.Trimesh(vertices, faces)


@pytest.mark.parametrize("edge_m", [2.0, 0.1])
def test_a_box_has_twelve_edges_however_it_is_cut_into_faces(edge_m: float) -> None:
    model = edge_model(finely(trimesh.creation.box((1.0, 0.6, 0.4)), edge_m))
    assert len(model.ends_G) == 12
    assert_allclose(np.sort(model.lengths_m), np.repeat([0.4, 0.6, 1.0], 4), atol=1e-12)
    assert not model.outlined.any()
    # Both sides of an edge: its two normals are across it and across each other.
    along = model.ends_G[:, 1] - model.ends_G[:, 0]
    assert_allclose(np.einsum("nk,nsk->ns", along, model.sides_G), 0.0, atol=1e-12)
    assert_allclose(np.einsum("nk,nk->n", model.sides_G[:, 0], model.sides_G[:, 1]), 0.0, atol=1e-12)


def seen_px(mesh: trimesh.Trimesh) -> float:
    return float(control_points(edge_model(mesh), RIG, pose((0.5, 0.4, 0.1), (0.0, 0.0, 4.0))).weight.sum())


@pytest.mark.parametrize("solid", [trimesh.creation.box((1.0, 0.6, 0.4)), trimesh.creation.icosphere(3)])
def test_a_mesh_inside_out_or_with_faces_twice_shows_the_same_edges(solid: trimesh.Trimesh) -> None:
    inward = solid.faces[:, ::-1]
    expected = seen_px(solid)
    assert expected > 10.0
    for faces in inward, np.vstack([solid.faces, solid.faces]), np.vstack([inward, solid.faces]):
        again = trimesh.Trimesh(solid.vertices, faces, process=False)
        assert seen_px(again) == pytest.approx(expected, rel=1e-9)


def test_the_rim_of_an_open_mesh_is_an_edge() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    open_box = trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5])
    model = edge_model(open_box)
    rim = model.kind == EdgeKind.BOUNDARY
    assert rim.sum() == 4
    assert_allclose(model.ends_G[rim][..., 2], 0.5)
    assert (~rim).sum() == 8


def test_a_cylinder_has_two_rims_and_a_side_with_outlines() -> None:
    model = edge_model(trimesh.creation.cylinder(0.4, 0.8, sections=128))
    assert model.outlined.sum() == 1
    assert_allclose(np.linalg.norm(model.ends_G[..., :2], axis=-1), 0.4, atol=1e-6)
    assert_allclose(np.abs(model.ends_G[..., 2]), 0.4, atol=1e-9)
    # Arcs know their direction: across the radius at both ends.
    assert_allclose(
        np.einsum("nsk,nsk->ns", model.ends_G[..., :2], model.tangents_G[..., :2]), 0.0, atol=1e-4
    )


def test_the_outline_of_a_sphere_is_the_circle_of_tangents() -> None:
    model = edge_model(trimesh.creation.icosphere(4, 0.5))
    eye = np.array([0.3, -0.4, 3.0])
    found = outlines(model, eye)
    places, normals = found.ends_G.reshape(-1, 3), found.normals_G.reshape(-1, 3)
    assert_allclose(np.linalg.norm(places, axis=1), 0.5, atol=2e-3)
    assert_allclose(np.einsum("nk,nk->n", normals, places - eye), 0.0, atol=1e-9)
    # Tangents from the eye touch a sphere at the height r^2 / d above its middle.
    distance = np.linalg.norm(eye)
    assert_allclose(places @ eye / distance, 0.25 / distance, atol=2e-3)


def test_hidden_edges_are_removed() -> None:
    model = edge_model(trimesh.creation.box((1.0, 1.0, 1.0)))
    front = control_points(model, RIG, pose((0.0, 0.0, 0.0), (0.0, 0.0, 3.0)))
    # Face on: four of the twelve edges, at the near side.
    assert len(np.unique(front.feature)) == 4
    assert_allclose(front.p_G[:, 2], -0.5)
    corner = control_points(model, RIG, pose((0.6, 0.5, 0.1), (0.0, 0.0, 3.0)))
    assert len(np.unique(corner.feature)) == 9


def test_another_body_hides_what_is_behind_it() -> None:
    near = trimesh.creation.box((0.5, 0.5, 0.1))
    far = trimesh.creation.box((0.2, 0.2, 0.1))
    far.apply_translation([0.0, 0.0, 1.0])
    faces = np.concatenate([near.faces, far.faces + len(near.vertices)])
    both = edge_model(trimesh.Trimesh(np.concatenate([near.vertices, far.vertices]), faces))
    seen = control_points(both, RIG, pose((0.0, 0.0, 0.0), (0.0, 0.0, 3.0)))
    assert seen.p_G[:, 2].max() < 0.1
    aside = control_points(both, RIG, pose((0.0, 0.5, 0.0), (-0.4, 0.0, 3.0)))
    assert aside.p_G[:, 2].max() > 0.9


def test_control_points_lie_on_edges_and_stand_for_their_length() -> None:
    model = edge_model(trimesh.creation.box((1.0, 0.6, 0.4)))
    X_RG = pose((0.4, 0.5, 0.2), (0.05, 0.02, 3.0))
    points = control_points(model, RIG, X_RG, 10.0)
    a, b = (model.ends_G[points.feature, side] for side in (0, 1))
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    assert_allclose(np.linalg.norm(np.cross(points.p_G - a, along), axis=1), 0.0, atol=1e-12)
    p_R = points.p_G @ X_RG[:3, :3].T + X_RG[:3, 3]
    assert_allclose(points.uv_px, RIG.project(p_R)[:, :2])
    assert_allclose(np.linalg.norm(points.normal_px, axis=1), 1.0)
    # The sum of the weights does not depend on the steps.
    coarse = control_points(model, RIG, X_RG, 25.0)
    assert coarse.weight.sum() * 25.0 == pytest.approx(points.weight.sum() * 10.0, rel=0.03)


def test_edges_that_fall_together_in_the_image_count_once() -> None:
    sheet, slab = (trimesh.creation.box((1.0, 1.0, thickness)) for thickness in (0.002, 0.2))
    X_RG = pose((0.6, 0.5, 0.0), (0.0, 0.0, 3.0))
    seen, thick = (control_points(edge_model(mesh), RIG, X_RG) for mesh in (sheet, slab))
    assert len(np.unique(seen.feature)) == 4
    assert len(np.unique(thick.feature)) == 9


@pytest.mark.parametrize("p", [(0.0, 0.0, -3.0), (9.0, 0.0, 3.0)])
def test_behind_the_camera_or_beside_its_image_nothing_is_seen(p: tuple[float, float, float]) -> None:
    for mesh in (trimesh.creation.box((1.0, 1.0, 1.0)), trimesh.creation.icosphere(3, 0.5)):
        assert len(control_points(edge_model(mesh), RIG, pose((0.1, 0.2, 0.3), p))) == 0


def test_edges_that_pass_the_camera_are_cut() -> None:
    model = edge_model(trimesh.creation.box((0.1, 0.1, 10.0)))
    points = control_points(model, RIG, pose((0.0, 0.0, 0.0), (0.4, 0.3, 0.0)))
    assert len(points) > 10
    assert np.isfinite(points.uv_px).all()
    assert (points.uv_px > -0.5).all() and (points.uv_px < [639.5, 479.5]).all()


def test_a_measured_box_gets_its_edges_back() -> None:
    noise = np.random.default_rng(3)
    fine = finely(trimesh.creation.box((1.0, 0.6, 0.4)), 0.02)
    shaken = trimesh.Trimesh(fine.vertices + noise.normal(0.0, 3e-4, fine.vertices.shape), fine.faces)
    model = measured_edge_model(shaken, np.full(len(shaken.vertices), 3e-4))
    assert len(model.surface.faces) < 0.1 * len(shaken.faces)
    # What is found lies on true edges, and they are all found.
    true = edge_model(trimesh.creation.box((1.0, 0.6, 0.4)))
    X_RG = pose((0.4, 0.5, 0.2), (0.05, 0.02, 3.0))
    found, expected = control_points(model, RIG, X_RG), control_points(true, RIG, X_RG)
    gap = np.linalg.norm(found.uv_px[:, None] - expected.uv_px, axis=2)
    assert np.mean(gap.min(axis=1) < 6.0) > 0.95
    assert np.mean(gap.min(axis=0) < 8.0) > 0.95


def test_what_cannot_be_simpler_stays() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    assert simplified(box, 1e-3) is box
    ball = trimesh.creation.icosphere(3, 0.5)
    assert len(simplified(ball, 1e-6).faces) == len(ball.faces)
    assert len(simplified(ball, 2e-2).faces) < 0.5 * len(ball.faces)


def test_chains_and_pieces() -> None:
    cross = np.array([[0, 1], [1, 2], [1, 3], [3, 4], [5, 6], [6, 7], [7, 5]])
    chains = [list(map(int, chain)) for chain, _ in chains_of(cross)]
    assert sorted(len(chain) for chain in chains) == [2, 2, 3, 4]
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0]])
    assert straight_pieces(corner, 1e-6) == [(0, 2), (2, 4)]


def test_what_is_no_surface_is_refused() -> None:
    with pytest.raises(InputError, match="no faces"):
        edge_model(trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)))
    with pytest.raises(InputError, match="non-finite"):
        edge_model(trimesh.Trimesh(np.diag([1.0, 1.0, np.nan]), np.array([[0, 1, 2]]), process=False))
    with pytest.raises(InputError, match="degenerate"):
        edge_model(trimesh.Trimesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), process=False))
