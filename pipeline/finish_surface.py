"""The fused surface made ready for use: holes, colours, coverage, lighter meshes, mass against volume.

Every step is optional: if one fails, its result is left out with a warning, and the others go on.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np

from polhode.camera import RectifiedRig
from polhode.frontend.rectification import rectified_left
from polhode.lie import Array, transform_points
from polhode.mapping.finishing.albedo import Colouring, divide_shading
from polhode.mapping.finishing.detail_levels import DetailLevel, levels_of
from polhode.mapping.finishing.hole_closing import ClosedHoles, close_small_holes
from polhode.mapping.visibility import Caster, FrameView, light_level
from polhode.pipeline.context import RunContext
from polhode.pipeline.coverage import coverage_of, warnings_of, with_classes
from polhode.pipeline.run_directory.summary_schema import (
    Mesh,
    MeshErrors,
    MeshErrorShare,
    MeshLevel,
    ShapeFindings,
    Sun,
)
from polhode.pipeline.uniform_density import assumed_properties, check_physics
from polhode.records import MassProperties, SurfaceModel

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

MAX_FRAMES = 60
MAX_PIXELS = 40e6
"""Of all frames that are used, together."""
_MARGIN_PX = 6


@dataclass(frozen=True)
class FinishedSurface:
    """The mesh as it is published, and what was found about the shape."""

    surface: SurfaceModel
    levels: list[DetailLevel]
    """Lighter meshes, the finest first"""
    findings: ShapeFindings
    """Coverage, closed holes, the Sun, mass against volume; with the warnings of steps that failed"""


def finish_surface(
    context: RunContext,
    surface: SurfaceModel,
    X_RG: Array,
    mass: MassProperties,
    ready: Callable[[SurfaceModel, Array | None], object] = lambda finished, sun_N: None,
) -> FinishedSurface:
    """Close small holes, divide the shading out, class the vertices, make lighter meshes.

    X_RG (F, 4, 4): pose of the target in the rectified left camera. ``ready`` is called with the finished
    surface as soon as there is one, and with the Sun's direction in N (3,) if its shading was divided out of
    the colours, before what follows from them.
    """
    config = context.config
    if len(surface.mesh.faces) == 0:
        ready(surface, None)
        assumed, doubts = assumed_properties(mass, surface, config.backend)
        return FinishedSurface(surface, [], ShapeFindings(assumed=assumed, warnings=tuple(doubts)))
    steps, rig, mapping = _OptionalSteps(), context.rig, config.mapping
    views: list[FrameView] = []
    views = steps.attempt("reading the images again", lambda: _views(context, surface, X_RG), views)
    seen_by = cache(lambda: Caster(surface.mesh))
    # Relative to the surface itself: the same in every unit.
    largest_m = mapping.hole_share * float(np.linalg.norm(surface.mesh.extents))
    holes = steps.attempt(
        "closing small holes",
        lambda: close_small_holes(surface, largest_m, views, rig, seen_by()),
        ClosedHoles(surface, 0, 0),
    )
    caster = cache(lambda: Caster(holes.surface.mesh) if holes.closed else seen_by())
    colours = Colouring(holes.surface, False, None, 1.0)
    if mapping.divide_shading:
        colours = steps.attempt(
            "dividing the shading out",
            lambda: divide_shading(holes.surface, views, rig, caster(), config.seed),
            colours,
        )
    finished = colours.surface
    classes = steps.attempt(
        "coverage of the vertices", lambda: with_classes(finished, views, rig, caster()), None
    )
    finished = replace(finished, coverage=classes)
    ready(finished, colours.sun.direction_N if colours.divided and colours.sun is not None else None)
    coverage = None
    if views:
        coverage = steps.attempt("coverage", lambda: coverage_of(finished.mesh, views, rig), None)
    levels: list[DetailLevel] = []
    levels = steps.attempt("lighter meshes", lambda: levels_of(finished, mapping.levels, config.seed), levels)
    physics = steps.attempt("mass against volume", lambda: check_physics(mass, finished, caster()), None)
    assumed, doubts = assumed_properties(mass, finished, config.backend)
    warnings = [*doubts, *steps.warnings, *(warnings_of(coverage) if coverage is not None else ())]
    described = _describe(finished, holes, colours, levels)
    for sentence in physics.words if physics is not None else ():
        _log.info(sentence)
    findings = ShapeFindings(described, coverage, physics, assumed, tuple(warnings))
    return FinishedSurface(finished, levels, findings)


class _OptionalSteps:
    """Runs steps that may fail, and collects the warnings of those that did."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def attempt(self, what: str, step: Callable[[], Result], otherwise: Result) -> Result:
        """The step's result; ``otherwise``, with a warning, if it fails."""
        try:
            return step()
        except (ValueError, ArithmeticError, LookupError, RuntimeError, TypeError, MemoryError) as error:
            _log.warning("%s failed: %s", what, error, exc_info=_log.isEnabledFor(logging.DEBUG))
            self.warnings.append(f"{what} failed and was left out: {error}")
            return otherwise


def _views(context: RunContext, surface: SurfaceModel, X_RG: Array) -> list[FrameView]:
    """Frames evenly spread over the run, each cropped to the target."""
    rig, R_NR = context.rig, context.X_NR[:, :3, :3]
    most = int(np.clip(MAX_PIXELS // (rig.width_px * rig.height_px), 8, MAX_FRAMES))
    usable = np.flatnonzero(np.isfinite(X_RG).all(axis=(1, 2)))
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, min(len(usable), most)).round().astype(int))]
    low, high = surface.mesh.bounds
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    views = []
    for k in chosen.tolist():
        box = _box(transform_points(X_RG[k], corners), rig)
        if box is None:
            continue
        left, mask = rectified_left(context.sequence, context.rectifier, k)
        u0, u1, v0, v1 = box
        views.append(
            FrameView(
                image=left[v0:v1, u0:u1].copy(),
                silhouette=mask[v0:v1, u0:u1].copy(),
                X_RG=X_RG[k],
                R_NR=R_NR[k],
                u0=u0,
                v0=v0,
                lit_above=light_level(left),
            )
        )
    return views


def _box(corners_R: Array, rig: RectifiedRig) -> tuple[int, int, int, int] | None:
    """Columns u0..u1 and rows v0..v1 of the body's bounding box; None: out of view, or not all in front."""
    if corners_R[:, 2].min() <= 1e-3:
        return None
    uv = rig.project(corners_R)[:, :2]
    u0, v0 = np.maximum(np.floor(uv.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    u1, v1 = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + _MARGIN_PX, (rig.width_px, rig.height_px))
    return (int(u0), int(u1), int(v0), int(v1)) if u1 - u0 > 2 and v1 - v0 > 2 else None


def _errors(surface: SurfaceModel) -> MeshErrors | None:
    known = surface.sigma_m[np.isfinite(surface.sigma_m)]
    if surface.errors is None or len(known) == 0:
        return None
    return MeshErrors(
        sigma_median_m=float(np.median(known)),
        noise_scale=surface.errors.scale,
        landmarks=surface.errors.landmarks,
        correlation=tuple(
            MeshErrorShare(share=each.share, length_m=each.length_m if np.isfinite(each.length_m) else None)
            for each in surface.errors.correlation
        ),
    )


def _describe(
    surface: SurfaceModel, holes: ClosedHoles, colours: Colouring, levels: Sequence[DetailLevel]
) -> Mesh:
    mesh, invented, light = surface.mesh, surface.is_invented, colours.sun
    sun = None
    if light is not None:
        x, y, z = (float(part) for part in light.direction_N)
        # Where the reflection law does not fit, its sigma is meaningless.
        sigma = float(np.rad2deg(light.sigma_rad)) if colours.divided else None
        sun = Sun(
            direction_N=(x, y, z),
            sigma_deg=sigma,
            explained=light.explained,
            frames_in_light=int(light.sunny.sum()),
        )
    return Mesh(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        closed=bool(mesh.is_volume),
        holes_closed=holes.closed,
        holes_left_open=holes.left_open,
        invented_faces=int(invented.sum()),
        invented_share=float(mesh.area_faces[invented].sum() / mesh.area),
        colour="albedo" if colours.divided else "intensity",
        grey_per_albedo=colours.grey_per_albedo,
        sun=sun,
        frames_doubtful=0 if surface.aligned is None else surface.aligned.doubtful,
        frames_aligned=0 if surface.aligned is None else len(surface.aligned.frames),
        errors=_errors(surface),
        levels=tuple(
            MeshLevel(
                file=f"mesh_lod{n}.glb",
                faces=len(level.surface.mesh.faces),
                largest_distance_m=level.largest_m,
                mean_distance_m=level.mean_m,
            )
            for n, level in enumerate(levels, start=1)
        ),
    )
