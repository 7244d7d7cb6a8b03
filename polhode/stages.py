"""The stages of ``polhode.run`` one by one: records in, records out.

They are the functions that a run itself calls, in this order, so that stage by stage the result is the same
to the last digit. Between two stages, records can be looked at, changed, stored or replaced by those of
another program.

    context = open_sequence("SEQ")                    RunContext: images, camera, settings
    features = extract_features(context)              StereoFeatures of each pair
    correspondences = match_features(context, features)
    solution = find_motion(context, correspondences)  MotionSolution: StereoTracks and MotionEstimate
    maps = depth_maps(context, features)              DepthMap of each pair
    fused = fuse_depth(context, maps, solution.tracks, solution.estimate)           SurfaceModel
    finished = finish_surface(context, fused, solution.tracks, solution.estimate)   FinishedSurface

One pair by itself: ``rectified_pair``, ``features_of_pair``, ``depth_map``. The back end by itself, which
needs no images: ``first_motion`` and ``estimate_motion`` on ``StereoTracks``, such as ``Run.measurements``.

F is the number of frames. The records are documented in ``polhode.records``, the frames N, R, G, P and B in
docs/notation.md. Nothing is written. Sequences of more frames than ``key_frames.above`` are solved on key
frames by ``polhode.run``; these functions treat all frames alike.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from polhode.api import Configuration, chosen_progress, configuration
from polhode.backend import estimate_motion as estimate_by_back_end
from polhode.backend import initialize_motion
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import RectifiedPair
from polhode.frontend.rectification import rectified_pair as rectify_and_mask
from polhode.pipeline.build_surface import fuse_depth as fuse_at_poses
from polhode.pipeline.context import RunContext, open_context
from polhode.pipeline.correspondences import Correspondences, features_of_frames
from polhode.pipeline.correspondences import features_of_pair as extract_pair_features
from polhode.pipeline.correspondences import match_features as match_all_frames
from polhode.pipeline.depth_maps import depth_map_of_pair, depth_maps_of
from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.find_motion import find_motion as find_by_stages
from polhode.pipeline.finish_surface import FinishedSurface
from polhode.pipeline.finish_surface import finish_surface as finish_by_stages
from polhode.pipeline.long_sequence import NO_LINKS
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.surface import DepthMap, SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.argument_names import errors_name_arguments
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.runtime.threads import single_threaded

__all__ = [
    "Correspondences",
    "FinishedSurface",
    "MotionSolution",
    "RectifiedPair",
    "RunContext",
    "StereoFeatures",
    "depth_map",
    "depth_maps",
    "estimate_motion",
    "extract_features",
    "features_of_pair",
    "find_motion",
    "finish_surface",
    "first_motion",
    "fuse_depth",
    "match_features",
    "open_sequence",
    "rectified_pair",
]


@errors_name_arguments()
@single_threaded
def open_sequence(
    data: str | Path, config: Configuration = None, *, progress: Progress | bool = False
) -> RunContext:
    """Open a sequence: what every other stage takes first.

    data: its folder; config: as for ``polhode.run``, ``RUN/config.yaml`` repeats the settings of a run;
    progress: whether stages show their progress, or what shows it. Returns images and calibration
    (``sequence``), how they are rectified (``rectifier``), the rectified camera (``rig``), its pose in N
    (``X_NR``, (F, 4, 4)), the times (``time_s``, (F,) [s]) and the settings (``config``); ``of_frames`` gives
    the context of some of the frames. Raises InputError: something is missing or wrong in the folder or in
    the configuration.
    """
    return open_context(Path(data), configuration(config), chosen_progress(progress))


@single_threaded
def rectified_pair(context: RunContext, k: int) -> RectifiedPair:
    """Pair k, 0 <= k < F, read, rectified and masked: images (H, W) of 8 bits, masks true on the target.

    Raises InputError: there is no such pair, or its images have changed since the sequence was opened.
    """
    count = len(context.sequence)
    if not 0 <= k < count:
        raise InputError(f"pair {k}: the sequence has pairs 0 to {count - 1}")
    return rectify_and_mask(context.sequence, context.rectifier, k)


@single_threaded
def features_of_pair(context: RunContext, pair: RectifiedPair) -> StereoFeatures:
    """The stereo features of one pair: (n,) points with ``uvd_px``, ``sigma_px`` and descriptors.

    Raises InputError: weights of the feature method are missing or wrong.
    """
    return extract_pair_features(context, pair)


@single_threaded
def extract_features(context: RunContext) -> list[StereoFeatures]:
    """The stereo features of every pair, F of them, by ``runtime.workers`` processes.

    Raises InputError: weights of the feature or matching method are missing or wrong.
    """
    return features_of_frames(context)


@single_threaded
def match_features(context: RunContext, features: Sequence[StereoFeatures]) -> Correspondences:
    """Match the features of every frame, F, with those of every other, or of similar ones, without a motion.

    Returns ``matches`` that pass the geometric check and contradict no others; ``links``, the relative poses
    that follow from them; ``tracks(context)``, the measurements for a back end. ``PairMatch.i`` and ``.j``
    are positions in ``features``, and so frames of the context. Raises InputError: there are not as many
    features as the context has frames.
    """
    _require_every_frame(context, features)
    return match_all_frames(context, features)


@single_threaded
def find_motion(context: RunContext, correspondences: Correspondences) -> MotionSolution:
    """Motion, mass properties and landmarks: solve, match again with the motion found, refine the tracks.

    Returns the ``estimate``, and the ``tracks`` that it rests on: the last solution that a run writes. The
    images are read again to refine the tracks, and for the second feature method where it is needed.
    Raises RunFailure: no consistent motion is found.
    """
    return find_by_stages(context, correspondences)


@single_threaded
def first_motion(tracks: StereoTracks, links: RelativePoses, config: Configuration = None) -> InitialMotion:
    """Poses X_RG (F, 4, 4) of the target by pose graph and bundle adjustment, without dynamics.

    Raises RunFailure: fewer than three frames can be connected.
    """
    return initialize_motion(tracks, links, configuration(config).backend.for_motion)


@single_threaded
def estimate_motion(
    tracks: StereoTracks,
    initial: InitialMotion,
    config: Configuration = None,
    *,
    progress: Progress | bool = False,
) -> MotionEstimate:
    """The back end alone: smooth all F frames as the motion of a rigid body, and find its mass properties.

    Raises RunFailure: no guess leads to a motion that most observations agree with.
    """
    backend = configuration(config).backend.for_motion
    return estimate_by_back_end(tracks, initial, backend, progress=chosen_progress(progress))


@single_threaded
def depth_map(context: RunContext, pair: RectifiedPair, features: StereoFeatures) -> DepthMap:
    """Depth (H, W) [m] of one pair and its standard deviation; ``features``: of this pair."""
    return depth_map_of_pair(context, pair, features)


def depth_maps(context: RunContext, features: Sequence[StereoFeatures]) -> Iterator[DepthMap]:
    """The depth maps of all F pairs, in order, each made when it is asked for or a little before.

    Raises InputError: there are not as many features as the context has frames.
    """
    _require_every_frame(context, features)
    return iter(depth_maps_of(context, features))


@single_threaded
def fuse_depth(
    context: RunContext, maps: Iterable[DepthMap], tracks: StereoTracks, estimate: MotionEstimate
) -> SurfaceModel:
    """Fuse depth maps of every frame, moved into G by the poses X_NG (F, 4, 4), in a distance field.

    Returns the mesh in G [m] with ``sigma_m`` and ``views`` of each vertex; empty when nothing was seen.
    """
    return fuse_at_poses(context, maps, MotionSolution(tracks, estimate, NO_LINKS))


@single_threaded
def finish_surface(
    context: RunContext, fused: SurfaceModel, tracks: StereoTracks, estimate: MotionEstimate
) -> FinishedSurface:
    """Close small holes, divide the Sun's shading out, class the vertices by coverage, make lighter meshes.

    The images are read again. A step that fails is left out with a warning in ``findings``.
    """
    return finish_by_stages(context, fused, MotionSolution(tracks, estimate, NO_LINKS))


def _require_every_frame(context: RunContext, features: Sequence[StereoFeatures]) -> None:
    if len(features) != len(context.sequence):
        raise InputError(
            f"features of {len(features)} frames for a context of {len(context.sequence)}: give those of "
            "every frame, or the context of these by context.of_frames"
        )
