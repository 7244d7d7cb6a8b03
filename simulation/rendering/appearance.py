"""The surface of a body where rays have met it: charts, colours of a mesh file, textures and materials."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.compiled import compiled
from polhode.config import scene as config
from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.bodies import Body
from polhode.simulation.bodies.part import SLOPE_STEP, Chart, packed_images
from polhode.simulation.surface.materials import MaterialTable, Surface


@dataclass(frozen=True)
class ChartSamples:
    """Values of the charts at n points."""

    reflectance: Array
    """(n,), NaN without a chart"""
    slope_G: Array
    """(n, 3) gradient of the relief, along the surface"""
    layer: Ints
    """(n,) 0: the part's own material; k: the chart's k-th"""


class ChartAtlas:
    """The charts of a body, packed into common buffers."""

    def __init__(self, charts: tuple[Chart, ...]) -> None:
        self._start, self._shape, self._texels = packed_images([chart.image for chart in charts])
        self._slopes = np.concatenate([np.zeros((0, 2), np.int8), *(_slopes(chart) for chart in charts)])
        self._layers = np.concatenate([np.zeros(0, np.uint8), *(_layers(chart) for chart in charts)])
        rows = [(c.origin_G, c.right_G / c.texel_m, c.down_G / c.texel_m) for c in charts]
        self._planes = np.array(rows, dtype=np.float64).reshape(-1, 3, 3)

    def look_up(self, chart: Ints, p_G: Array) -> ChartSamples:
        """Bilinear samples at points (n, 3) of charts (n,); chart -1: none."""
        places = (self._start, self._shape, self._planes)
        return ChartSamples(*_look_up(chart, p_G, *places, self._texels, self._slopes, self._layers))


def _slopes(chart: Chart) -> NDArray[np.int8]:
    shape = (chart.image.size, 2)
    return np.zeros(shape, np.int8) if chart.slope is None else chart.slope.reshape(shape)


def _layers(chart: Chart) -> NDArray[np.uint8]:
    return np.zeros(chart.image.size, np.uint8) if chart.layer is None else chart.layer.ravel()


@compiled
def _look_up(
    chart: Ints,
    p: Array,
    start: Ints,
    shape: Ints,
    planes: Array,
    texels: NDArray[np.float32],
    slopes: NDArray[np.int8],
    layers: NDArray[np.uint8],
) -> tuple[Array, Array, Ints]:
    count = len(chart)
    reflectance, slope = np.full(count, np.nan), np.zeros((count, 3))
    layer = np.zeros(count, np.int64)
    for n in range(count):
        c = chart[n]
        if c < 0:
            continue
        u, v = 0.0, 0.0
        for k in range(3):
            d = p[n, k] - planes[c, 0, k]
            u += d * planes[c, 1, k]
            v += d * planes[c, 2, k]
        height, width = shape[c]
        u = min(max(u, 0.0), width - 1.001)
        v = min(max(v, 0.0), height - 1.001)
        i, j = int(v), int(u)
        a, b = v - i, u - j
        at = start[c] + i * width + j
        weights = ((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b)
        places = (at, at + 1, at + width, at + width + 1)
        value, right, down = 0.0, 0.0, 0.0
        for corner in range(4):
            value += weights[corner] * texels[places[corner]]
            right += weights[corner] * slopes[places[corner], 0]
            down += weights[corner] * slopes[places[corner], 1]
        reflectance[n] = value
        layer[n] = layers[places[(2 if a > 0.5 else 0) + (1 if b > 0.5 else 0)]]
        if right != 0.0 or down != 0.0:
            # The axes of the planes are divided by the size of a texel, so their length gives it back.
            texel = 1.0 / np.sqrt(planes[c, 1, 0] ** 2 + planes[c, 1, 1] ** 2 + planes[c, 1, 2] ** 2)
            for k in range(3):
                slope[n, k] = SLOPE_STEP * texel * (right * planes[c, 1, k] + down * planes[c, 2, k])
    return reflectance, slope, layer


class SurfaceAppearance:
    """The surface of a body, evaluated by face and position."""

    def __init__(self, body: Body, description: config.TargetBody, seed: int) -> None:
        """``seed`` is used if the description has none."""
        self._body = body
        self._atlas = ChartAtlas(body.charts)
        surface_seed = seed if description.seed is None else description.seed
        self._materials = MaterialTable(
            body.materials,
            surface_seed,
            description.contrast,
            body.texture_scale,
            description.texture == "collage",
        )

    def evaluate(self, face: Ints, weights: Array, p_G: Array, normal_G: Array) -> Surface:
        """Surface at n hits.

        face (n,); weights (n, 3) of the face's corners; p_G (n, 3) [m]; normal_G (n, 3) unit, turned to the
        viewer.
        """
        body = self._body
        chart = body.face_chart[face]
        drawn = self._atlas.look_up(chart, p_G)
        ground = body.face_material[face]
        material = ground
        if body.chart_layers.shape[1] > 0:
            own = body.chart_layers[chart, np.maximum(drawn.layer - 1, 0)]
            material = np.where(drawn.layer > 0, own, ground)
        reflectance = drawn.reflectance
        if body.colours is not None:
            coloured = body.colours.look_up(face, weights)
            reflectance = np.where(np.isfinite(coloured), coloured, reflectance)
        return self._materials.evaluate(material, p_G, normal_G, reflectance, drawn.slope_G, ground)
