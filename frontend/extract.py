"""Stereo features and depth maps of every pair of a sequence, computed in parallel processes."""

from collections.abc import Iterator, Sequence
from functools import partial

from polhode.config.frontend_settings import Depth, Frontend
from polhode.frontend.disparity.depth import DisparityRange, compute_depth
from polhode.frontend.disparity.learned import disparity_network
from polhode.frontend.disparity.measured import measured_depth
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import match_method
from polhode.frontend.rectification import RectifiedPair, Rectifier, rectified_pair
from polhode.geometry.camera import RectifiedRig
from polhode.records.dataset import StereoSequence
from polhode.records.surface import DepthMap
from polhode.runtime.processes import in_order

PRELOADED = (
    "polhode.frontend.extract",
    "polhode.frontend.matching.pairs",
    "polhode.frontend.tracks.track_refinement",
    "polhode.frontend.features.surface_features",
    "polhode.frontend.matching.matchers",
    "polhode.frontend.disparity.learned",
)
"""Modules that the jobs on frames import: extraction is the first stage of a run that starts processes."""


def require_weights(config: Frontend) -> None:
    """Raise InputError: weights that extraction, matching or, later, depth need are missing or wrong."""
    feature_method(config), match_method(config)
    if config.depth.method == "network" and config.depth.weights is not None:
        disparity_network(config.depth.weights)


def extract_features(
    sequence: StereoSequence, rectifier: Rectifier, config: Frontend, workers: int, pairs: Sequence[int]
) -> Iterator[StereoFeatures]:
    """Stereo features of these pairs, in order, with the size of patches as ``with_patch_size`` gives it.

    Raises InputError at once, as ``require_weights``.
    """
    feature_method(config), match_method(config)
    return in_order(partial(_features_of, sequence, rectifier, config), pairs, workers, PRELOADED)


def extract_depth(
    sequence: StereoSequence,
    rectifier: Rectifier,
    config: Frontend,
    disparity_ranges_px: Sequence[DisparityRange],
    workers: int,
    pairs: Sequence[int] | None = None,
) -> Iterator[DepthMap]:
    """Depth maps of these pairs, or of every pair, in order.

    disparity_ranges_px: for every pair of the sequence.
    """
    chosen = range(len(disparity_ranges_px)) if pairs is None else pairs
    jobs = [(k, disparity_ranges_px[k]) for k in chosen]
    return in_order(partial(_depth_of, sequence, rectifier, config.depth), jobs, workers)


def depth_of_pair(
    pair: RectifiedPair, rig: RectifiedRig, config: Depth, disparity_range_px: DisparityRange
) -> DepthMap:
    """Depth map of one pair. disparity_range_px: of the target, None: it is searched for."""
    if pair.measured is not None:
        return measured_depth(pair, rig, config.largest_sigma_px)
    return compute_depth(pair.left, pair.right, pair.mask_left, rig, config, disparity_range_px)


def extract_pair(pair: RectifiedPair, rig: RectifiedRig, config: Frontend) -> StereoFeatures:
    """Features of one pair by the configured method."""
    return feature_method(config)(pair, rig)


def _features_of(sequence: StereoSequence, rectifier: Rectifier, config: Frontend, k: int) -> StereoFeatures:
    return extract_pair(rectified_pair(sequence, rectifier, k), rectifier.rig, config)


def _depth_of(
    sequence: StereoSequence, rectifier: Rectifier, config: Depth, job: tuple[int, DisparityRange]
) -> DepthMap:
    return depth_of_pair(rectified_pair(sequence, rectifier, job[0]), rectifier.rig, config, job[1])
