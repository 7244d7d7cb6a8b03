"""Outlines of smooth parts: the curve on the surface where it turns away from the viewer.

Hertzmann and Zorin, "Illustrating smooth surfaces", SIGGRAPH 2000: the zero of N . (p - eye) with normals and
places interpolated over each face.

Under a small motion the outline slides over the surface, but along the line of sight only, which the image
does not show: its motion across the edge is that of the material point (tests/planning/observability).
"""

from dataclasses import dataclass

import numpy as np

from planning.observability.edge_model import EdgeModel
from polhode.lie import Array
from polhode.records import Ints


@dataclass(frozen=True)
class Outlines:
    """k short pieces of outlines."""

    ends_G: Array
    """(k, 2, 3) [m]"""
    normals_G: Array
    """(k, 2, 3) unit, across the line of sight"""
    part: Ints
    """(k,) smooth part"""
    bulge_m: Array
    """(k,) how far the smooth surface may stand above the flat face"""


def outlines(model: EdgeModel, eye_G: Array) -> Outlines:
    """Outlines of the model's curved parts seen from eye_G (3,)."""
    faces = np.flatnonzero(model.outlined[model.part])
    normals = model.corner_normals_G[faces]
    corners = np.asarray(model.surface.triangles)[faces]
    facing = np.einsum("fck,fck->fc", normals, corners - eye_G) > 0.0
    turning = facing.any(axis=1) & ~facing.all(axis=1)
    faces, normals, corners, facing = faces[turning], normals[turning], corners[turning], facing[turning]
    # The corner that is alone on its side: the outline crosses the two edges that leave it.
    alone = np.where(facing.sum(axis=1) == 1, np.argmax(facing, axis=1), np.argmax(~facing, axis=1))
    row = np.arange(len(faces))
    ends = np.zeros((len(faces), 2, 3))
    found = np.zeros((len(faces), 2, 3))
    for side in 0, 1:
        other = (alone + 1 + side) % 3
        t = _crossing(
            corners[row, alone], corners[row, other], normals[row, alone], normals[row, other], eye_G
        )
        ends[:, side] = corners[row, alone] + t[:, None] * (corners[row, other] - corners[row, alone])
        n = normals[row, alone] + t[:, None] * (normals[row, other] - normals[row, alone])
        found[:, side] = n / np.linalg.norm(n, axis=1, keepdims=True)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    lean = np.einsum("fck,fck->fc", normals, np.roll(normals, 1, axis=1)).min(axis=1)
    bulge = longest * np.arccos(np.clip(lean, -1.0, 1.0)) / 8.0
    return Outlines(ends, found, np.asarray(model.part[faces]), bulge)


def _crossing(a: Array, b: Array, normal_a: Array, normal_b: Array, eye_G: Array) -> Array:
    """Where (n,) from a to b the interpolated normal is across the ray to the interpolated place, 0 to 1.

    (N_a + t dN) . (a - eye + t d) is quadratic in t, with one zero between ends of unlike sign.
    """
    d, turn, from_eye = b - a, normal_b - normal_a, a - eye_G
    two = np.einsum("nk,nk->n", turn, d)
    one = np.einsum("nk,nk->n", turn, from_eye) + np.einsum("nk,nk->n", normal_a, d)
    zero = np.einsum("nk,nk->n", normal_a, from_eye)
    root = np.sqrt(np.maximum(one**2 - 4.0 * two * zero, 0.0))
    # The stable pair of roots.
    q = -0.5 * (one + np.where(one >= 0.0, root, -root))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = q / two, zero / q
    inside = (first >= 0.0) & (first <= 1.0)
    return np.asarray(np.clip(np.nan_to_num(np.where(inside, first, second)), 0.0, 1.0))
