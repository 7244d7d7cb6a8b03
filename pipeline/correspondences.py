"""What the frames show: features, and which of two frames belong together, blind or with a motion at hand."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.backend import consistent_links
from polhode.config import Config
from polhode.config.frontend import Frontend
from polhode.errors import RunFailure
from polhode.frontend.extract import extract_features
from polhode.frontend.features.methods import feature_method, match_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.combined import shifted, side_by_side
from polhode.frontend.matching.pairs import PairMatch, match_pairs, relative_poses
from polhode.frontend.matching.retrieval import pairs_in_view, pairs_to_match
from polhode.frontend.tracks.tracks import join_matches
from polhode.lie import Array
from polhode.pipeline.images import Images
from polhode.pipeline.stopwatch import Stopwatch
from polhode.processes import worker_count
from polhode.progress import Progress
from polhode.records import Ints, RelativePoses, StereoTracks

_log = logging.getLogger(__name__)
FEWEST_MEASURED_FRAMES = 3


@dataclass(frozen=True)
class Sight:
    """Features of each frame, and matches between frames that no others contradict."""

    features: Sequence[StereoFeatures]
    matches: Sequence[PairMatch]

    @property
    def links(self) -> RelativePoses:
        """The geometry of the matches."""
        return relative_poses(self.matches)

    def require_features(self, fewest: int) -> None:
        """Raises RunFailure: hardly any frame has as many features."""
        measured = sum(len(features) >= fewest for features in self.features)
        if measured < FEWEST_MEASURED_FRAMES:
            raise RunFailure(
                f"only {measured} of {len(self.features)} frames show enough stereo features on the target; "
                "check exposure, focus and the calibration"
            )

    def tracks(self, images: Images, config: Config) -> StereoTracks:
        """Whatever the matches join, without any knowledge of the motion."""
        return images.tracks(self.features, join_matches(self.features, self.matches), config)


def look(images: Images, config: Config, progress: Progress, clock: Stopwatch) -> Sight:
    """Every frame against every frame, or against those that look like it, blind.

    Raises InputError: weights of a method are missing.
    """
    second = config.frontend.second_method
    if second is not None:
        # a file that is missing ends the command now, not after the first method's work
        feature_method(second), match_method(second)
    features = _extract(images, config.frontend, config, progress, clock)
    partners = pairs_to_match(features, config.frontend.pairs, config.seed)
    matches = _match(images, features, partners, config.frontend, config, progress, clock)
    return Sight(features, _undisputed(images, matches, clock))


def look_again(
    images: Images,
    first: Sight,
    second: Frontend,
    X_RG: Array | None,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> Sight:
    """What a second method sees beside the first one.

    X_RG (F, 4, 4), where it is known, tells which frames see the same side; without it all are tried.
    """
    features = _extract(images, second, config, progress, clock)
    partners = (
        pairs_to_match(features, second.pairs, config.seed)
        if X_RG is None
        else pairs_in_view(X_RG, second.pairs)
    )
    matches = _match(images, features, partners, second, config, progress, clock)
    both = side_by_side(first.features, features)
    together = [*first.matches, *shifted(matches, first.features)]
    return Sight(both, _undisputed(images, sorted(together, key=lambda m: (m.i, m.j)), clock))


def _extract(
    images: Images, frontend: Frontend, config: Config, progress: Progress, clock: Stopwatch
) -> list[StereoFeatures]:
    method = frontend.features.method
    with clock("frontend"), progress.stage(f"features ({method})", len(images.sequence)) as advance:
        features = extract_features(images.sequence, images.rectifier, frontend, workers(config), advance)
    median = int(np.median([len(f) for f in features]))
    _log.info("stereo features (%s) in a frame: median %d", method, median)
    return features


def _match(
    images: Images,
    features: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    frontend: Frontend,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> list[PairMatch]:
    rig = images.rectifier.rig
    with clock("frontend"), progress.stage("matching frames", len(features)) as advance:
        matches = match_pairs(features, partners, rig, frontend, config.seed, workers(config), advance)
    _log.info("%d links between frames, of %d tried", len(matches), sum(map(len, partners)))
    return matches


def _undisputed(images: Images, matches: Sequence[PairMatch], clock: Stopwatch) -> list[PairMatch]:
    with clock("initialization"):
        good = consistent_links(relative_poses(matches), images.time_s, images.X_NR[:, :3, :3])
    _log.info("%d of %d links are contradicted by others", np.sum(~good), len(matches))
    return [match for match, kept in zip(matches, good, strict=True) if kept]


def workers(config: Config) -> int:
    """Processes for parallel work."""
    return worker_count(config.runtime.workers)
