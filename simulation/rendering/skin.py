"""The surface of a body at points where rays have met it: drawings, file colours, textures and materials."""

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.bodies import Body
from polhode.simulation.rendering.charts import ChartAtlas
from polhode.simulation.surface.materials import MaterialTable, Surface


class Skin:
    """All that light meets on a body, looked up by face and position."""

    def __init__(self, body: Body, description: config.Body, seed: int) -> None:
        """``seed`` serves where the description has none."""
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
