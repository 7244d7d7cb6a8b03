"""Whether the inspector's attitude swings slowly, unreported: the target's path and attitude show it.

``inspector_check`` compares attitudes from frame to frame, and sees no swing that takes many frames. Such a
swing displaces the target across the line of sight and turns it, at once and in the ratio that its distance
prescribes; no force and torque do this (``backend/outliers_and_noise/inspector_swing.py``). It shows also
where the inspector claims to be at rest.
"""

import numpy as np

from polhode.backend.outliers_and_noise.inspector_swing import find_swing
from polhode.backend.part import solved_again
from polhode.config.backend_settings import Backend
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import MotionEstimate, StereoTracks

MAX_EVIDENCE_GAIN = 6.0
"""Odds of four hundred. Of 340 good runs without a swing, most of them from images and with other faults, the
largest gain is 4.3."""
MAX_FRAMES = 120
"""Longer sequences are thinned out to this number."""


def swing_check(tracks: StereoTracks, estimate: MotionEstimate, config: Backend) -> Check:
    """How much better a swing explains the motion than forces and torques do; not possible with few data."""
    check = Check(
        name="evidence that the inspector's attitude swings", limit=MAX_EVIDENCE_GAIN, unit="log odds"
    )
    frames = np.arange(0, tracks.n_frames, -(-tracks.n_frames // MAX_FRAMES))
    solution = solved_again(tracks, estimate, config, frames)
    swing = None if solution is None else find_swing(solution)
    if swing is None:
        return check
    return check.judged(
        max(swing.evidence_gain, 0.0),
        "the target's path and its attitude swing together as they would if the inspector's attitude did, by "
        f"about {np.rad2deg(swing.rms_rad):.2f} deg beside what is reported: no force and torque on the "
        "target are tied to one another like this; check inspector0/, or supply it where the inspector does "
        "not keep its attitude",
    )
