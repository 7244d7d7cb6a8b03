"""Vertex colours without the Sun's shading, where the images determine the direction of the Sun.

A sample of vertices over the frames gives the Sun's direction (``sun_direction``). When Lambert's law
explains the changes of brightness clearly better than a constant, every vertex gets its albedo from all
frames that saw it, given the light that fell on it, the body's own shadows included. Otherwise the colours
remain averages of the images.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_array
from trimesh.visual import ColorVisuals

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.mapping.finishing.sun_direction import CLEARLY_BETTER, Observations, Sunlight, find_sun
from polhode.mapping.visibility import (
    Caster,
    DepthPicture,
    FrameView,
    pixels_of,
    sun_in_G,
    towards_G,
    values_at,
)
from polhode.records.surface import SurfaceModel

Floats = NDArray[np.float32]

_SATURATED = 250.0
_GRAZING = 0.25
"""Cosine between normal and ray below which a pixel mixes too much."""


@dataclass(frozen=True)
class Colouring:
    """The surface with its colours, and how they came about."""

    surface: SurfaceModel
    divided: bool
    """Whether the Sun's shading was divided out"""
    sun: Sunlight | None
    """The light that fits best, used or not; None: undetermined"""
    grey_per_albedo: float
    """Grey of a vertex over the grey that it would show facing the Sun; 1 where nothing was divided"""


def divide_shading(
    surface: SurfaceModel,
    views: Sequence[FrameView],
    rig: RectifiedRig,
    caster: Caster | None = None,
    seed: int = 0,
) -> Colouring:
    """Find the Sun and divide its shading out, if that explains the images clearly better."""
    mesh = surface.mesh
    if len(mesh.faces) == 0 or len(views) < 2:
        return Colouring(surface, False, None, 1.0)
    caster, mean = caster or Caster(mesh), _mean_of_neighbours(mesh)
    normals = smooth_normals(mesh, mean)
    sun = _find_sun(surface, normals, views, rig, caster, seed)
    if sun is None or sun.explained < CLEARLY_BETTER or not np.isfinite(sun.sigma_rad):
        return Colouring(surface, False, sun, 1.0)
    albedo, known = _albedos(mesh, normals, views, rig, caster, sun)
    measured = known & (surface.views > 0)
    if not measured.any():
        return Colouring(surface, False, sun, 1.0)
    # Grey of the 99th percentile of the albedos
    scale = 235.0 / max(float(np.percentile(albedo[measured], 99.0)), 1.0)
    grey = np.clip(np.round(_spread(mean, albedo, known) * scale), 0, 255).astype(np.uint8)
    rgba = np.column_stack([grey, grey, grey, np.full_like(grey, 255)])
    # the shape is the same: cached properties stay valid
    coloured = mesh.copy(include_cache=True)
    coloured.visual = ColorVisuals(coloured, vertex_colors=rgba)
    return Colouring(replace(surface, mesh=coloured), True, sun, scale)


def smooth_normals(mesh: trimesh.Trimesh, mean: csr_array | None = None) -> Array:
    """(V, 3) unit normals, averaged over a few rings of neighbours against the noise of the field."""
    normals = np.asarray(mesh.vertex_normals, dtype=np.float64)
    mean = _mean_of_neighbours(mesh) if mean is None else mean
    for _ in range(6):
        normals = normals + mean @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


def _mean_of_neighbours(mesh: trimesh.Trimesh) -> csr_array:
    n, faces = len(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
    i, j = faces[:, [0, 1, 2, 1, 2, 0]].reshape(-1), faces[:, [1, 2, 0, 0, 1, 2]].reshape(-1)
    graph = csr_array(coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)))
    count = np.asarray(graph.sum(axis=1)).reshape(-1)
    graph.data /= np.repeat(np.maximum(count, 1.0), np.diff(graph.indptr))
    return graph


def _find_sun(
    surface: SurfaceModel,
    normals: Array,
    views: Sequence[FrameView],
    rig: RectifiedRig,
    caster: Caster,
    seed: int,
) -> Sunlight | None:
    measured = np.flatnonzero(surface.views > 0)
    chosen = np.sort(np.random.default_rng(seed).permutation(measured)[:3000])
    p_G, n_G = np.asarray(surface.mesh.vertices)[chosen], normals[chosen]
    vertex, frame, turned, intensity = [], [], [], []
    for k, view in enumerate(views):
        row, column, inside = pixels_of(view, p_G, rig)
        inside &= np.einsum("nk,nk->n", towards_G(view, p_G), n_G) > _GRAZING
        at = np.flatnonzero(inside)
        at = at[caster.sees(view.eye_G, p_G[at], n_G[at])]
        value = view.smooth[row[at], column[at]]
        at, value = at[value < _SATURATED], value[value < _SATURATED]
        vertex.append(at)
        frame.append(np.full(len(at), k))
        turned.append(n_G[at] @ (view.R_NR @ view.X_RG[:3, :3]).T)
        intensity.append(value.astype(np.float64))
    if sum(map(len, vertex)) == 0:
        return None
    of, at_frame = np.concatenate(vertex), np.concatenate(frame)
    values = np.concatenate(turned), np.concatenate(intensity)
    seen = Observations(of, at_frame, *values, _facing(n_G[of]), len(views))

    def lit(sun_N: Array) -> Bools:
        shone = np.ones(len(of), dtype=bool)
        for k, view in enumerate(views):
            here = at_frame == k
            shone[here] = caster.lit_by(sun_in_G(view, sun_N), p_G[of[here]])
        return shone

    return find_sun(seen, lit)


def _facing(n_G: Array) -> Ints:
    """(m,) which of the body's six sides a normal faces."""
    axis = np.argmax(np.abs(n_G), axis=1)
    return np.asarray(2 * axis + (np.take_along_axis(n_G, axis[:, None], axis=1)[:, 0] > 0.0), dtype=np.int64)


def _albedos(
    mesh: trimesh.Trimesh,
    normals: Array,
    views: Sequence[FrameView],
    rig: RectifiedRig,
    caster: Caster,
    sun: Sunlight,
) -> tuple[Array, Bools]:
    """(V,) grey that each vertex would show facing the Sun, and whether it was observed in light."""
    p_G, n_G = np.asarray(mesh.vertices, dtype=np.float32), normals.astype(np.float32)
    up, down = np.zeros(len(p_G)), np.zeros(len(p_G))
    lit = np.flatnonzero(sun.sunny)
    # frames that the albedos of all vertices are taken from
    for k in lit[np.unique(np.linspace(0, len(lit) - 1, min(len(lit), 40)).round().astype(int))]:
        view = views[k]
        eye, to_sun = view.eye_G.astype(np.float32), sun_in_G(view, sun.direction_N)
        facing = n_G @ to_sun.astype(np.float32)
        # minimum share of full sunlight for an observation to count for an albedo
        at = np.flatnonzero(facing > 0.15)
        ray = eye - p_G[at]
        cosine = np.einsum("nk,nk->n", ray, n_G[at]) / np.sqrt(np.einsum("nk,nk->n", ray, ray))
        at, cosine = at[cosine > _GRAZING], cosine[cosine > _GRAZING]
        for picture in (
            DepthPicture(caster, caster.middle - view.eye_G, view.eye_G),
            DepthPicture(caster, -to_sun),
        ):
            shown = picture.shows(p_G[at])
            at, cosine = at[shown], cosine[shown]
        value, inside = values_at(view, view.image.astype(np.float32), p_G[at], rig)
        at, cosine, value = at[inside], cosine[inside], value[inside]
        light = facing[at] + sun.ambient_on(n_G[at] @ (view.R_NR @ view.X_RG[:3, :3]).T)
        weight = cosine**2 * np.where(value < _SATURATED, 1.0, 1e-3)
        up[at] += weight * light * value
        down[at] += weight * light * light
    known = down > 0.0
    full = 1.0 + float(sun.ambient_on(sun.direction_N[None, :])[0])
    return np.where(known, full * up / np.maximum(down, 1e-12), 0.0), known


def _spread(mean: csr_array, albedo: Array, known: Bools) -> Array:
    """Albedos where none was observed: from the neighbours, or the median of all where there are none."""
    if known.all():
        return albedo
    value, weight = np.where(known, albedo, 0.0), known.astype(np.float64)
    for _ in range(60):
        if weight.all():
            break
        around, share = mean @ value, mean @ weight
        new = (weight == 0.0) & (share > 0.0)
        value[new], weight[new] = around[new] / share[new], 1.0
    return np.where(weight > 0.0, value, np.median(albedo[known]))
