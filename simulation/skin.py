"""The surface of a body at points where rays have met it: drawings, textures and materials together."""

from polhode.config import scene as config
from polhode.lie import Array
from polhode.records import Ints
from simulation.bodies import Body
from simulation.charts import ChartAtlas
from simulation.materials import MaterialTable, Surface


class Skin:
    """All that light meets on a body, looked up by face and position."""

    def __init__(self, body: Body, description: config.Body, seed: int) -> None:
        """``seed`` serves where the description has none."""
        self._body = body
        self._atlas = ChartAtlas(body.charts)
        surface_seed = seed if description.seed is None else description.seed
        self._materials = MaterialTable(body.materials, surface_seed, description.contrast)

    def evaluate(self, face: Ints, weights: Array, p_G: Array, normal_G: Array) -> Surface:
        """Surface at n hits.

        face (n,); weights (n, 3) of the face's corners; p_G (n, 3) [m]; normal_G (n, 3) unit, turned to the
        viewer.
        """
        drawn = self._atlas.reflectance(self._body.face_chart[face], p_G)
        return self._materials.evaluate(self._body.face_material[face], p_G, normal_G, drawn)
