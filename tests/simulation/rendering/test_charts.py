"""Drawings on flat faces and around walls, read back where light would meet them."""

import numpy as np
import pytest

from polhode.lie import Array
from polhode.simulation.bodies.parts.facets import flat_facets
from polhode.simulation.bodies.parts.part import SLOPE_STEP, Chart
from polhode.simulation.bodies.parts.solids import box, revolve
from polhode.simulation.bodies.textures.canvas import Canvas, chart_of_facet, charts_around, code
from polhode.simulation.rendering.charts import ChartAtlas
from polhode.simulation.surface.materials import FOIL_GOLD, GLASS

TEXEL_M = 0.001
RIGHT, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])


def _chart(**more: object) -> Chart:
    image = np.linspace(0.1, 0.9, 20, dtype=np.float32).reshape(4, 5)
    return Chart(np.array([0.1, 0.2, 0.3]), RIGHT, DOWN, TEXEL_M, image, **more)  # type: ignore[arg-type]


def _at(chart: Chart, row: float, column: float) -> Array:
    return np.asarray(chart.origin_G + TEXEL_M * (column * chart.right_G + row * chart.down_G))[None]


def test_reflectance_is_interpolated_between_texels() -> None:
    chart = _chart()
    atlas = ChartAtlas((chart,))
    read = atlas.look_up(np.zeros(1, np.int64), _at(chart, 1.25, 2.5)).reflectance[0]
    (a, b), (c, d) = chart.image[1:3, 2:4]
    assert read == pytest.approx(0.75 * (0.5 * a + 0.5 * b) + 0.25 * (0.5 * c + 0.5 * d), abs=1e-6)


def test_a_relief_is_turned_into_the_charts_axes() -> None:
    slope = np.zeros((4, 5, 2), np.int8)
    slope[..., 0], slope[..., 1] = 30, -20
    drawn = ChartAtlas((_chart(slope=slope),)).look_up(np.zeros(1, np.int64), _at(_chart(), 1, 1))
    np.testing.assert_allclose(drawn.slope_G[0], SLOPE_STEP * (30 * RIGHT - 20 * DOWN), atol=1e-12)


def test_layers_are_those_of_the_nearest_texel() -> None:
    layer = np.zeros((4, 5), np.uint8)
    layer[1, 2] = 2
    chart = _chart(layer=layer, materials=(GLASS, FOIL_GOLD))
    points = np.vstack([_at(chart, 1.4, 2.4), _at(chart, 1.6, 2.4), _at(chart, 1.4, 1.4)])
    drawn = ChartAtlas((chart,)).look_up(np.array([0, 0, 0]), points)
    np.testing.assert_array_equal(drawn.layer, [2, 0, 0])


def test_points_without_a_chart_have_no_drawing() -> None:
    drawn = ChartAtlas((_chart(),)).look_up(np.array([-1]), np.zeros((1, 3)))
    assert np.isnan(drawn.reflectance[0]) and not drawn.slope_G.any() and drawn.layer[0] == 0


def test_rows_run_along_the_direction_that_is_asked_for() -> None:
    mesh = box([0.1, 0.2, 0.3], bevel=0.0)
    faces = next(f for f in flat_facets(mesh) if mesh.face_normals[f[0], 0] > 0.99)
    chart, _ = chart_of_facet(mesh, faces, 0.005, lambda canvas, rng: None, np.random.default_rng(0), DOWN)
    np.testing.assert_allclose(chart.down_G, DOWN, atol=1e-12)
    # Seen from outside, +x towards the viewer and z up, right is +y.
    np.testing.assert_allclose(chart.right_G, RIGHT, atol=1e-12)


def _ramp(canvas: Canvas, rng: np.random.Generator) -> None:
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
    atlas = ChartAtlas(tuple(chart for chart, _ in charts))
    number = np.arange(24)
    for share in (0.2, 0.45, 0.8):
        edges = solid.mesh.triangles[solid.panels[1, :, 0]][:, 1]
        ends = solid.mesh.triangles[solid.panels[1, :, 0]][:, 2]
        points = edges + share * (ends - edges)
        # The edge at the end of panel k is the start of panel k + 1.
        one = atlas.look_up(number, points).reflectance
        other = atlas.look_up((number + 1) % 24, points).reflectance
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
