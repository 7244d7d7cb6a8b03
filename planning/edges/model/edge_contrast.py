"""Which edges have contrast in sunlight: what lies on both sides of an edge, Lambert, with shadows.

Seen from the eye, each side of an edge is a face of the body or the black sky. A face that looks at the Sun
and is not in shadow has the radiance n . s, of 1 for a white face across the sunlight. An edge between equal
radiances is not in the image, whatever its angle. Where one side is another part of the body farther behind,
the sky is taken in its place.
"""

from dataclasses import replace

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.model.edge_model import EdgeKind, EdgeModel
from polhode.planning.edges.model.visible_edges import ControlPoints

HALF_CONTRAST = 0.1
"""Contrast at which noise of the image and the floor (blur, model) displace an edge by equal parts."""
MIN_WEIGHT = 0.01
"""Points that would count less are left out."""


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
    # an open sheet is seen from behind, too
    normals = np.where((rim[:, None] & (facing < 0.0))[..., None], -points.sides_G, points.sides_G)
    crease = on_segment & ~rim
    seen = np.where(crease[:, None], facing > 0.0, [True, False])
    # into the open, between the two sides: there both of them are in the light, or neither
    outward = np.where(crease[:, None], normals.sum(axis=1), normals[:, 0])
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    start = points.p_G + 3.0 * model.tolerance_m * outward
    lit = ~model.occluder.shades(sun, start, 0.5 * model.tolerance_m)
    radiance = np.where(seen & lit[:, None], np.maximum(normals @ sun, 0.0), 0.0)
    return np.asarray(np.abs(radiance[:, 0] - radiance[:, 1]))


def contrast_weight(contrast: Array, half: float = HALF_CONTRAST) -> Array:
    """Information (m,) of an edge, as a share of that with full contrast.

    White noise of the image displaces an edge in inverse proportion to its contrast c; blur and model add a
    floor: sigma^2 = floor^2 (1 + (half / c)^2).
    """
    square = np.asarray(contrast) ** 2
    return np.asarray(square / (square + half**2))


def in_sunlight(
    model: EdgeModel, points: ControlPoints, eye_G: Array, sun_G: Array, half: float = HALF_CONTRAST
) -> ControlPoints:
    """The points that have contrast, their weights multiplied by what the contrast leaves of them."""
    share = contrast_weight(contrast(model, points, eye_G, sun_G), half)
    return replace(points, weight=points.weight * share)[share >= MIN_WEIGHT]
