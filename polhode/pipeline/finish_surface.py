"""The fused surface made ready for use: holes, colours, coverage, lighter meshes, mass against volume.

Every step is optional: if one fails, its result is left out with a warning, and the others go on.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TypeVar

import numpy as np

from polhode.frontend.rectification import rectified_left, target_crop
from polhode.geometry.lie import Array, transform_points
from polhode.mapping.finishing.albedo import Colouring, divide_shading
from polhode.mapping.finishing.detail_levels import DetailLevel, levels_of
from polhode.mapping.finishing.hole_closing import ClosedHoles, close_small_holes
from polhode.mapping.finishing.sun_direction import Sunlight
from polhode.mapping.occupancy import occupancy_of
from polhode.mapping.visibility import Caster, FrameView, light_level
from polhode.pipeline.build_surface import correction_of, fused_poses
from polhode.pipeline.context import RunContext
from polhode.pipeline.coverage import coverage_of, warnings_of, with_classes
from polhode.pipeline.depth_maps import DepthMaps
from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.runner import stage
from polhode.pipeline.uniform_density import assumed_properties, check_physics
from polhode.records.occupancy import Occupancy
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import (
    Coverage,
    Mesh,
    MeshErrors,
    MeshErrorShare,
    MeshLevel,
    Physics,
    ShapeFindings,
    Sun,
)

_log = logging.getLogger(__name__)
T = TypeVar("T")
Sentences = tuple[str, ...]

Views = tuple[list[FrameView], Sentences]
"""Frames that are read again, each cropped to the target, and warnings"""


@dataclass(frozen=True)
class FinishedSurface:
    """The mesh as it is published, and what was found about the shape."""

    surface: SurfaceModel
    levels: list[DetailLevel]
    """Lighter meshes, the finest first"""
    findings: ShapeFindings
    """Coverage, closed holes, the Sun, mass against volume; with the warnings of steps that failed"""


@dataclass(frozen=True)
class Coloured:
    """The surface with closed holes, colours, and classes of its vertices."""

    surface: SurfaceModel
    holes_closed: int
    holes_left_open: int
    divided: bool
    """Whether the Sun's shading was divided out of the colours"""
    sun: Sunlight | None
    """The light that fits best, used or not; None: undetermined"""
    grey_per_albedo: float
    warnings: Sentences

    @property
    def sun_N(self) -> Array | None:
        """(3,) unit vector towards the Sun, if its shading was divided out of the colours"""
        return self.sun.direction_N if self.divided and self.sun is not None else None


def finish_surface(context: RunContext, fused: SurfaceModel, motion: MotionSolution) -> FinishedSurface:
    """The stages of this module one after the other."""
    views = views_of_surface(context, fused, motion)
    coloured = colour_surface(context, fused, views)
    levels = lighter_meshes(context, coloured)
    covered = cover(context, coloured, views)
    physics = compare_mass(context, coloured, motion)
    findings = describe_shape(context, motion, views, coloured, covered, levels, physics)
    return FinishedSurface(coloured.surface, levels[0], findings)


def _attempt(what: str, step: Callable[[], T], otherwise: T) -> tuple[T, Sentences]:
    """The result of an optional step; ``otherwise``, and a warning, if it fails."""
    try:
        return step(), ()
    except (ValueError, ArithmeticError, LookupError, RuntimeError, TypeError, MemoryError) as error:
        _log.warning("%s failed: %s", what, error, exc_info=_log.isEnabledFor(logging.DEBUG))
        return otherwise, (f"{what} failed and was left out: {error}",)


@stage("fusion", is_stored=False)
def views_of_surface(context: RunContext, fused: SurfaceModel, motion: MotionSolution) -> Views:
    """Frames evenly spread over the run, each cropped to the target; none for an empty surface."""
    none = list[FrameView]()
    if len(fused.mesh.faces) == 0:
        return none, ()
    X_RG = fused_poses(fused, motion)
    return _attempt("reading the images again", lambda: _views(context, fused, X_RG), none)


def _views(context: RunContext, surface: SurfaceModel, X_RG: Array) -> list[FrameView]:
    rig, R_NR, size = context.rig, context.X_NR[:, :3, :3], (context.rig.width_px, context.rig.height_px)
    # of 40 million pixels all together
    most, margin_px = int(np.clip(40e6 // (size[0] * size[1]), 8, 60)), 6
    usable = np.flatnonzero(np.isfinite(X_RG).all(axis=(1, 2)))
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, min(len(usable), most)).round().astype(int))]
    corners, views = np.array(list(product(*np.transpose(surface.mesh.bounds)))), []
    for k in chosen.tolist():
        corners_R = transform_points(X_RG[k], corners)
        if corners_R[:, 2].min() <= 1e-3:
            continue
        uv = rig.project(corners_R)[:, :2]
        u0, v0 = np.maximum(np.floor(uv.min(axis=0)).astype(int) - margin_px, 0).tolist()
        u1, v1 = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + margin_px, size).tolist()
        if min(u1 - u0, v1 - v0) <= 2:
            continue
        left, mask = rectified_left(context.sequence, context.rectifier, k)
        if (whole := target_crop(mask, margin_px)) is not None:
            # what the surface lacks, too
            u0, v0 = min(u0, whole.u0), min(v0, whole.v0)
            u1, v1 = max(u1, whole.u1), max(v1, whole.v1)
        image, silhouette = left[v0:v1, u0:u1].copy(), mask[v0:v1, u0:u1].copy()
        views.append(FrameView(image, silhouette, X_RG[k], R_NR[k], u0, v0, light_level(left), k))
    return views


@stage("fusion", ["mapping.hole_share", "mapping.divide_shading", "seed"])
def colour_surface(context: RunContext, fused: SurfaceModel, views: Views) -> Coloured:
    """Close small holes, divide the shading out, class the vertices by who has seen them in light."""
    if len(fused.mesh.faces) == 0:
        return Coloured(fused, 0, 0, False, None, 1.0, ())
    rig, config, frames = context.rig, context.config, views[0]
    seen_by = cache(lambda: Caster(fused.mesh))
    # Relative to the surface itself: the same in every unit.
    largest_m = config.mapping.hole_share * float(np.linalg.norm(fused.mesh.extents))
    holes, warnings = _attempt(
        "closing small holes",
        lambda: close_small_holes(fused, largest_m, frames, rig, seen_by()),
        ClosedHoles(fused, 0, 0),
    )
    caster = cache(lambda: Caster(holes.surface.mesh) if holes.closed else seen_by())
    colours = Colouring(holes.surface, False, None, 1.0)
    if config.mapping.divide_shading:
        colours, more = _attempt(
            "dividing the shading out",
            lambda: divide_shading(holes.surface, frames, rig, caster(), config.seed),
            colours,
        )
        warnings += more
    classes, more = _attempt(
        "coverage of the vertices", lambda: with_classes(colours.surface, frames, rig, caster()), None
    )
    return Coloured(
        replace(colours.surface, coverage=classes),
        *(holes.closed, holes.left_open, colours.divided, colours.sun, colours.grey_per_albedo),
        (*warnings, *more),
    )


@stage("fusion", ["outputs", "mapping.levels", "seed"])
def lighter_meshes(context: RunContext, coloured: Coloured) -> tuple[list[DetailLevel], Sentences]:
    """One for each share of the faces if they are wanted, and the warning of a failure."""
    surface, config, none = coloured.surface, context.config, list[DetailLevel]()
    if "levels" not in config.outputs or len(surface.mesh.faces) == 0:
        return none, ()
    return _attempt("lighter meshes", lambda: levels_of(surface, config.mapping.levels, config.seed), none)


@stage("fusion")
def cover(context: RunContext, coloured: Coloured, views: Views) -> tuple[Coverage | None, Sentences]:
    """Shares of the surface that were seen, and the warning of a failure."""
    if not views[0]:
        return None, ()
    return _attempt("coverage", lambda: coverage_of(coloured.surface.mesh, views[0], context.rig), None)


@stage("fusion")
def occupied_space(
    context: RunContext, coloured: Coloured, views: Views, maps: DepthMaps, motion: MotionSolution
) -> tuple[Occupancy | None, Sentences]:
    """What the outlines show beside the mesh and what no frame excludes, and the warning of a failure."""
    if not views[0]:
        return None, ()
    free = correction_of(context.rig, motion.estimate)
    depths = (free(maps[view.frame]) for view in views[0])
    # a direction that explains little is still better than none: it keeps dark sides in
    sun_N = None if coloured.sun is None else coloured.sun.direction_N
    mesh = coloured.surface.mesh
    return _attempt("the occupancy", lambda: occupancy_of(mesh, views[0], depths, context.rig, sun_N), None)


@stage("fusion")
def compare_mass(
    context: RunContext, coloured: Coloured, motion: MotionSolution
) -> tuple[Physics | None, Sentences]:
    """The mass properties of the motion against the volume, and the warning of a failure."""
    surface, mass = coloured.surface, motion.estimate.mass
    if len(surface.mesh.faces) == 0:
        return None, ()
    physics, warnings = _attempt(
        "mass against volume", lambda: check_physics(mass, surface, Caster(surface.mesh)), None
    )
    for sentence in physics.words if physics is not None else ():
        _log.info(sentence)
    return physics, warnings


@stage("fusion", ["backend"], is_stored=False)
def describe_shape(
    context: RunContext,
    motion: MotionSolution,
    views: Views,
    coloured: Coloured,
    covered: tuple[Coverage | None, Sentences],
    lighter: tuple[list[DetailLevel], Sentences],
    compared: tuple[Physics | None, Sentences],
) -> ShapeFindings:
    """What the summary says of the shape."""
    coverage, surface, mesh = covered[0], coloured.surface, coloured.surface.mesh
    assumed, doubts = assumed_properties(motion.estimate.mass, surface, context.config.backend)
    if len(mesh.faces) == 0:
        return ShapeFindings(assumed=assumed, warnings=tuple(doubts))
    failed = *views[1], *coloured.warnings, *covered[1], *lighter[1], *compared[1]
    warnings = *doubts, *failed, *(warnings_of(coverage) if coverage is not None else ())
    sun = errors = None
    if (light := coloured.sun) is not None:
        x, y, z = (float(part) for part in light.direction_N)
        sun = Sun(
            direction_N=(x, y, z),
            # Where the reflection law does not fit, its sigma is meaningless.
            sigma_deg=float(np.rad2deg(light.sigma_rad)) if coloured.divided else None,
            explained=light.explained,
            frames_in_light=int(light.sunny.sum()),
        )
    known = surface.sigma_m[np.isfinite(surface.sigma_m)]
    if (found := surface.errors) is not None and len(known):
        lengths = [(each.share, each.length_m) for each in found.correlation]
        errors = MeshErrors(
            sigma_median_m=float(np.median(known)),
            noise_scale=found.scale,
            landmarks=found.landmarks,
            correlation=tuple(
                MeshErrorShare(share=share, length_m=m if np.isfinite(m) else None) for share, m in lengths
            ),
        )
    levels = tuple(
        MeshLevel(
            file=f"mesh_lod{n}.glb",
            faces=len(level.surface.mesh.faces),
            largest_distance_m=level.largest_m,
            mean_distance_m=level.mean_m,
        )
        for n, level in enumerate(lighter[0], start=1)
    )
    invented, aligned = surface.is_invented, surface.aligned
    described = Mesh(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        closed=bool(mesh.is_volume),
        holes_closed=coloured.holes_closed,
        holes_left_open=coloured.holes_left_open,
        invented_faces=int(invented.sum()),
        invented_share=float(mesh.area_faces[invented].sum() / mesh.area),
        colour="albedo" if coloured.divided else "intensity",
        grey_per_albedo=coloured.grey_per_albedo,
        sun=sun,
        frames_doubtful=0 if aligned is None else aligned.doubtful,
        frames_aligned=0 if aligned is None else len(aligned.frames),
        errors=errors,
        levels=levels,
    )
    return ShapeFindings(described, coverage, compared[0], assumed, warnings)
