"""What every step of a run works with: the images, the configuration, progress for the user, stage times."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TypeVar

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config import Config
from polhode.dataset import StereoSequence, open_sequence
from polhode.errors import InputError
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import Image, Rectifier, make_rectifier
from polhode.frontend.segmentation import has_surroundings
from polhode.frontend.tracks.tracks import Association, to_tracks
from polhode.lie import Array
from polhode.pipeline.found_background import doubts_of_masks, with_found_masks
from polhode.pipeline.run_directory.stages import StageStore
from polhode.processes import worker_count
from polhode.progress import Progress, Silent
from polhode.records import Ints, StereoTracks

LOOKED_AT = 8
"""Images in which surroundings are looked for."""
SURROUNDINGS = (
    "every image shows dim surroundings around a bright target, up to its border: they are taken for "
    "background; if they belong to the target, give masks (masks0/ and masks1/)"
)

_log = logging.getLogger(__name__)
Item = TypeVar("Item")


@dataclass
class Stopwatch:
    """Seconds spent in each stage: ``with clock("fusion"): ...``."""

    seconds: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=perf_counter)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - begin

    def waiting(self, stage: str, items: Iterator[Item]) -> Iterator[Item]:
        """Pass the items on; the time until each one arrives counts for the stage."""
        while True:
            with self(stage):
                item = next(items, None)
            if item is None:
                return
            yield item

    def add(self, seconds: Mapping[str, float]) -> None:
        """Add the seconds that another process spent in stages while this one went on."""
        for stage, more in seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + more

    def add_total(self) -> None:
        """Record the time since the start, which includes what belongs to no stage."""
        self.seconds["total"] = perf_counter() - self.start


@dataclass(frozen=True)
class RunContext:
    """The inputs of a run, opened, and its services."""

    sequence: StereoSequence
    rectifier: Rectifier
    config: Config
    progress: Progress
    clock: Stopwatch = field(default_factory=Stopwatch)
    stages: StageStore = field(default_factory=StageStore)
    """Results of finished stages, which are used again"""

    def for_another_process(self) -> "RunContext":
        """The same inputs, without the display of the progress and with a clock of its own."""
        return replace(self, progress=Silent(), clock=Stopwatch())

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
    def workers(self) -> int:
        """Number of processes for parallel work."""
        return worker_count(self.config.runtime.workers)

    def of_frames(self, frames: Ints | Sequence[int]) -> "RunContext":
        """The inputs of a run on some of the frames (n,), ascending, each 0 <= k < F.

        Raises InputError: other numbers, or none.
        """
        chosen = _ascending(frames, len(self.sequence))
        found = self.rectifier.found
        rectifier = self.rectifier if found is None else replace(self.rectifier, found=found.part(chosen))
        return replace(self, sequence=self.sequence.part(chosen), rectifier=rectifier)

    def tracks(self, features: Sequence[StereoFeatures], association: Association) -> StereoTracks:
        """The measurements of associated features, as the back end takes them."""
        sequence = self.sequence
        tracks = to_tracks(
            features,
            association,
            self.rig,
            sequence.timestamps_ns,
            self.X_NR,
            self.config.frontend.tracks,
            (sequence.sigma_camera_p_m, sequence.sigma_camera_theta_rad),
        )
        return replace(tracks, X_BR=sequence.calibration.X_BC0 @ self.rectifier.X_CR, wrench=sequence.wrench)


def _ascending(frames: Ints | Sequence[int], count: int) -> Ints:
    """The numbers of frames (n,) as an array. Raises InputError unless they are 0 <= k < count, ascending."""
    numbers = np.asarray(frames)
    if numbers.ndim != 1 or not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
        raise InputError("frames: give one or more whole numbers, as a list or an array (n,)")
    outside = numbers[(numbers < 0) | (numbers >= count)]
    if outside.size:
        raise InputError(f"frames: there is no frame {outside[0]}; the sequence has frames 0 to {count - 1}")
    back = np.flatnonzero(np.diff(numbers.astype(np.int64)) <= 0)
    if back.size:
        before, after = numbers[back[0]], numbers[back[0] + 1]
        raise InputError(f"frames: {after} follows {before}; give each frame once, in ascending order")
    return numbers.astype(np.int64)


def open_context(sequence_folder: Path, config: Config, progress: Progress) -> RunContext:
    """Start the clock and open the sequence. Anomalies are logged.

    Raises InputError for what is missing or wrong in the folder.
    """
    clock = Stopwatch()
    sequence = open_sequence(sequence_folder)
    for warning in sequence.warnings:
        _log.warning(warning)
    rectifier = rectifier_of(sequence)
    if rectifier.surroundings:
        _log.warning(SURROUNDINGS)
        sequence = replace(sequence, warnings=(*sequence.warnings, SURROUNDINGS))
    with clock("frontend"):
        workers = worker_count(config.runtime.workers)
        rectifier = with_found_masks(sequence, rectifier, range(len(sequence)), workers, progress)
    if rectifier.found is not None and (doubts := doubts_of_masks(rectifier.found)):
        _log.warning(doubts)
        sequence = replace(sequence, warnings=(*sequence.warnings, doubts))
    return RunContext(sequence, rectifier, config, progress, clock)


def rectifier_of(sequence: StereoSequence) -> Rectifier:
    """The rectifier of a sequence, which leaves dim surroundings out of masks. Raises InputError."""
    rectifier = make_rectifier(sequence.calibration)
    surroundings = has_surroundings(_without_masks(sequence, rectifier), rectifier.borders[0])
    return replace(rectifier, surroundings=surroundings)


def _without_masks(sequence: StereoSequence, rectifier: Rectifier) -> Iterator[Image]:
    """Rectified left images of some frames that come without a mask, spread over the sequence."""
    for k in np.unique(np.linspace(0, len(sequence) - 1, LOOKED_AT).round().astype(int)).tolist():
        image, mask = sequence.read_left(k)
        if mask is None:
            yield rectifier(image, 0)
