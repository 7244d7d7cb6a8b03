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
from scipy.special import ndtr

from polhode.camera import RectifiedRig
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import EdgeObservability, edge_motion
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point
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


FLOOR_PX = 0.07
"""Sigma of an edge's place in an image however clear it is: blur, pixels, errors of the model
(docs/observability_tracking.md: the slope of the trends)"""
BLUR_PX = 0.95
"""Sigma of an edge in a profile: a lens of 0.8, a pixel, and its interpolation"""
HALF_PX, STEP_PX = 3.0, 0.5
"""Half of a profile, and the distance of its samples"""
NOISE = 0.005
"""Of a profile, over the largest step of light: a grey level of 100 in each pixel, and the mean of five"""
RIDGE = 1e-3
"""Of the normal equations of the heights of steps, so that equal columns do no harm"""
DRAWS = 16
_SEED = 28


def stripe_observability(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    known: EdgeModel | None = None,
    floor_px: float = FLOOR_PX,
) -> EdgeObservability:
    """The metric where edges lie side by side, for edges found to ``floor_px`` where they stand alone.

    C [m^-2, m^-1 rad^-1, rad^-2] is here the inverse of the covariance itself. A point weighs as much as its
    profile will tell of a displacement when the steps of light are unknown, and the places in the stripes are
    one unknown for each class of them (``stripe_information``). How light the surfaces are, nobody knows
    beforehand: the information is a mean over a few draws. ``known``: the body's edges beside the model's.
    """
    points = control_points(model, rig, X_RG, SPACING_PX)
    own = every_point(model, rig, X_RG, SAMPLED_PX)
    every = own if known is None else every_point(known, rig, X_RG, SAMPLED_PX)
    stripes = stripes_across(points, every, X_RG, HALF_PX + 2.0)
    information, spread_px = expected_profiles(stripes, floor_px)
    f = edge_motion(points, rig, X_RG, model.centre_G)
    weight = points.weight * information / times_measured(points, own, X_RG)
    told = stripe_information(
        f, np.zeros(len(f)), weight, stripes.side * spread_px, stripes.light, stripes.classes
    )
    return EdgeObservability(told.C, model.radius_m, len(points))


def times_measured(points: ControlPoints, own: ControlPoints, X_RG: Array) -> Array:
    """(m,) how many stripes of the model a point's profile shows: points of each of them measure them all.

    ``own``: points of all edges of the model, ``SAMPLED_PX`` apart.
    """
    across = stripes_across(points, own, X_RG, HALF_PX)
    return np.asarray(np.isfinite(across.offset_px).sum(axis=1), dtype=np.float64)


def expected_profiles(stripes: Stripes, floor_px: float) -> tuple[Array, Array]:
    """Information (m,) [px^-2] on the displacement of profiles, and sigma (m,) [px] of the place within the
    stripes that give it: means over draws of how light the surfaces between the stripes are."""
    places = np.arange(-HALF_PX, HALF_PX + 1e-9, STEP_PX)
    there = np.isfinite(stripes.offset_px)
    offset, width = np.nan_to_num(stripes.offset_px), np.nan_to_num(stripes.width_px)
    blur = np.sqrt(BLUR_PX**2 + (UNIFORM * width) ** 2)
    z = (places[None, :, None] - offset[:, None, :]) / blur[:, None, :]
    step = np.where(there[:, None, :], ndtr(z), 0.0)
    slope = np.where(there[:, None, :], -np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * blur[:, None, :]), 0.0)
    height = _heights(stripes.offset_px)
    j = np.einsum("mnk,mdk->mdn", slope, height)
    A = np.concatenate([np.ones((*step.shape[:2], 1)), step], axis=2)
    N = np.einsum("mni,mnj->mij", A, A) + RIDGE * np.eye(A.shape[2])
    c = np.einsum("mni,mdn->mid", A, j)
    left = np.einsum("mdn,mdn->md", j, j) - np.einsum("mid,mid->md", c, np.linalg.solve(N, c))
    variance = NOISE**2 / STEP_PX / np.maximum(left, 1e-12)
    information = np.mean(1.0 / (floor_px**2 + variance), axis=1)
    square = height**2
    share = square / np.maximum(square.sum(axis=2, keepdims=True), 1e-12)
    spread = np.sqrt(np.mean(np.einsum("mdk,mk->md", share, (UNIFORM * width) ** 2), axis=1))
    return information, spread


def _heights(offset_px: Array) -> Array:
    """(m, DRAWS, LINES) steps of light between surfaces of independent lightness, 0 to 1."""
    order = np.argsort(np.argsort(offset_px, axis=1), axis=1)
    light = np.random.default_rng(_SEED).uniform(size=(DRAWS, LINES + 1))
    height = np.diff(light, axis=1)[:, order].transpose(1, 0, 2)
    return np.where(np.isfinite(offset_px)[:, None, :], height, 0.0)
