"""Drawings on flat faces and around walls, read back where light would meet them.

The surface of whole bodies: layers of drawings, one material for all, contrast.
"""

from functools import cache

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.part import SLOPE_STEP, Chart, Part, assemble
from polhode.simulation.bodies.solids import box, flat_facets, revolve
from polhode.simulation.bodies.textures.canvas import Canvas, chart_of_facet, charts_around, code
from polhode.simulation.rendering.appearance import SurfaceAppearance, chart_atlas, look_up
from polhode.simulation.rendering.raycast import Hits
from polhode.simulation.surface.materials import (
    FOIL_GOLD,
    FOIL_SILVER,
    GLASS,
    PAINT_GREY,
    REGOLITH,
    SOLAR_CELL,
    Surface,
)

TEXEL_M = 0.001
RIGHT, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])


def _chart(**more: object) -> Chart:
    image = np.linspace(0.1, 0.9, 20, dtype=np.float32).reshape(4, 5)
    return Chart(np.array([0.1, 0.2, 0.3]), RIGHT, DOWN, TEXEL_M, image, **more)  # type: ignore[arg-type]


def _at(chart: Chart, row: float, column: float) -> Array:
    return np.asarray(chart.origin_G + TEXEL_M * (column * chart.right_G + row * chart.down_G))[None]


def test_reflectance_relief_and_layers_are_read_from_a_chart() -> None:
    chart = _chart()
    atlas = chart_atlas((chart,))
    read = look_up(np.zeros(1, np.int64), _at(chart, 1.25, 2.5), atlas)[0][0]
    (a, b), (c, d) = chart.image[1:3, 2:4]
    assert read == pytest.approx(0.75 * (0.5 * a + 0.5 * b) + 0.25 * (0.5 * c + 0.5 * d), abs=1e-6)
    slope = np.zeros((4, 5, 2), np.int8)
    slope[..., 0], slope[..., 1] = 30, -20
    atlas = chart_atlas((_chart(slope=slope),))
    _, slope_G, _ = look_up(np.zeros(1, np.int64), _at(_chart(), 1, 1), atlas)
    np.testing.assert_allclose(slope_G[0], SLOPE_STEP * (30 * RIGHT - 20 * DOWN), atol=1e-12)
    layer = np.zeros((4, 5), np.uint8)
    layer[1, 2] = 2
    chart = _chart(layer=layer, materials=(GLASS, FOIL_GOLD))
    points = np.vstack([_at(chart, 1.4, 2.4), _at(chart, 1.6, 2.4), _at(chart, 1.4, 1.4)])
    _, _, layers = look_up(np.array([0, 0, 0]), points, chart_atlas((chart,)))
    np.testing.assert_array_equal(layers, [2, 0, 0])
    reflectance, slope_G, layers = look_up(np.array([-1]), np.zeros((1, 3)), chart_atlas((_chart(),)))
    assert np.isnan(reflectance[0]) and not slope_G.any() and layers[0] == 0


def test_rows_run_along_the_direction_that_is_asked_for() -> None:
    mesh = box([0.1, 0.2, 0.3], bevel=0.0)
    faces = next(f for f in flat_facets(mesh) if mesh.face_normals[f[0], 0] > 0.99)
    chart, _ = chart_of_facet(mesh, faces, 0.005, lambda canvas: None, np.random.default_rng(0), DOWN)
    np.testing.assert_allclose(chart.down_G, DOWN, atol=1e-12)
    # Seen from outside, +x towards the viewer and z up, right is +y.
    np.testing.assert_allclose(chart.right_G, RIGHT, atol=1e-12)


def _ramp(canvas: Canvas) -> None:
    """Brighter to the right, so that any jump between slices would show; a wrap at the end."""
    height, width = canvas.shape
    wave = 0.4 + 0.3 * np.cos(2 * np.pi * (np.arange(width) + 0.5) / width)
    canvas.code[:] = [code(float(value)) for value in wave]
    canvas.code[: height // 2] = (canvas.code[: height // 2] * 0.8).astype(np.uint8)


@pytest.mark.parametrize("top", [0.1, 0.06])
def test_a_drawing_around_a_wall_goes_on_across_its_panels(top: float) -> None:
    """Cylinder and cone: on either side of each edge the two charts read the same."""
    solid = revolve([(0, 0), (0.1, 0), (top, 0.2), (0, 0.2)], 24)
    charts = charts_around(solid, 1, 2, 0.002, _ramp, np.random.default_rng(0))
    atlas = chart_atlas(tuple(chart for chart, _ in charts))
    number = np.arange(24)
    for share in (0.2, 0.45, 0.8):
        edges = solid.mesh.triangles[solid.panels[1, :, 0]][:, 1]
        ends = solid.mesh.triangles[solid.panels[1, :, 0]][:, 2]
        points = edges + share * (ends - edges)
        # The edge at the end of panel k is the start of panel k + 1.
        one, _, _ = look_up(number, points, atlas)
        other, _, _ = look_up((number + 1) % 24, points, atlas)
        np.testing.assert_allclose(one, other, atol=0.02)
        assert np.ptp(one) > 0.2


def test_a_wall_reads_the_right_way_round_from_outside() -> None:
    solid = revolve([(0, 0), (0.1, 0), (0.1, 0.2), (0, 0.2)], 16)
    for chart, faces in charts_around(solid, 1, 2, 0.004, _ramp, np.random.default_rng(0)):
        outward = solid.mesh.face_normals[faces[0]]
        assert np.cross(chart.right_G, chart.down_G) @ -outward == pytest.approx(1.0)
        assert chart.down_G[2] == pytest.approx(-1.0)
        # The lower half of the wall is the lower, brighter half of the drawing.
        assert chart.image[-3].mean() > chart.image[2].mean()


def _hits(face: Ints, p_G: Array, normal_G: Array) -> Hits:
    n = len(face)
    return Hits(np.arange(n), face, np.full((n, 3), 1 / 3), np.zeros(n), p_G, normal_G, normal_G)


def _on_all_faces(body: Body, description: config.TargetBody) -> Surface:
    face = np.arange(len(body.mesh.faces))
    centres, normals = np.asarray(body.mesh.triangles_center), np.asarray(body.mesh.face_normals)
    return SurfaceAppearance(body, description, 0).at(_hits(face, centres, normals))


def test_a_layer_of_a_drawing_brings_its_own_material_and_slope() -> None:
    mesh = trimesh.creation.box([1.0, 1.0, 1.0])
    top = np.flatnonzero(mesh.face_normals[:, 2] > 0.9)
    image, layer = np.full((11, 11), 0.5, np.float32), np.zeros((11, 11), np.uint8)
    layer[:, 6:] = 1
    slope = np.full((11, 11, 2), 10, np.int8)
    corner, right, down = np.array([-0.5, 0.5, 0.5]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    chart = Chart(corner, right, down, 0.1, image, slope, layer, (GLASS,))
    body = assemble([Part(mesh, PAINT_GREY, ((chart, top),))])
    points = np.array([[-0.3, 0.0, 0.5], [0.3, 0.0, 0.5]])
    up = np.tile([0.0, 0.0, 1.0], (2, 1))
    appearance = SurfaceAppearance(body, config.TargetBody(contrast=0.0), 0)
    surface = appearance.at(_hits(top[[0, 0]], points, up))
    np.testing.assert_allclose(surface.specular, [PAINT_GREY.specular, GLASS.specular])
    # Without contrast there is the part's own reflectance everywhere.
    np.testing.assert_allclose(surface.albedo, PAINT_GREY.albedo)
    bent = np.array([-10 * SLOPE_STEP, 10 * SLOPE_STEP, 1.0])
    np.testing.assert_allclose(surface.normal_G[0], bent / np.linalg.norm(bent), atol=1e-9)


@cache
def _bus(material: str) -> tuple[Body, config.TargetBody]:
    description = config.TargetBody.model_validate({"family": "bus", "material": material, "seed": 4})
    return build_body(description, 0), description


def test_a_bus_all_in_foil_keeps_its_cells_and_regolith_covers_everything() -> None:
    body, description = _bus("foil")
    own = {body.materials[m] for m in np.unique(body.face_material)}
    assert own <= {FOIL_SILVER, SOLAR_CELL, GLASS} and FOIL_SILVER in own and SOLAR_CELL in own
    shiny = _on_all_faces(body, description).specular == FOIL_SILVER.specular
    assert body.mesh.area_faces[shiny].sum() > 0.2 * body.mesh.area
    body, _ = _bus("regolith")
    assert body.materials == (REGOLITH,) and body.charts == ()


@pytest.mark.parametrize("material", ["paint", "metal", "solar_cell"])
def test_other_materials_are_taken_too(material: str) -> None:
    body, description = _bus(material)
    surface = _on_all_faces(body, description)
    assert np.isfinite(surface.albedo).all() and len(body.charts) > 6


def test_the_two_generators_give_other_surfaces_on_one_shape() -> None:
    """Foil is where the noise differs most: the normals of half of its faces differ."""
    body, description = _bus("foil")
    other = description.model_copy(update={"texture": "collage"})
    one, two = (_on_all_faces(body, d) for d in (description, other))
    differ = np.abs(one.normal_G - two.normal_G).max(axis=1) > 1e-6
    assert differ.mean() > 0.5
