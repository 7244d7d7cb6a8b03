"""Profiles of grey levels that an image shows across control points (``planning/edges/stripe_profiles.py``).

Along the normal of the point the image is read as in ``edge_search.py``.
"""

import numpy as np

from benchmarks.edges.tracking.edge_search import Levels, level
from polhode.compiled import compiled_ieee
from polhode.lie import Array
from polhode.planning.edges.stripe_profiles import ALONG_PX, Displacements, fitted, places
from polhode.planning.edges.stripe_profiles import searched as searched_in
from polhode.planning.edges.stripes import Stripes
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.records import Bools


def profiles(image: Levels, points: ControlPoints, half_px: float) -> tuple[Array, Array]:
    """Places (n,) along the normals and grey levels (m, n) there, averaged along the edge."""
    place = places(half_px)
    grey = np.empty((len(points), len(place)))
    _read(image, points.uv_px, points.normal_px, place, grey)
    return place, grey


@compiled_ieee
def _read(image: Levels, uv: Array, normal: Array, place: Array, out: Array) -> None:
    for i in range(len(uv)):
        nu, nv = normal[i, 0], normal[i, 1]
        for k in range(len(place)):
            u, v = uv[i, 0] + place[k] * nu, uv[i, 1] + place[k] * nv
            total = 0.0
            for along in range(-ALONG_PX, ALONG_PX + 1):
                total += level(image, u - along * nv, v + along * nu)
            out[i, k] = total / (2 * ALONG_PX + 1)


def displacement(image: Levels, points: ControlPoints, stripes: Stripes, half_px: float) -> Displacements:
    """Of the edges nearest to where the model has them."""
    return fitted(*profiles(image, points, half_px), stripes)


def searched(image: Levels, points: ControlPoints, stripes: Stripes, range_px: float) -> tuple[Array, Bools]:
    """The displacement (m,) within a range that explains a profile best, and whether it explains it (m,)."""
    return searched_in(*profiles(image, points, range_px + 1.5), stripes, range_px)
