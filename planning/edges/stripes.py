"""Stripes: edges that lie side by side in the image, nearer to each other than it can tell apart.

A bevel, or the rim of a panel, shows two or more parallel edges within a pixel or two. Where exactly the
light changes between them depends on the light, which is not known: an image shows one step somewhere within
the stripe. Edges that are farther apart are steps of their own, in a known distance: together with them, an
edge is found where alone it would be mistaken for its neighbour.

How far across a stripe the step lies is the same for all stripes whose sides face alike, as the light falls
on them alike. It is no independent error of each control point, however many there are, but one unknown for
each class of stripes (``light_classes``).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from polhode.lie import Array
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.records import Ints

LINES = 6
"""Stripes across a point that are kept, the nearest"""
JOINED_PX = 1.0
"""Edges that are nearer to each other are one stripe."""
SAMPLED_PX = 2.0
"""Spacing of the points of all edges that are looked for across a point"""
_ALONG_PX = 1.3 * SAMPLED_PX
_STEEPEST = 0.6
"""Cosine of the largest angle between two edges of which one is looked for across the other"""
_ALIKE = 8.0
"""Normals that agree to one part in so many are alike."""
UNIFORM = 1.0 / np.sqrt(12.0)
"""Standard deviation of a place within a stripe of width 1"""


@dataclass(frozen=True)
class Stripes:
    """What lies across m control points, along their normals: up to ``LINES`` stripes; NaN where fewer."""

    offset_px: Array
    """(m, LINES) from the point to the middle of the stripe"""
    width_px: Array
    """(m, LINES) from its first edge to its last; 0: one edge"""
    slope: Array
    """(m, LINES) tangent of the angle between its edges and the point's"""
    light: Ints
    """(m,) class of points whose surfaces face alike, 0 to classes - 1"""
    side: Array
    """(m,) 1 or -1: which way across the stripe the normal of the point leads, the same within a class"""

    @property
    def classes(self) -> int:
        """Number of classes."""
        return int(self.light.max()) + 1 if len(self.light) else 0


def stripes_across(points: ControlPoints, every: ControlPoints, X_RG: Array, reach_px: float) -> Stripes:
    """What lies within ``reach_px`` across control points of a view at X_RG (4, 4).

    ``every``: points of all edges that are known there, ``SAMPLED_PX`` apart. Each point is on a line of
    its own, whether or not that is among them.
    """
    light, side = light_classes(points, X_RG)
    out = np.full((3, len(points), LINES), np.nan)
    if len(points) == 0:
        return Stripes(out[0], out[1], out[2], light, side)
    row, offset, slope = _crossings(points, every, reach_px)
    order = np.lexsort((offset, row))
    row, offset, slope = row[order], offset[order], slope[order]
    first = np.ones(len(row), dtype=bool)
    first[1:] = (np.diff(row) != 0) | (np.diff(offset) > JOINED_PX)
    start = np.flatnonzero(first)
    last = np.append(start[1:], len(row)) - 1
    owner, middle = row[start], 0.5 * (offset[start] + offset[last])
    width, tilt = offset[last] - offset[start], np.maximum.reduceat(slope, start)
    order = np.lexsort((np.abs(middle), owner))
    owner, middle, width, tilt = owner[order], middle[order], width[order], tilt[order]
    place = np.arange(len(owner)) - np.searchsorted(owner, owner)
    kept = place < LINES
    out[:, owner[kept], place[kept]] = middle[kept], width[kept], tilt[kept]
    return Stripes(out[0], out[1], out[2], light, side)


def _crossings(points: ControlPoints, every: ControlPoints, reach_px: float) -> tuple[Ints, Array, Array]:
    """Point (k,), offset along its normal (k,) and slope (k,) of each sample of an edge that crosses it."""
    own = np.arange(len(points))
    if len(every) == 0:
        return own, np.zeros(len(own)), np.zeros(len(own))
    near = cKDTree(every.uv_px).query_ball_point(points.uv_px, np.hypot(reach_px, _ALONG_PX))
    row = np.repeat(own, [len(each) for each in near])
    other = np.concatenate([np.asarray(each, dtype=np.int64) for each in near])
    gap = every.uv_px[other] - points.uv_px[row]
    normal = points.normal_px[row]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    across, along = np.einsum("kd,kd->k", gap, normal), np.einsum("kd,kd->k", gap, tangent)
    cosine = np.einsum("kd,kd->k", every.normal_px[other], normal)
    sine = np.einsum("kd,kd->k", every.normal_px[other], tangent)
    steep = np.abs(cosine) < _STEEPEST
    cosine = np.where(steep, 1.0, cosine)
    offset = across + along * sine / cosine
    kept = ~steep & (np.abs(along) < _ALONG_PX) & (np.abs(offset) <= reach_px)
    row = np.concatenate([row[kept], own])
    none = np.zeros(len(own))
    return row, np.concatenate([offset[kept], none]), np.concatenate([np.abs(sine / cosine)[kept], none])


def light_classes(points: ControlPoints, X_RG: Array) -> tuple[Ints, Array]:
    """Classes (m,) of points whose surfaces face alike, and the sign (m,) of their normals within them."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    facing = np.round(points.sides_G * _ALIKE).astype(np.int64)
    behind, before = facing[:, 0], facing[:, 1]
    differs = behind != before
    which = np.argmax(differs, axis=1)
    row = np.arange(len(points))
    swapped = differs.any(axis=1) & (behind[row, which] > before[row, which])
    ordered = np.where(swapped[:, None, None], facing[:, ::-1], facing).reshape(len(points), 6)
    _, light = np.unique(ordered, axis=0, return_inverse=True)
    turn = points.sides_G[:, 1] - points.sides_G[:, 0]
    turn_px = np.where(swapped[:, None], -turn, turn) @ X_RG[:3, :3].T
    side = np.where(np.einsum("md,md->m", turn_px[:, :2], points.normal_px) < 0.0, -1.0, 1.0)
    return np.asarray(light.reshape(-1), dtype=np.int64), side


@dataclass(frozen=True)
class StripeInformation:
    """What distances to stripes tell of a motion: normal equations without the places in the stripes."""

    C: Array
    """(6, 6)"""
    pull: Array
    """(6,) C times the step that fits best"""
    reach: Array
    """(classes, 6) change of each class's place by a step"""
    place: Array
    """(classes,) of a step of zero, in sigmas of the place"""

    def places(self, step: Array) -> Array:
        """(classes,) where in their stripes the steps of light lie after a step (6,), in their sigmas."""
        return np.asarray(self.place - self.reach @ step)


def stripe_information(
    f: Array, distance_px: Array, weight: Array, spread_px: Array, light: Ints, classes: int
) -> StripeInformation:
    """Information on the six generators from distances (m,) with motions f (m, 6) and weights (m,) [px^-2].

    ``spread_px`` (m,): sigma of the place within the stripe, with the sign of ``Stripes.side``; the places
    of a class are one unknown, which the data and its prior (0 +- 1 sigma) determine together, and which is
    eliminated (Schur complement).
    """
    coupled = weight * spread_px
    own = 1.0 + np.bincount(light, coupled * spread_px, classes)
    g = np.zeros((classes, 6))
    np.add.at(g, light, coupled[:, None] * f)
    r = np.bincount(light, coupled * distance_px, classes)
    C = (f * weight[:, None]).T @ f - (g / own[:, None]).T @ g
    pull = f.T @ (weight * distance_px) - g.T @ (r / own)
    return StripeInformation(C, pull, g / own[:, None], r / own)
