"""From depth maps and the motion to the finished mesh: the fusion, and what follows it."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from polhode.lie import Array
from polhode.mapping.fusion.field import fuse
from polhode.pipeline.answer_checks.image_motion import ImageMotion
from polhode.pipeline.answer_checks.symmetry_turn import PairView
from polhode.pipeline.context import RunContext
from polhode.pipeline.depth_maps import STAGE as DEPTH
from polhode.pipeline.depth_maps import DepthMaps
from polhode.pipeline.find_motion import pose_RG
from polhode.pipeline.finish_surface import FinishedSurface, finish_surface
from polhode.records import DepthMap, MotionEstimate, StereoTracks, SurfaceModel

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FusedSurface:
    """The surface, and what was compared in the images while it was made (``ImageMotion``)."""

    surface: SurfaceModel
    shares: list[float]
    views: list[PairView]


def fuse_depth(
    context: RunContext, maps: Iterable[DepthMap], tracks: StereoTracks, estimate: MotionEstimate
) -> SurfaceModel:
    """The surface in G of the depth maps of all F frames, in order, each moved into G by the motion."""
    X_RG = pose_RG(tracks, estimate)
    return fuse(
        zip(maps, X_RG, strict=True),
        context.rig,
        context.config.mapping,
        context.progress,
        len(X_RG),
        covariance_G=estimate.covariance_X_NG,
        landmarks_G=estimate.landmarks.p_G,
    )


def finish_fused(
    context: RunContext,
    fused: SurfaceModel,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    ready: Callable[[SurfaceModel, Array | None], object] = lambda finished, sun_N: None,
) -> FinishedSurface:
    """The mesh as it is published, from the fused surface. ``ready``: as for ``finish_surface``."""
    X_RG = fused_poses(fused, tracks, estimate)
    config = context.config
    settings = config.mapping, config.backend, config.seed
    shown = context.sequence, context.rectifier
    key = context.stages.key(shown, fused, X_RG, estimate.mass, settings)
    return context.stages.keyed(
        *("finished_surface", FinishedSurface, key),
        lambda: finish_surface(context, fused, X_RG, estimate.mass, ready),
    )


def fused_poses(fused: SurfaceModel, tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) poses of the target in the rectified left camera, those that the fusion aligned included."""
    X_RG = pose_RG(tracks, estimate)
    return X_RG if fused.aligned is None else fused.aligned.put_into(X_RG)


def build_surface(
    context: RunContext,
    depth: DepthMaps,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    images: ImageMotion,
) -> SurfaceModel:
    """The fused surface, or the stored one; ``images`` compares the depth maps that pass by."""
    clock = context.clock

    def fused() -> FusedSurface:
        maps = images.watching(clock.waiting("depth", iter(depth)))
        surface = fuse_depth(context, maps, tracks, estimate)
        return FusedSurface(surface, images.shares, images.views)

    with clock("fusion"):
        poses = (
            *(pose_RG(tracks, estimate), estimate.covariance_X_NG),
            *(estimate.landmarks.p_G, images.measured),
        )
        context.stages.use(DEPTH, depth.keys)
        key = context.stages.key(depth.keys, poses, context.rig, context.config.mapping)
        found = context.stages.keyed("surface", FusedSurface, key, fused)
    surface, images.shares, images.views = found.surface, found.shares, found.views
    for warning in surface.warnings:
        _log.warning(warning)
    if surface.aligned is not None:
        _log.info(
            "%d of %d frames with doubtful poses were aligned to the surface of the others",
            *(len(surface.aligned.frames), surface.aligned.doubtful),
        )
    clock.seconds["fusion"] -= clock.seconds.get("depth", 0.0)
    return surface
