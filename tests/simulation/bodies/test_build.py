"""Bodies: solids, shape, mass and surface; closed parts of the families, sizes, seeds, generators."""

import ast
import warnings
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.simulation.bodies import Body, build_body, texture_seed
from polhode.simulation.bodies.build import FAMILIES
from polhode.simulation.bodies.families.asteroid import asteroid_parts
from polhode.simulation.bodies.part import SHEET_THICKNESS, Part, PartMass, assemble, join, masses_by_name
from polhode.simulation.bodies.solids import (
    ball,
    box,
    drum,
    ellipsoid_cap,
    flat_facets,
    flat_regions,
    frame,
    pose,
    prism,
    revolve,
    smooth_corner_normals,
    strut,
    tube,
)
from polhode.simulation.bodies.textures import collage, drawn, drawn_marks
from polhode.simulation.bodies.textures.canvas import Canvas, Code, Draw
from polhode.simulation.bodies.textures.part_builder import GENERATORS, PartBuilder
from polhode.simulation.rendering.appearance import chart_atlas, look_up
from polhode.simulation.surface import noise, spot_noise
from polhode.simulation.surface.materials import FOIL_GOLD, PAINT_WHITE


@cache
def _built(family: str, seed: int = 1, **more: object) -> Body:
    return build_body(config.TargetBody.model_validate({"family": family, **more}), seed)


def test_a_texture_seed_changes_the_drawings_and_not_the_shape() -> None:
    described = [config.TargetBody(family="cubesat", seed=5, texture_seed=seed) for seed in (None, 5, 6)]
    assert [texture_seed(each, 1) for each in described] == [5, 5, 6]
    bodies = [build_body(each, 1) for each in described]
    for body in bodies[1:]:
        np.testing.assert_array_equal(body.mesh.vertices, bodies[0].mesh.vertices)
        np.testing.assert_array_equal(body.mesh.faces, bodies[0].mesh.faces)
    own, same, other = ([chart.image for chart in body.charts] for body in bodies)
    assert all((a == b).all() for a, b in zip(own, same, strict=True))
    assert [a.shape for a in own] == [c.shape for c in other]
    assert any((a != c).any() for a, c in zip(own, other, strict=True))


def test_the_free_flyers_shell_has_18_faces_with_different_drawings() -> None:
    body = _built("free_flyer", size_m=0.22)
    shell_charts = body.charts[:18]
    normals = np.array([np.cross(chart.right_G, -chart.down_G) for chart in shell_charts])
    distances = np.einsum("nk,nk->n", normals, [chart.origin_G for chart in shell_charts])
    np.testing.assert_allclose(np.sort(np.abs(distances)), [0.11] * 6 + [0.545 * 0.22] * 12)
    assert len(np.unique(np.round(normals, 6), axis=0)) == 18
    images = [chart.image for chart in _built("free_flyer").charts]
    same = [a.shape == b.shape and (a == b).all() for i, a in enumerate(images) for b in images[:i]]
    assert not any(same)


def test_mass_of_joined_parts_is_that_of_the_closed_form() -> None:
    """Two boxes end to end are one long box."""
    halves = []
    for x in (-0.1, 0.1):
        box = trimesh.creation.box([0.2, 0.1, 0.05])
        box.apply_translation([x + 0.03, 0, 0])
        halves.append(Part(box, PAINT_WHITE))
    body = assemble(halves)
    m = 0.4 * 0.1 * 0.05
    a2, b2, c2 = 0.4**2, 0.1**2, 0.05**2
    assert body.volume_m3 == pytest.approx(m)
    np.testing.assert_allclose(body.com_G, [0.03, 0, 0], atol=1e-12)
    np.testing.assert_allclose(
        body.inertia_per_density, m / 12 * np.diag([b2 + c2, a2 + c2, a2 + b2]), atol=1e-15
    )


def test_normals_are_smooth_on_a_ball_and_flat_on_a_box() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners = smooth_corner_normals(ball)
    assert np.einsum("fck,fck->fc", corners, ball.vertices[ball.faces]).min() > np.cos(np.deg2rad(1.0))
    box = trimesh.creation.box()
    np.testing.assert_allclose(smooth_corner_normals(box), np.repeat(box.face_normals[:, None], 3, axis=1))


def test_charts_are_read_where_and_as_they_were_drawn() -> None:
    body = _built("free_flyer")
    atlas = chart_atlas(body.charts)
    for index in (0, 7, 20):
        chart = body.charts[index]
        row, column = (size // 2 for size in chart.image.shape)
        p_G = chart.origin_G + chart.texel_m * (column * chart.right_G + row * chart.down_G)
        read, _, _ = look_up(np.array([index, -1]), np.stack([p_G, p_G]), atlas)
        assert read[0] == pytest.approx(chart.image[row, column], abs=1e-6)
        assert np.isnan(read[1])
    body = _built("free_flyer")
    for index, chart in enumerate(body.charts):
        outward = body.mesh.face_normals[np.flatnonzero(body.face_chart == index)[0]]
        # Right, down and the viewing direction (inwards) are right-handed, as in an image.
        assert np.cross(chart.right_G, chart.down_G) @ -outward == pytest.approx(1.0)


def _one(mesh: trimesh.Trimesh) -> PartMass:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (mass,) = masses_by_name([("it", mesh, 1.0)])
    return mass


def test_an_inside_out_box_weighs_as_a_box() -> None:
    mesh = trimesh.creation.box([1.0, 2.0, 3.0])
    mesh.invert()
    mass = _one(mesh)
    assert mass.volume_m3 == pytest.approx(6.0)
    np.testing.assert_allclose(mass.inertia_per_density, 0.5 * np.diag([13.0, 10.0, 5.0]))


def test_an_open_box_weighs_as_its_hull() -> None:
    mesh = trimesh.creation.box([1.0, 2.0, 3.0])
    mesh.update_faces(np.arange(12) > 0)
    assert _one(mesh).volume_m3 == pytest.approx(6.0)


def test_pieces_of_an_open_mesh_are_weighed_one_by_one() -> None:
    """Two open boxes far apart: not the hull of both."""
    halves = []
    for x in (-5.0, 5.0):
        mesh = trimesh.creation.box([1.0, 1.0, 1.0])
        mesh.update_faces(np.arange(12) > 0)
        mesh.apply_translation([x, 0, 0])
        halves.append(mesh)
    mass = _one(join(halves))
    assert mass.volume_m3 == pytest.approx(2.0)
    assert mass.inertia_per_density[1, 1] == pytest.approx(2.0 * (25.0 + 1.0 / 6.0))


def test_a_flat_sheet_is_a_thin_plate() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    mass = _one(sheet)
    thickness = SHEET_THICKNESS * np.sqrt(2.0)
    volume = 2.0 * thickness
    assert mass.volume_m3 == pytest.approx(volume)
    np.testing.assert_allclose(mass.com_G, [1.0, 0.5, 0.0])
    plate = volume / 12.0 * np.diag([1.0 + thickness**2, 4.0 + thickness**2, 5.0])
    np.testing.assert_allclose(mass.inertia_per_density, plate, rtol=1e-9, atol=1e-15)


BUILT = ["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat"]
SIZE_M = 0.4


@cache
def _family(family: str, seed: int = 3, texture: str = "drawn") -> list[Part]:
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
    for part in _family(family):
        assert part.mesh.is_watertight and part.mesh.is_winding_consistent, part.name
        assert part.mesh.volume > 0, part.name


@pytest.mark.parametrize("family", BUILT)
def test_no_two_parts_have_faces_in_one_place(family: str) -> None:
    """Coincident faces flicker between their two looks."""
    parts = _family(family)
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


@pytest.mark.parametrize("family", ["bus", "upper_stage", "cubesat"])
def test_both_generators_draw_on_the_same_shape(family: str) -> None:
    drawn, collage = _family(family), _family(family, texture="collage")
    assert [part.name for part in drawn] == [part.name for part in collage]
    for a, b in zip(drawn, collage, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert len(a.charts) == len(b.charts)
    images = [[chart.image for part in parts for chart, _ in part.charts] for parts in (drawn, collage)]
    assert not any(np.array_equal(a, b) for a, b in zip(*images, strict=True))


def _extent(parts: list[Part], names: set[str]) -> Array:
    return np.asarray(np.ptp(np.vstack([p.mesh.vertices for p in parts if p.name in names]), axis=0))


def test_sizes_are_those_that_the_scene_names() -> None:
    assert _extent(_family("bus"), {"box"})[0] == pytest.approx(SIZE_M)
    stage = _family("upper_stage")
    assert _extent(stage, {part.name for part in stage})[2] == pytest.approx(SIZE_M, rel=1e-3)
    np.testing.assert_allclose(_extent(_family("dish"), {"reflector"})[:2], SIZE_M, rtol=0.02)
    assert _extent(_family("truss"), {"truss", "module", "plate"})[0] == pytest.approx(SIZE_M, rel=0.1)
    assert _extent(_family("cubesat"), {"rail"})[2] == pytest.approx(SIZE_M, rel=0.15)


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
        assert part.mesh.is_watertight and part.mesh.volume == pytest.approx(np.pi / 6 * 0.3**3)
        spread.append(np.sort(np.linalg.eigvalsh(part.mesh.moment_inertia)))
    ratios = np.array(spread)[:, 2] / np.array(spread)[:, 0]
    assert np.ptp(ratios) > 0.1


SHEETS = {
    "panel": (0.3,), "plain": (0.3,), "machined_plate": (), "cells": (40,), "radiator": (),
    "blanket": (FOIL_GOLD,), "tank_wall": (0.7,), "ring_wall": (0.4,), "nozzle_wall": (),
    "reflector": (0.7, 12),
}  # fmt: skip


def _sheet(draw: Draw, seed: int = 1, shape: tuple[int, int] = (160, 200)) -> Code:
    canvas = Canvas(shape, np.random.default_rng(seed))
    draw(canvas)
    return canvas.code


def test_neither_generator_imports_the_other() -> None:
    for module, other in [
        (drawn, ".collage"), (drawn_marks, ".collage"), (collage, ".drawn"),
        (noise, "surface.spot_noise"), (spot_noise, "surface.noise"),
    ]:  # fmt: skip
        tree = ast.parse(Path(str(module.__file__)).read_text())
        imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        assert not any(other in name for name in imported), module


@pytest.mark.parametrize("textures", [drawn, collage])
@pytest.mark.parametrize("sheet", SHEETS)
def test_a_sheet_is_its_seeds_and_of_any_size(textures: ModuleType, sheet: str) -> None:
    draw = getattr(textures, sheet)(*SHEETS[sheet])
    np.testing.assert_array_equal(_sheet(draw, 1), _sheet(draw, 1))
    assert (_sheet(draw, 1) != _sheet(draw, 2)).any()
    for shape in ((3, 40), (40, 3), (14, 14)):
        assert _sheet(draw, 3, shape).shape == shape


def test_all_solids_are_closed_and_wound_outwards() -> None:
    bent = tube(np.array([[0, 0, 0], [0, 0, 1.0], [0.5, 0, 1.5], [0.5, 1.0, 1.5]]), 0.1)
    ring = revolve([(1.0, 0.0), (1.2, 0.0), (1.2, 0.1), (1.0, 0.1)], 24, closed=True).mesh
    for solid in (
        box([1, 2, 3]),
        drum(1.0, 2.0),
        ball(1.0),
        prism([(0, 0), (1, 0), (0, 1)], 2.0, 0.5),
        bent,
        ring,
    ):
        assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0
    assert revolve([(0, 1.0), (1.0, 1.0), (1.0, 0.0), (0, 0)], 12).mesh.volume > 0


def test_volumes_are_those_of_the_closed_forms() -> None:
    n = 40
    polygon = 0.5 * n * np.sin(2 * np.pi / n)
    assert revolve([(0, 0), (0.3, 0), (0.3, 0.5), (0, 0.5)], n).mesh.volume == pytest.approx(
        polygon * 0.3**2 * 0.5
    )
    ring = revolve([(1.0, 0), (1.2, 0), (1.2, 0.1), (1.0, 0.1)], n, closed=True).mesh
    assert ring.volume == pytest.approx(polygon * (1.2**2 - 1.0) * 0.1)
    assert strut([0, 0, 0], [1.0, 2.0, 2.0], 0.05, n).volume == pytest.approx(polygon * 0.05**2 * 3.0)
    assert ball(1.0, 80, 40).volume == pytest.approx(4 / 3 * np.pi, rel=0.01)
    assert prism([(0, 0), (1, 0), (1, 1), (0, 1)], 3.0).volume == pytest.approx(3.0)


def test_a_bevelled_box_keeps_its_extents_and_loses_its_edges() -> None:
    for extents in ([0.3, 0.2, 0.1], [1.0, 1.0, 0.01]):
        solid = box(extents, bevel=0.1)
        np.testing.assert_allclose(solid.extents, extents)
        assert 0.8 * np.prod(extents) < solid.volume < np.prod(extents)
        slanted = np.abs(solid.face_normals).max(axis=1) < 0.9
        assert 0 < solid.area_faces[slanted].sum() < 0.5 * solid.area


def test_panels_of_a_revolved_solid_are_flat_and_a_cap_runs_from_the_axis_to_the_rim() -> None:
    solid = revolve([(0, 0), (1.0, 0.2), (0.6, 0.8), (0, 1.0)], 16)
    assert (solid.panels[[0, 2]] >= 0).sum() == 2 * 16 and (solid.panels[1] >= 0).all()
    normals = solid.mesh.face_normals[solid.panels[1]]
    np.testing.assert_allclose(normals[:, 0], normals[:, 1], atol=1e-12)
    cap = ellipsoid_cap(2.0, 0.5)
    np.testing.assert_allclose(cap[[0, -1]], [[0, 0.5], [2.0, 0]], atol=1e-12)
    np.testing.assert_allclose((cap[:, 0] / 2.0) ** 2 + (cap[:, 1] / 0.5) ** 2, 1.0)


@pytest.mark.parametrize("direction", [[0, 0, 1.0], [0, 0, -2.0], [1.0, 0, 0], [-1, 2, 3]])
def test_poses_are_rigid_and_turn_z_to_the_direction(direction: list[float]) -> None:
    X = pose(direction, [1, 2, 3], 0.7)
    np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(X[:3, 2], np.array(direction) / np.linalg.norm(direction))
    np.testing.assert_allclose(X[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(frame(X[:3, 0], X[:3, 2], [1, 2, 3]), X, atol=1e-12)


def test_flat_sides_are_those_of_boxes_and_towers_and_ends_of_curved_walls() -> None:
    for scale in (0.01, 1.0, 300.0):
        mesh = trimesh.creation.box().subdivide()
        mesh.apply_scale(scale)
        assert len(flat_facets(mesh)) == 6
        regions = flat_regions(mesh, 0.5 * scale**2)
        assert sorted(len(faces) for faces in regions) == [8] * 6
        assert flat_regions(mesh, 1.5 * scale**2) == []
    assert len(flat_regions(box([1, 1, 1], bevel=0.05), 0.1)) == 6
    regions = flat_regions(trimesh.creation.box([1, 2, 3]), 1.0)
    mesh = trimesh.creation.box([1, 2, 3])
    np.testing.assert_allclose([mesh.area_faces[faces].sum() for faces in regions], [6, 6, 3, 3, 2, 2])
    wall = revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 32).mesh
    assert len(flat_regions(wall, 0.05)) == 2
    assert flat_regions(trimesh.creation.icosphere(subdivisions=4), 1e-4) == []
    assert flat_regions(trimesh.creation.icosphere(subdivisions=2), 1e-4) == []
    assert len(flat_regions(revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 6).mesh, 0.05)) == 8
