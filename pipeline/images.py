"""The sequence on disk as a run sees it: rectified, with the inspector's poses."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polhode.config import Config
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification.rectify import Rectifier, make_rectifier
from polhode.frontend.tracks.tracks import Association, to_tracks
from polhode.lie import Array
from polhode.records import StereoTracks

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Images:
    """The sequence on disk and how to rectify it."""

    sequence: StereoSequence
    rectifier: Rectifier

    @property
    def time_s(self) -> Array:
        """(F,) since the first pair [s]"""
        return np.asarray((self.sequence.timestamps_ns - self.sequence.timestamps_ns[0]) * 1e-9)

    @property
    def X_NR(self) -> Array:
        """(F, 4, 4) rectified left camera"""
        return np.asarray(self.sequence.X_NC @ self.rectifier.X_CR)

    def tracks(
        self, features: Sequence[StereoFeatures], association: Association, config: Config
    ) -> StereoTracks:
        """The back end's measurements of what is associated."""
        tracks = to_tracks(
            features,
            association,
            self.rectifier.rig,
            self.sequence.timestamps_ns,
            self.X_NR,
            config.frontend.tracks,
            (self.sequence.sigma_camera_p_m, self.sequence.sigma_camera_theta_rad),
        )
        X_BR = self.sequence.calibration.X_BC0 @ self.rectifier.X_CR
        return replace(tracks, X_BR=X_BR, wrench=self.sequence.wrench)


def open_images(folder: Path) -> Images:
    """Raises InputError for what is missing or wrong in the folder; what is odd in it is logged."""
    sequence = open_sequence(folder)
    for warning in sequence.warnings:
        _log.warning(warning)
    return Images(sequence, make_rectifier(sequence.calibration))
