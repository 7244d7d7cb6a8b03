"""Profiles of grey levels that an image shows across control points (``planning/edges/stripe_profiles.py``).

Along the normal of the point the image is read as in ``edge_search.py``.
"""

import numpy as np

from benchmarks.edges.tracking.edge_search import Levels, levels
from polhode.lie import Array
from polhode.planning.edges.stripe_profiles import ALONG_PX, Displacements, fitted, places
from polhode.planning.edges.stripe_profiles import searched as searched_in
from polhode.planning.edges.stripes import Stripes
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.records import Bools


def profiles(image: Levels, points: ControlPoints, half_px: float) -> tuple[Array, Array]:
    """Places (n,) along the normals and grey levels (m, n) there, averaged along the edge."""
    place = places(half_px)
    along = np.arange(-ALONG_PX, ALONG_PX + 1)
    normal = points.normal_px
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    uv = points.uv_px[:, None, None] + place[None, :, None, None] * normal[:, None, None]
    uv = uv + along[None, None, :, None] * tangent[:, None, None]
    grey = levels(image, uv.reshape(-1, 2)).reshape(len(points), len(place), len(along))
    return place, np.asarray(grey.mean(axis=2))


def displacement(image: Levels, points: ControlPoints, stripes: Stripes, half_px: float) -> Displacements:
    """Of the edges nearest to where the model has them."""
    return fitted(*profiles(image, points, half_px), stripes)


def searched(image: Levels, points: ControlPoints, stripes: Stripes, range_px: float) -> tuple[Array, Bools]:
    """The displacement (m,) within a range that explains a profile best, and whether it explains it (m,)."""
    return searched_in(*profiles(image, points, range_px + 1.5), stripes, range_px)
