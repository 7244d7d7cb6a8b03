"""The surface of a body where rays have met it: charts, colours of a mesh file, textures and materials."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled
from polhode.simulation.bodies import Body, texture_seed
from polhode.simulation.bodies.part import SLOPE_STEP, Chart, packed_images
from polhode.simulation.rendering.raycast import Hits
from polhode.simulation.surface.materials import MaterialTable, Surface


class ChartAtlas(NamedTuple):
    """The charts of a body, packed into common buffers of T texels; C charts."""

    start: Ints
    """(C + 1,) first texel of each chart"""
    shape: Ints
    """(C, 2) rows and columns"""
    planes: Array
    """(C, 3, 3) origin [m], and the axes to the right and down over the size of a texel"""
    reflectance: NDArray[np.float32]
    """(T,)"""
    slopes: NDArray[np.int8]
    """(T, 2) in SLOPE_STEP"""
    layers: NDArray[np.uint8]
    """(T,)"""


def chart_atlas(charts: tuple[Chart, ...]) -> ChartAtlas:
    """Pack charts; those without relief or layers are flat, of the part's own material."""
    start, shape, texels = packed_images([chart.image for chart in charts])
    slopes, layers = np.zeros((len(texels), 2), np.int8), np.zeros(len(texels), np.uint8)
    for chart, first in zip(charts, start, strict=False):
        here = slice(first, first + chart.image.size)
        if chart.slope is not None:
            slopes[here] = chart.slope.reshape(-1, 2)
        if chart.layer is not None:
            layers[here] = chart.layer.ravel()
    rows = [(c.origin_G, c.right_G / c.texel_m, c.down_G / c.texel_m) for c in charts]
    planes = np.array(rows, dtype=np.float64).reshape(-1, 3, 3)
    return ChartAtlas(start, shape, planes, texels, slopes, layers)


@compiled
def look_up(chart: Ints, p: Array, atlas: ChartAtlas) -> tuple[Array, Array, Ints]:
    """Bilinear samples at points (n, 3) of charts (n,), -1: none.

    Returns the reflectance (n,), NaN without a chart; the gradient (n, 3) of the relief, along the surface;
    and the layer (n,), 0: the part's own material, k: the chart's k-th.
    """
    planes = atlas.planes
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
        height, width = atlas.shape[c]
        u = min(max(u, 0.0), width - 1.001)
        v = min(max(v, 0.0), height - 1.001)
        i, j = int(v), int(u)
        a, b = v - i, u - j
        at = atlas.start[c] + i * width + j
        weights = ((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b)
        places = (at, at + 1, at + width, at + width + 1)
        value, right, down = 0.0, 0.0, 0.0
        for corner in range(4):
            value += weights[corner] * atlas.reflectance[places[corner]]
            right += weights[corner] * atlas.slopes[places[corner], 0]
            down += weights[corner] * atlas.slopes[places[corner], 1]
        reflectance[n] = value
        layer[n] = atlas.layers[places[(2 if a > 0.5 else 0) + (1 if b > 0.5 else 0)]]
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
        self._atlas = chart_atlas(body.charts)
        self._materials = MaterialTable(
            body.materials,
            texture_seed(description, seed),
            description.contrast,
            body.texture_scale,
            description.texture == "collage",
        )

    def at(self, hits: Hits) -> Surface:
        """Surface at n hits."""
        body, face, p_G = self._body, hits.face, hits.p_G
        chart = body.face_chart[face]
        reflectance, slope_G, layer = look_up(chart, p_G, self._atlas)
        ground = body.face_material[face]
        material = ground
        if body.chart_layers.shape[1] > 0:
            own = body.chart_layers[chart, np.maximum(layer - 1, 0)]
            material = np.where(layer > 0, own, ground)
        if body.colours is not None:
            coloured = body.colours.look_up(face, hits.weights)
            reflectance = np.where(np.isfinite(coloured), coloured, reflectance)
        return self._materials.evaluate(material, p_G, hits.normal_G, reflectance, slope_G, ground)
