"""Procedural families: closed parts, sizes, seeds, generators."""

from functools import cache

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.build import FAMILIES
from polhode.simulation.bodies.families.asteroid import asteroid_parts
from polhode.simulation.bodies.part import Part, join
from polhode.simulation.bodies.textures.part_builder import GENERATORS, PartBuilder

BUILT = ["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat"]
SIZE_M = 0.4


@cache
def _parts(family: str, seed: int = 3, texture: str = "drawn") -> list[Part]:
    rng, ink = np.random.default_rng([1, seed]), np.random.default_rng([2, seed])
    # Coarse drawings: these tests look at shapes.
    return FAMILIES[family](SIZE_M, PartBuilder(GENERATORS[texture], rng, ink, SIZE_M / 120))


def _overlaps(triangles: Array, normal: Array) -> Array:
    """(n, n) whether the middle of each of n triangles (n, 3, 3) of one plane lies inside each other one."""
    keep = np.delete(np.arange(3), int(np.argmax(np.abs(normal))))
    corners = triangles[:, :, keep]
    middle = corners.mean(axis=1)[:, None, None]
    edge, to_middle = np.roll(corners, -1, axis=1) - corners, middle - corners
    side = edge[..., 0] * to_middle[..., 1] - edge[..., 1] * to_middle[..., 0]
    return np.asarray((side > 0).all(axis=2) | (side < 0).all(axis=2))


@pytest.mark.parametrize("family", BUILT)
def test_parts_are_closed_and_wound_outwards(family: str) -> None:
    for part in _parts(family):
        assert part.mesh.is_watertight and part.mesh.is_winding_consistent, part.name
        assert part.mesh.volume > 0, part.name


@pytest.mark.parametrize("family", BUILT)
def test_no_two_parts_have_faces_in_one_place(family: str) -> None:
    """Coincident faces flicker between their two looks."""
    parts = _parts(family)
    mesh = join([part.mesh for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.mesh.faces) for part in parts])
    normals, triangles = np.asarray(mesh.face_normals), np.asarray(mesh.triangles)
    signs = np.sign(normals[np.arange(len(normals)), np.argmax(np.abs(normals), axis=1)])[:, None]
    offset = np.einsum("fk,fk->f", signs * normals, triangles[:, 0]) / SIZE_M
    key = np.round(np.column_stack([signs * normals, offset]) * 1e5).astype(np.int64)
    order = np.lexsort(key.T)
    ends = np.flatnonzero(np.any(np.diff(key[order], axis=0) != 0, axis=1)) + 1
    for group in np.split(order, ends):
        whose = owner[group]
        if (whose != whose[0]).any():
            both = _overlaps(triangles[group], normals[group[0]]) & (whose[:, None] != whose)
            assert not both.any(), [parts[k].name for k in whose[both.any(axis=1)]]


@pytest.mark.parametrize("family", BUILT)
def test_another_seed_gives_another_shape(family: str) -> None:
    one, other = _parts(family, 3), _parts(family, 4)
    if family == "free_flyer":
        # Its shape is that of the real one; seeds differ in drawings and buttons.
        assert any(a.material != b.material for a, b in zip(one, other, strict=True))
        return
    extents = [np.ptp(join([part.mesh for part in parts]).vertices, axis=0) for parts in (one, other)]
    assert np.abs(extents[0] - extents[1]).max() > 0.01 * SIZE_M


@pytest.mark.parametrize("family", ["bus", "upper_stage", "cubesat"])
def test_both_generators_draw_on_the_same_shape(family: str) -> None:
    drawn, collage = _parts(family), _parts(family, texture="collage")
    assert [part.name for part in drawn] == [part.name for part in collage]
    for a, b in zip(drawn, collage, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert len(a.charts) == len(b.charts)
    images = [[chart.image for part in parts for chart, _ in part.charts] for parts in (drawn, collage)]
    assert not any(np.array_equal(a, b) for a, b in zip(*images, strict=True))


def _extent(parts: list[Part], names: set[str]) -> Array:
    return np.asarray(np.ptp(np.vstack([p.mesh.vertices for p in parts if p.name in names]), axis=0))


def test_sizes_are_those_that_the_scene_names() -> None:
    assert _extent(_parts("bus"), {"box"})[0] == pytest.approx(SIZE_M)
    stage = _parts("upper_stage")
    assert _extent(stage, {part.name for part in stage})[2] == pytest.approx(SIZE_M, rel=1e-3)
    np.testing.assert_allclose(_extent(_parts("dish"), {"reflector"})[:2], SIZE_M, rtol=0.02)
    assert _extent(_parts("truss"), {"truss", "module", "plate"})[0] == pytest.approx(SIZE_M, rel=0.1)
    assert _extent(_parts("cubesat"), {"rail"})[2] == pytest.approx(SIZE_M, rel=0.15)


def test_a_body_twice_as_large_is_the_same_in_all_proportions() -> None:
    def body(size_m: float) -> Body:
        return build_body(config.TargetBody(family="cubesat", size_m=size_m), 5)

    small, large = body(0.2), body(0.4)
    np.testing.assert_allclose(large.mesh.vertices, 2.0 * small.mesh.vertices, atol=1e-12)
    assert large.texture_scale == pytest.approx(2.0 * small.texture_scale)
    for a, b in zip(small.charts, large.charts, strict=True):
        np.testing.assert_array_equal(a.image, b.image)


def test_asteroids_differ_in_shape_and_are_closed() -> None:
    spread = []
    for seed in (1, 2, 3):
        builder = PartBuilder(GENERATORS["drawn"], np.random.default_rng(seed), np.random.default_rng(0), 1.0)
        (part,) = asteroid_parts(0.3, builder, subdivisions=4)
        assert part.mesh.is_watertight
        spread.append(np.sort(np.linalg.eigvalsh(part.mesh.moment_inertia)))
    ratios = np.array(spread)[:, 2] / np.array(spread)[:, 0]
    assert np.ptp(ratios) > 0.1
