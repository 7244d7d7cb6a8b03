"""Images to stereo features and depth maps: every pair of the sequence, in parallel processes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from polhode.config.frontend import Frontend
from polhode.dataset import StereoSequence
from polhode.frontend.disparity.depth import compute_depth
from polhode.frontend.features.methods import extract_pair, feature_method, match_method
from polhode.frontend.features.patch_size import with_patch_size
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification.rectified_pair import rectified_pair
from polhode.frontend.rectification.rectify import Rectifier
from polhode.processes import in_order
from polhode.records import DepthMap

Tick = Callable[[], None]

PRELOADED = (
    "polhode.frontend.extract",
    "polhode.frontend.matching.pairs",
    "polhode.frontend.tracks.track_refinement",
    "polhode.frontend.features.surface_features",
    "polhode.frontend.matching.softmax_matcher",
    "polhode.frontend.disparity.network",
)
"""What the work on frames imports: extraction is the first stage of a run that starts processes."""


@dataclass(frozen=True)
class _FeatureJob:
    sequence: StereoSequence
    rectifier: Rectifier
    config: Frontend

    def __call__(self, k: int) -> StereoFeatures:
        pair = rectified_pair(self.sequence, self.rectifier, k)
        return extract_pair(pair, self.rectifier.rig, self.config)


@dataclass(frozen=True)
class _DepthJob:
    sequence: StereoSequence
    rectifier: Rectifier
    config: Frontend
    disparity_ranges_px: Sequence[tuple[float, float] | None]

    def __call__(self, k: int) -> DepthMap:
        pair = rectified_pair(self.sequence, self.rectifier, k)
        rig, span = self.rectifier.rig, self.disparity_ranges_px[k]
        return compute_depth(pair.left, pair.right, pair.mask_left, rig, self.config.depth, span)


def extract_features(
    sequence: StereoSequence, rectifier: Rectifier, config: Frontend, workers: int, tick: Tick
) -> list[StereoFeatures]:
    """Stereo features of every pair, in the order of the sequence. ``tick`` is called once per pair.

    Raises InputError before any work: weights that extraction or matching needs are missing.
    """
    feature_method(config), match_method(config)
    config = with_patch_size(config, sequence, rectifier)
    features: list[StereoFeatures] = []
    job = _FeatureJob(sequence, rectifier, config)
    for found in in_order(job, range(len(sequence)), workers, PRELOADED):
        features.append(found)
        tick()
    return features


def extract_depth(
    sequence: StereoSequence,
    rectifier: Rectifier,
    config: Frontend,
    disparity_ranges_px: Sequence[tuple[float, float] | None],
    workers: int,
) -> Iterator[DepthMap]:
    """Depth map of every pair, in order; disparity_ranges_px: per pair, what the sparse map predicts."""
    job = _DepthJob(sequence, rectifier, config, disparity_ranges_px)
    return in_order(job, range(len(sequence)), workers)
