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

from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.planning.edges.visible_edges import ControlPoints

LINES = 6
"""Stripes across a point that are kept, the nearest"""
SAMPLED_PX = 2.0
"""Spacing of the points of all edges that are looked for across a point"""
_ALONG_PX = 1.3 * SAMPLED_PX
HALF_PX = 3.0
"""What lies within this of a control point, along its normal, is measured by it."""
UNIFORM_SIGMA = 1.0 / np.sqrt(12.0)
"""Standard deviation of a place within a stripe of width 1"""
FLOOR_PX = 0.05
"""Sigma of an edge's place in an image however clear it is: blur, pixels, errors of the model
(docs/observability.md)"""
MAX_SIGMA_PX, MAX_SHIFT_PX = 0.6, 2.5
"""Points that are less certain, or farther off, do not count."""
TUKEY, CAUCHY = 4.685, 2.385
"""Widths in sigmas: 95 % efficient for Gaussian noise (Huber and Ronchetti, Robust Statistics, 2009)"""


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
    curved: Bools
    """(m,) whether the point is on the outline of a curved surface, which lies behind it along its normal"""

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
    offset, width, slope = _lines_across(points, every, reach_px)
    # an outline has the same normal on both sides, perpendicular to the line of sight
    alike = (points.sides_G[:, 0] == points.sides_G[:, 1]).all(axis=1)
    ray = points.p_G - inverse_pose(X_RG)[:3, 3]
    sine = np.einsum("mk,mk->m", points.sides_G[:, 0], ray) / np.linalg.norm(ray, axis=1)
    # the line of sight grazes the surface where its outline is
    return Stripes(offset, width, slope, light, side, np.asarray(alike & (np.abs(sine) < 0.02)))


def _lines_across(points: ControlPoints, every: ControlPoints, reach_px: float) -> Array:
    """Offset, width and slope (3, m, LINES) of the nearest stripes."""
    out = np.full((3, len(points), LINES), np.nan)
    if len(points) == 0:
        return out
    # pairs of points and what may lie across them: in a column of the image, then along the normal
    radius, order = np.hypot(reach_px, _ALONG_PX), np.argsort(every.uv_px[:, 0])
    u = every.uv_px[order, 0]
    first = np.searchsorted(u, points.uv_px[:, 0] - radius)
    count = np.searchsorted(u, points.uv_px[:, 0] + radius, side="right") - first
    point = np.repeat(np.arange(len(points)), count)
    other = order[np.arange(len(point)) - np.repeat(np.cumsum(count) - count - first, count)]
    (du, dv), (n0, n1) = (every.uv_px[other] - points.uv_px[point]).T, points.normal_px[point].T
    o0, o1 = every.normal_px[other].T
    along, cosine = n0 * dv - n1 * du, o0 * n0 + o1 * n1
    tangent = (n0 * o1 - n1 * o0) / np.where(cosine == 0.0, 1.0, cosine)
    there = du * n0 + dv * n1 + along * tangent
    # edges at less than 53 degrees to each other
    near = (np.abs(along) < _ALONG_PX) & (np.abs(cosine) >= 0.6) & (np.abs(there) <= reach_px)
    # with the point's own line, in ascending order for each point
    own = np.arange(len(points))
    point = np.concatenate([own, point[near]])
    there = np.concatenate([0.0 * own, there[near]])
    slope = np.concatenate([0.0 * own, np.abs(tangent[near])])
    order = np.lexsort((there, point))
    point, there, slope = point[order], there[order], slope[order]
    # edges nearer to each other than a pixel are one stripe
    begins = np.append(True, (np.diff(point) > 0) | (np.diff(there) > 1.0))
    first, last = np.flatnonzero(begins), np.flatnonzero(np.append(begins[1:], True))
    middle, owner = 0.5 * (there[first] + there[last]), point[first]
    stripes = np.stack([middle, there[last] - there[first], np.maximum.reduceat(slope, first)])
    # the nearest ones, in ascending order of their distance
    order = np.lexsort((np.abs(middle), owner))
    owner = owner[order]
    rank = np.arange(len(owner)) - np.searchsorted(owner, owner)
    kept = rank < LINES
    out[:, owner[kept], rank[kept]] = stripes[:, order[kept]]
    return out


def light_classes(points: ControlPoints, X_RG: Array) -> tuple[Ints, Array]:
    """Classes (m,) of points whose surfaces face alike, and the sign (m,) of their normals within them."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    # normals that agree to an eighth are alike
    facing = np.round(points.sides_G * 8.0).astype(np.int64)
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


def times_measured(points: ControlPoints, own: ControlPoints) -> Array:
    """(m,) how many stripes of the model a point's profile shows: points of each of them measure them all.

    ``own``: points of all edges of the model, ``SAMPLED_PX`` apart.
    """
    offset_px = _lines_across(points, own, HALF_PX)[0]
    return np.asarray(np.isfinite(offset_px).sum(axis=1), dtype=np.float64)


@dataclass(frozen=True)
class MeasuredStripes:
    """The stripes across m control points, measured."""

    stripes: Stripes
    f: Array
    """(m, 6) motion across the edges"""
    shift_px: Array
    """(m,) from the model to the image"""
    sigma_px: Array
    """(m,)"""
    spread_px: Array
    """(m,) sigma of the place within the stripe, with the sign of ``Stripes.side``"""
    counts: Bools
    """(m,) whether the point has a measurement"""
    length: Array
    """(m,) of edge that the point stands for, over the spacing, less what other points measure, too"""

    def residual(self, place: Array) -> Array:
        """(m,) in sigmas, with places (classes,) of the steps in their stripes."""
        return np.asarray((self.shift_px - self.spread_px * place[self.stripes.light]) / self.sigma_px)

    def normal_equations(self, place: Array, narrow: bool) -> tuple[StripeInformation, Array, float]:
        """Normal equations, robust weights (m,) of the points without the scale, and the scale.

        ``place`` (classes,): of the steps in their stripes, for the weights.
        """
        residual = np.where(self.counts, self.residual(place), 0.0)
        length = self.length / self.sigma_px**2
        size, share = np.abs(residual[self.counts]), length[self.counts]
        order = np.argsort(size)
        half = int(np.searchsorted(np.cumsum(share[order]), 0.5 * float(share.sum())))
        # the median of the absolute values, times 1.4826 for Gaussian noise
        scale = max(1.4826 * float(size[order[min(half, len(size) - 1)]]), 1.0)
        u = residual / scale
        # Tukey's weights forget what is far off; Cauchy's, until the pose is near, do not
        tukey = np.where(np.abs(u) < TUKEY, (1.0 - (u / TUKEY) ** 2) ** 2, 0.0)
        weight = length * (tukey if narrow else 1.0 / (1.0 + (u / CAUCHY) ** 2)) * self.counts
        return self.weighted(weight / scale**2), weight, scale

    def weighted(self, weight: Array) -> StripeInformation:
        """Normal equations with given weights (m,) [px^-2]."""
        stripes = self.stripes
        return stripe_information(
            self.f, self.shift_px, weight, self.spread_px, stripes.light, stripes.classes
        )

    def settled_places(self) -> Array:
        """(classes,) of the steps in their stripes at the pose itself, found by turns with the weights."""
        place = np.zeros(self.stripes.classes)
        for _ in range(3):
            equations, _, _ = self.normal_equations(place, narrow=True)
            place = equations.places(np.zeros(6))
        return place
