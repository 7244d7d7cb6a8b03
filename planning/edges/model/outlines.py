"""Outlines of smooth parts (occluding contours): the curve where the surface turns away from the viewer.

Hertzmann and Zorin, "Illustrating smooth surfaces", SIGGRAPH 2000: the zero of N . (p - eye) with normals and
positions interpolated over each face.

Under a small motion the outline slides over the surface, but only along the line of sight, which the
image does not show: its motion normal to the edge is that of the material point (tests/planning/edges).
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.model.edge_model import EdgeModel
from polhode.records import Ints


@dataclass(frozen=True)
class Outlines:
    """k short segments of outlines."""

    ends_G: Array
    """(k, 2, 3) [m]"""
    normals_G: Array
    """(k, 2, 3) unit, perpendicular to the line of sight"""
    part: Ints
    """(k,) smooth part"""
    bulge_m: Array
    """(k,) largest height of the smooth surface above the flat face"""


def outlines(model: EdgeModel, eye_G: Array) -> Outlines:
    """Outlines of the model's curved parts seen from eye_G (3,)."""
    return _of_facets(model, eye_G) if model.faceted else _of_smooth_surface(model, eye_G)


def _of_facets(model: EdgeModel, eye_G: Array) -> Outlines:
    """Edges between a face that points towards the eye and one that does not."""
    soft = model.soft[model.outlined_faces[model.soft[:, 2]]]
    triangles = np.asarray(model.surface.triangles)
    facing = np.einsum("fk,fk->f", np.asarray(model.surface.face_normals), eye_G - triangles[:, 0]) > 0.0
    soft = soft[facing[soft[:, 2]] != facing[soft[:, 3]]]
    ends = np.asarray(model.surface.vertices)[soft[:, :2]]
    across = np.cross((ends[:, 1] - ends[:, 0])[:, None, :], ends - eye_G)
    across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-300)
    outward = np.asarray(model.surface.face_normals)[soft[:, 2:]].sum(axis=1)
    across *= np.where(np.einsum("nek,nk->n", across, outward) < 0.0, -1.0, 1.0)[:, None, None]
    return Outlines(ends, across, np.asarray(model.part[soft[:, 2]]), np.zeros(len(soft)))


def _of_smooth_surface(model: EdgeModel, eye_G: Array) -> Outlines:
    faces = np.flatnonzero(model.outlined_faces)
    normals = model.corner_normals_G[faces]
    corners = np.asarray(model.surface.triangles)[faces]
    facing = np.einsum("fck,fck->fc", normals, corners - eye_G) > 0.0
    turning = facing.any(axis=1) & ~facing.all(axis=1)
    faces, normals, corners, facing = faces[turning], normals[turning], corners[turning], facing[turning]
    # The corner that is alone on its side: the outline crosses its two edges.
    alone = np.where(facing.sum(axis=1) == 1, np.argmax(facing, axis=1), np.argmax(~facing, axis=1))
    row = np.arange(len(faces))
    ends = np.zeros((len(faces), 2, 3))
    end_normals = np.zeros((len(faces), 2, 3))
    for side in 0, 1:
        other = (alone + 1 + side) % 3
        t = _crossing(
            corners[row, alone], corners[row, other], normals[row, alone], normals[row, other], eye_G
        )
        ends[:, side] = corners[row, alone] + t[:, None] * (corners[row, other] - corners[row, alone])
        n = normals[row, alone] + t[:, None] * (normals[row, other] - normals[row, alone])
        end_normals[:, side] = n / np.linalg.norm(n, axis=1, keepdims=True)
    chord, turn = corners - np.roll(corners, 1, axis=1), normals - np.roll(normals, 1, axis=1)
    bulge = np.abs(np.einsum("fck,fck->fc", chord, turn)).max(axis=1) / 8.0
    return Outlines(ends, end_normals, np.asarray(model.part[faces]), bulge)


def _crossing(a: Array, b: Array, normal_a: Array, normal_b: Array, eye_G: Array) -> Array:
    """Fraction (n,) from a to b where interpolated normal and ray to the point are perpendicular.

    (N_a + t dN) . (a - eye + t d) is quadratic in t, with one root between ends of opposite sign.
    """
    d, turn, from_eye = b - a, normal_b - normal_a, a - eye_G
    two = np.einsum("nk,nk->n", turn, d)
    one = np.einsum("nk,nk->n", turn, from_eye) + np.einsum("nk,nk->n", normal_a, d)
    zero = np.einsum("nk,nk->n", normal_a, from_eye)
    root = np.sqrt(np.maximum(one**2 - 4.0 * two * zero, 0.0))
    # numerically stable form of the two roots
    q = -0.5 * (one + np.where(one >= 0.0, root, -root))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = q / two, zero / q
    inside = (first >= 0.0) & (first <= 1.0)
    return np.asarray(np.clip(np.nan_to_num(np.where(inside, first, second)), 0.0, 1.0))
