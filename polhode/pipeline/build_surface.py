"""Depth maps and the motion to a fused surface, and to the check of a rotation about an axis of symmetry."""

import logging
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.mapping.fusion.field import fuse
from polhode.mapping.fusion.surface_extraction import empty_surface
from polhode.pipeline.checks.answer_checks.symmetry_turn import rotation_check, views_of_pairs
from polhode.pipeline.context import RunContext
from polhode.pipeline.depth_maps import DepthMaps, freed_depth
from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.runner import stage
from polhode.records.estimate import MotionEstimate
from polhode.records.surface import DepthMap, SurfaceModel
from polhode.run_directory.summary_schema import Check

NOT_CHECKED = (
    "outputs has no surface: whether the images show a rotation about an axis of symmetry is not checked, "
    "and a keep-out volume cannot be planned"
)

_log = logging.getLogger(__name__)


@stage("fusion", ["mapping.for_fusion"])
def fuse_depth(context: RunContext, maps: Iterable[DepthMap], motion: MotionSolution) -> SurfaceModel:
    """The surface in G of the depth maps of all F frames, in order, each moved into G by the motion."""
    X_RG, estimate = motion.X_RG, motion.estimate
    surface = fuse(
        zip(map(correction_of(context.rig, estimate), maps), X_RG, strict=True),
        context.rig,
        context.config.mapping,
        context.progress,
        len(X_RG),
        covariance_G=estimate.covariance_X_NG,
        landmarks_G=estimate.landmarks.p_G,
    )
    for warning in surface.warnings:
        _log.warning(warning)
    if surface.aligned is not None:
        _log.info(
            "%d of %d frames with doubtful poses were aligned to the surface of the others",
            *(len(surface.aligned.frames), surface.aligned.doubtful),
        )
    return surface


@stage("fusion", is_stored=False)
def no_surface(context: RunContext) -> SurfaceModel:
    """In a run that is to make none."""
    del context
    return empty_surface((NOT_CHECKED,))


def correction_of(rig: RectifiedRig, estimate: MotionEstimate) -> Callable[[DepthMap], DepthMap]:
    """What frees depth maps of the errors of the calibration that were estimated."""
    found = estimate.calibration
    if found is None or found.correction is None:
        return lambda depth: depth
    return partial(freed_depth, rig, found.correction)


def fused_poses(fused: SurfaceModel, motion: MotionSolution) -> Array:
    """(F, 4, 4) poses of the target in the rectified left camera, those that the fusion aligned included."""
    return motion.X_RG if fused.aligned is None else fused.aligned.put_into(motion.X_RG)


@stage("checks")
def symmetry_check(context: RunContext, maps: DepthMaps, motion: MotionSolution) -> Check:
    """Whether the images show the rotation about an axis of symmetry, where the surface has one."""
    interval_s = float(np.median(np.diff(motion.tracks.time_s)))
    views = views_of_pairs(maps, motion.X_RG, motion.is_measured, context.rig)
    return rotation_check(views, context.rig, interval_s)


@stage("checks", is_stored=False)
def no_symmetry_check(context: RunContext) -> Check:
    """In a run that makes no surface, where it has no value."""
    return rotation_check([], context.rig, 1.0)
