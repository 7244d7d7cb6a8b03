"""Edges of a wrong mesh are moved to where images have them, and those that do not exist are left out."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges import measured_edges
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.measured_edges import PosedImage, RefinedEdges, refined_edges
from polhode.planning.edges.profiles import as_levels
from tests.planning.edges.scenes import RIG, block, drawn, poses

SIGMA_M = 4e-3
PHANTOMS = 4


class Case(NamedTuple):
    true: EdgeModel
    wrong: EdgeModel
    """The same, displaced, with some across the faces that are none"""
    images: list[PosedImage]
    """From sixteen sides, each under another light"""

    def refined(self, images: list[PosedImage] | None = None) -> RefinedEdges:
        mesh = trimesh.Trimesh(self.true.surface.vertices, self.true.surface.faces, process=False)
        sigma_m = np.full(len(mesh.vertices), SIGMA_M)
        return refined_edges(self.wrong, mesh, sigma_m, RIG, self.images if images is None else images)


@pytest.fixture(scope="module")
def case() -> Case:
    lights = np.random.default_rng(4).normal(size=(16, 3)) * [1.0, 1.0, 0.2] - [0.0, 0.0, 1.0]
    true, rng = block(), np.random.default_rng(0)
    images = [
        PosedImage(as_levels(drawn(true.surface, X, seed, light=tuple(light))), X)
        for seed, (X, light) in enumerate(zip(poses(16, 3, 2.0), lights, strict=True))
    ]
    ends, middles = true.ends_G + SIGMA_M * rng.normal(size=true.ends_G.shape), true.ends_G.mean(axis=1)
    # from one edge's middle to that of another one of the same face
    phantom = np.array([[middles[a], middles[b]] for a, b in [(0, 3), (1, 4), (2, 5), (3, 6)]])
    ends = np.concatenate([ends, phantom])
    wrong = replace(
        true,
        ends_G=ends,
        tangents_G=directions(ends),
        sides_G=np.concatenate([true.sides_G, true.sides_G[:PHANTOMS]]),
        kind=np.concatenate([true.kind, true.kind[:PHANTOMS]]),
    )
    return Case(true, wrong, images)


@pytest.fixture(scope="module")
def edges(case: Case) -> RefinedEdges:
    return case.refined()


def directions(ends_G: Array) -> Array:
    """(n, 2, 3) of segments, at both ends."""
    along = ends_G[:, 1] - ends_G[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, along], axis=1)


def across(ends_G: Array, true: EdgeModel) -> tuple[Array, Array]:
    """(n, 2) distances of both ends from the line of the nearest true edge, and which that is (n,)."""
    out = np.empty((len(ends_G), len(true.ends_G), 2))
    for k, (a, b) in enumerate(true.ends_G):
        along = (b - a) / np.linalg.norm(b - a)
        away = ends_G - a
        out[:, k] = np.linalg.norm(away - (away @ along)[..., None] * along, axis=2)
    nearest = np.argmin(out.sum(axis=2), axis=1)
    return out[np.arange(len(ends_G)), nearest], nearest


def test_edges_come_to_where_the_images_have_them_as_near_as_the_covariance_says(
    case: Case, edges: RefinedEdges
) -> None:
    before, _ = across(case.wrong.ends_G[:-PHANTOMS], case.true)
    after, nearest = across(edges.model.ends_G, case.true)
    assert np.median(after) < 0.15 * np.median(before)
    assert after.max() < SIGMA_M
    # nearly all of them are found, each once
    assert (
        len(set(nearest.tolist())) >= len(case.true.ends_G) - 3 and len(nearest) <= len(case.true.ends_G) + 1
    )
    ratio = np.sqrt(np.mean(after**2, axis=1) / 2.0) / edges.sigma_m
    assert 0.03 < np.median(ratio) < 1.5 and np.all(ratio < 4.0)
    assert np.all(np.linalg.eigvalsh(edges.covariance)[:, -4:] > 0.0)
    np.testing.assert_allclose(edges.model.tangents_G, directions(edges.model.ends_G), atol=1e-12)


def test_more_turns_count_the_images_no_more_than_once(
    case: Case, edges: RefinedEdges, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("RANGES_PX", "SIGMAS_PX"):
        turns = getattr(measured_edges, name)
        monkeypatch.setattr(measured_edges, name, (*turns, *turns[-1:] * 4))
    more = case.refined()
    assert len(more.sigma_m) == len(edges.sigma_m)
    assert np.median(more.sigma_m / edges.sigma_m) == pytest.approx(1.0, abs=0.02)


def test_what_no_image_shows_is_left_out(case: Case) -> None:
    black = PosedImage(as_levels(np.zeros((480, 640))), make_pose(np.eye(3), [0.0, 0.0, 3.0]))
    for images in ([black], []):
        found = case.refined(images)
        assert found.model.size == len(found.sigma_m) == 0
