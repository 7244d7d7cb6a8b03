"""What every stage works with: the images, the configuration, progress for the user."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from polhode.config import Config
from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.calibration_effects import calibration_effects
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.found_masks import FoundMasks
from polhode.frontend.rectification import Rectifier, make_rectifier
from polhode.frontend.segmentation import has_surroundings
from polhode.frontend.tracks.tracks import Association, to_tracks
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.calibration_prior import prior_of
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.tracks import StereoTracks
from polhode.run_directory.finished_stages import StageStore
from polhode.runtime.errors import InputError
from polhode.runtime.processes import worker_count
from polhode.runtime.progress import Progress

SURROUNDINGS = (
    "every image shows dim surroundings around a bright target, up to its border: they are taken for "
    "background; if they belong to the target, give masks (masks0/ and masks1/)"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunContext:
    """The inputs of a run, opened, and its services."""

    sequence: StereoSequence
    rectifier: Rectifier
    config: Config
    progress: Progress
    stages: StageStore = field(default_factory=StageStore)
    """Results of stages for each pair, which are used again"""

    @property
    def rig(self) -> RectifiedRig:
        """The rectified stereo camera."""
        return self.rectifier.rig

    @property
    def time_s(self) -> Array:
        """(F,) since the first pair [s]"""
        return np.asarray((self.sequence.timestamps_ns - self.sequence.timestamps_ns[0]) * 1e-9)

    @property
    def X_NR(self) -> Array:
        """(F, 4, 4) pose of the rectified left camera"""
        return np.asarray(self.sequence.X_NC @ self.rectifier.X_CR)

    @property
    def calibration_effects(self) -> CalibrationEffects | None:
        """What errors of the calibration do to the measurements; None: it is exact"""
        sequence = self.sequence
        return calibration_effects(
            sequence.calibration, self.rectifier, sequence.poses_stated, sequence.has_ranges
        )

    @property
    def workers(self) -> int:
        """Number of processes for parallel work."""
        return worker_count(self.config.runtime.workers)

    def of_frames(self, frames: Ints | Sequence[int]) -> "RunContext":
        """The inputs of a run on some of the frames (n,), ascending, each 0 <= k < F.

        Raises InputError: other numbers, or none.
        """
        numbers, count = np.asarray(frames), len(self.sequence)
        if numbers.ndim != 1 or not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
            raise InputError("frames: give one or more whole numbers, as a list or an array (n,)")
        outside = numbers[(numbers < 0) | (numbers >= count)]
        if outside.size:
            last = count - 1
            raise InputError(f"frames: there is no frame {outside[0]}; the sequence has frames 0 to {last}")
        back = np.flatnonzero(np.diff(numbers.astype(np.int64)) <= 0)
        if back.size:
            before, after = numbers[back[0]], numbers[back[0] + 1]
            raise InputError(f"frames: {after} follows {before}; give each frame once, in ascending order")
        chosen = numbers.astype(np.int64)
        found = self.rectifier.found
        rectifier = self.rectifier if found is None else replace(self.rectifier, found=found.part(chosen))
        return replace(self, sequence=self.sequence.part(chosen), rectifier=rectifier)

    def tracks(self, features: Sequence[StereoFeatures], association: Association) -> StereoTracks:
        """The measurements of associated features, as the back end takes them."""
        sequence = self.sequence
        seen = self.rig, sequence.timestamps_ns, self.X_NR, self.config.frontend.tracks
        sigmas = sequence.sigma_camera_p_m, sequence.sigma_camera_theta_rad
        tracks = to_tracks(features, association, *seen, sigmas)
        X_BR = sequence.calibration.X_BC0 @ self.rectifier.X_CR
        return replace(tracks, X_BR=X_BR, wrench=sequence.wrench, calibration=self.calibration_effects)


def open_context(sequence_folder: Path, config: Config, progress: Progress) -> RunContext:
    """Open the sequence, and find masks where it needs them. Anomalies are logged.

    Raises InputError for what is missing or wrong in the folder.
    """
    sequence = open_sequence(sequence_folder)
    for warning in sequence.warnings:
        _log.warning(warning)
    _log.info("standard deviations of the calibration: %s", prior_of(sequence.calibration).source)
    rectifier = rectifier_of(sequence)
    if rectifier.surroundings:
        _log.warning(SURROUNDINGS)
        sequence = replace(sequence, warnings=(*sequence.warnings, SURROUNDINGS))
    workers = worker_count(config.runtime.workers)
    rectifier = with_found_masks(sequence, rectifier, range(len(sequence)), workers, progress)
    if rectifier.found is not None and (doubts := doubts_of_masks(rectifier.found)):
        _log.warning(doubts)
        sequence = replace(sequence, warnings=(*sequence.warnings, doubts))
    return RunContext(sequence, rectifier, config, progress)


def rectifier_of(sequence: StereoSequence) -> Rectifier:
    """The rectifier of a sequence, which leaves dim surroundings out of masks. Raises InputError."""
    rectifier = make_rectifier(sequence.calibration)
    sampled = np.unique(np.linspace(0, len(sequence) - 1, 8).round().astype(int)).tolist()
    left = (sequence.read_left(k) for k in sampled)
    images = (rectifier(image, 0) for image, mask in left if mask is None)
    return replace(rectifier, surroundings=has_surroundings(images, rectifier.borders[0]))


def with_found_masks(
    sequence: StereoSequence, rectifier: Rectifier, frames: Sequence[int], workers: int, progress: Progress
) -> Rectifier:
    """The rectifier with the masks of these pairs, if they need any: no dark sky, and none are given."""
    background = None if rectifier.surroundings else find_background(sequence, rectifier)
    if background is None:
        return rectifier
    with progress.stage("masks of the target", len(frames)) as advance:
        found = find_masks(sequence, rectifier, background, frames, workers, advance)
    if found is None:
        _log.info("nothing stands before the background, which is %s", background.description)
        return rectifier
    _log.info("the background is not dark: what stands before it, %s, is the target", background.description)
    return replace(rectifier, found=found)


def doubts_of_masks(found: FoundMasks) -> str:
    """What is doubtful about found masks, a sentence that names three frames; empty: nothing."""
    doubtful = doubtful_frames(found)
    if not doubtful:
        return ""
    named = ", ".join(str(k) for k in doubtful[:3]) + (", ..." if len(doubtful) > 3 else "")
    return (
        "the background is not dark, and the masks of the target that were found are doubtful in "
        f"{len(doubtful)} of {len(found.quality)} pairs (frames {named}): the two images, the stereo matches "
        "or the neighbouring frames disagree; look at pictures/masks.jpg, and give masks (masks0/ and "
        "masks1/) if they are wrong"
    )
