"""Edges of a wrong mesh are moved to where images have them, and those that do not exist are left out."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges import edge_refinement
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.edge_refinement import (
    RANGES_PX,
    SIGMAS_PX,
    PosedImage,
    RefinedEdges,
    refined_edges,
)
from polhode.planning.edges.image_profiles import as_levels
from polhode.planning.edges.visible_edges import control_points
from tests.planning.edges.scenes import RIG, block, drawn, poses

SIGMA_M = 4e-3
PHANTOMS = 4


@pytest.fixture(scope="module")
def images() -> list[PosedImage]:
    """A block from sixteen sides, each under another light."""
    lights = np.random.default_rng(4).normal(size=(16, 3)) * [1.0, 1.0, 0.2] - [0.0, 0.0, 1.0]
    return [
        PosedImage(as_levels(drawn(block().surface, X, seed, light=tuple(light))), X)
        for seed, (X, light) in enumerate(zip(poses(16, 3, 2.0), lights, strict=True))
    ]


def wrong_model() -> tuple[EdgeModel, EdgeModel]:
    """The true edges; and the same, displaced, with some across the faces that are none."""
    true = block()
    rng = np.random.default_rng(0)
    ends = true.ends_G + SIGMA_M * rng.normal(size=true.ends_G.shape)
    middles = true.ends_G.mean(axis=1)
    # from one edge's middle to that of another one of the same face
    pairs = [(0, 3), (1, 4), (2, 5), (3, 6)]
    phantom = np.array([[middles[a], middles[b]] for a, b in pairs])
    along = np.concatenate([ends, phantom])
    along = along[:, 1] - along[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    wrong = replace(
        true,
        ends_G=np.concatenate([ends, phantom]),
        tangents_G=np.stack([along, along], axis=1),
        sides_G=np.concatenate([true.sides_G, true.sides_G[:PHANTOMS]]),
        kind=np.concatenate([true.kind, true.kind[:PHANTOMS]]),
    )
    return true, wrong


@pytest.fixture(scope="module")
def result(images: list[PosedImage]) -> tuple[EdgeModel, EdgeModel, RefinedEdges]:
    true, wrong = wrong_model()
    mesh = trimesh.Trimesh(true.surface.vertices, true.surface.faces, process=False)
    return true, wrong, refined_edges(wrong, mesh, np.full(len(mesh.vertices), SIGMA_M), RIG, images)


def across(ends_G: Array, true: EdgeModel) -> tuple[Array, Array]:
    """(n, 2) distances of both ends from the line of the nearest true edge, and which that is (n,)."""
    out = np.empty((len(ends_G), len(true.ends_G), 2))
    for k, (a, b) in enumerate(true.ends_G):
        along = (b - a) / np.linalg.norm(b - a)
        away = ends_G - a
        out[:, k] = np.linalg.norm(away - (away @ along)[..., None] * along, axis=2)
    nearest = np.argmin(out.sum(axis=2), axis=1)
    return out[np.arange(len(ends_G)), nearest], nearest


def test_edges_come_to_where_the_images_have_them(result: tuple[EdgeModel, EdgeModel, RefinedEdges]) -> None:
    true, wrong, edges = result
    before, _ = across(wrong.ends_G[:-PHANTOMS], true)
    after, nearest = across(edges.model.ends_G, true)
    assert np.median(after) < 0.15 * np.median(before)
    assert after.max() < SIGMA_M
    # nearly all of them are found, each once
    assert len(set(nearest.tolist())) >= len(true.ends_G) - 3 and len(nearest) <= len(true.ends_G) + 1


def test_errors_are_as_large_as_the_covariance_says(
    result: tuple[EdgeModel, EdgeModel, RefinedEdges],
) -> None:
    true, _, edges = result
    after, _ = across(edges.model.ends_G, true)
    ratio = np.sqrt(np.mean(after**2, axis=1) / 2.0) / edges.sigma_m
    assert 0.03 < np.median(ratio) < 1.5 and np.all(ratio < 4.0)
    assert np.all(np.linalg.eigvalsh(edges.covariance)[:, -4:] > 0.0)


def test_more_turns_count_the_images_no_more_than_once(
    result: tuple[EdgeModel, EdgeModel, RefinedEdges],
    images: list[PosedImage],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, wrong, edges = result
    monkeypatch.setattr(edge_refinement, "RANGES_PX", (*RANGES_PX, *RANGES_PX[-1:] * 4))
    monkeypatch.setattr(edge_refinement, "SIGMAS_PX", (*SIGMAS_PX, *SIGMAS_PX[-1:] * 4))
    mesh = trimesh.Trimesh(wrong.surface.vertices, wrong.surface.faces, process=False)
    more = refined_edges(wrong, mesh, np.full(len(mesh.vertices), SIGMA_M), RIG, images)
    assert len(more.sigma_m) == len(edges.sigma_m)
    assert np.median(more.sigma_m / edges.sigma_m) == pytest.approx(1.0, abs=0.02)


def test_directions_turn_with_the_edges(result: tuple[EdgeModel, EdgeModel, RefinedEdges]) -> None:
    model = result[2].model
    along = model.ends_G[:, 1] - model.ends_G[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    np.testing.assert_allclose(model.tangents_G, np.stack([along, along], axis=1), atol=1e-12)


def test_places_depend_on_the_ends_as_the_derivative_says(
    result: tuple[EdgeModel, EdgeModel, RefinedEdges], images: list[PosedImage]
) -> None:
    edges = result[2]
    points = control_points(edges.model, RIG, images[0].X_CG)
    points = points[points.feature < len(edges.model.ends_G)]
    ends = edges.model.ends_G[points.feature].reshape(-1, 6)
    # linear in the ends: they are moved to the point itself
    assert np.allclose(np.einsum("mij,mj->mi", edges.at(points), ends), points.p_G, atol=1e-6)


def test_what_no_image_shows_is_left_out(result: tuple[EdgeModel, EdgeModel, RefinedEdges]) -> None:
    wrong, mesh = (
        result[1],
        trimesh.Trimesh(result[1].surface.vertices, result[1].surface.faces, process=False),
    )
    black = [PosedImage(as_levels(np.zeros((480, 640))), make_pose(np.eye(3), [0.0, 0.0, 3.0]))]
    for images in (black, []):
        found = refined_edges(wrong, mesh, np.full(len(mesh.vertices), SIGMA_M), RIG, images)
        assert found.model.size == len(found.sigma_m) == 0
