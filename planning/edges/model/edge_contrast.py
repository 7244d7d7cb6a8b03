"""Contrast of edges in sunlight: radiance on both sides of an edge, Lambertian, with shadows.

Seen from the eye, each side of an edge is a face of the body or the black sky. A face that is turned to
the Sun and not in shadow has the radiance n . s, 1 for a white face normal to the sunlight. An edge
between equal radiances is invisible in the image, whatever its angle. Where one side is a more
distant part of the body, the sky is assumed instead.
"""

from dataclasses import replace

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.model.edge_model import EdgeKind, EdgeModel
from polhode.planning.edges.model.visible_edges import ControlPoints

HALF_CONTRAST = 0.1
"""Contrast at which image noise and the error floor (blur, model) displace an edge equally."""
MIN_WEIGHT = 0.01
"""Points with a smaller weight are omitted."""


def contrast(model: EdgeModel, points: ControlPoints, eye_G: Array, sun_G: Array) -> Array:
    """(m,) difference of radiance across the edge at each point, 0 to 1; sun_G (3,) towards the Sun."""
    if len(points) == 0:
        return np.zeros(0)
    sun = sun_G / np.linalg.norm(sun_G)
    segments = len(model.ends_G)
    rim = np.zeros(len(points), dtype=bool)
    on_segment = points.feature < segments
    rim[on_segment] = model.kind[points.feature[on_segment]] == EdgeKind.BOUNDARY
    facing = np.einsum("msk,mk->ms", points.sides_G, eye_G - points.p_G)
    # an open sheet is also visible from behind
    normals = np.where((rim[:, None] & (facing < 0.0))[..., None], -points.sides_G, points.sides_G)
    crease = on_segment & ~rim
    seen = np.where(crease[:, None], facing > 0.0, [True, False])
    # outwards, between the two sides, where both are lit or both in shadow
    outward = np.where(crease[:, None], normals.sum(axis=1), normals[:, 0])
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    start = points.p_G + 3.0 * model.tolerance_m * outward
    lit = ~model.occluder.shades(sun, start, 0.5 * model.tolerance_m)
    radiance = np.where(seen & lit[:, None], np.maximum(normals @ sun, 0.0), 0.0)
    return np.asarray(np.abs(radiance[:, 0] - radiance[:, 1]))


def contrast_weight(contrast: Array, half: float = HALF_CONTRAST) -> Array:
    """Information (m,) of an edge, relative to that at full contrast.

    White image noise displaces an edge in inverse proportion to its contrast c; blur and model add a
    floor: sigma^2 = floor^2 (1 + (half / c)^2).
    """
    square = np.asarray(contrast) ** 2
    return np.asarray(square / (square + half**2))


def in_sunlight(
    model: EdgeModel, points: ControlPoints, eye_G: Array, sun_G: Array, half: float = HALF_CONTRAST
) -> ControlPoints:
    """The points that have contrast, their weights multiplied by `contrast_weight`."""
    share = contrast_weight(contrast(model, points, eye_G, sun_G), half)
    return replace(points, weight=points.weight * share)[share >= MIN_WEIGHT]
