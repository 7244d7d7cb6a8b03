"""One size of surface patches for a whole sequence, in metres.

With each frame's own size, that of its median distance, panels that swing to and fro change it by a fifth,
and a panelled craft loses half its matches; patches tolerate a tenth.
"""

import numpy as np

from polhode.config.frontend import Frontend
from polhode.dataset import StereoSequence
from polhode.frontend.features.surface_features import matched_disparity, patch_half_m
from polhode.frontend.rectification.rectified_pair import rectified_pair
from polhode.frontend.rectification.rectify import Rectifier

SAMPLES = 6
"""Pairs of the sequence that are measured."""


def with_patch_size(config: Frontend, sequence: StereoSequence, rectifier: Rectifier) -> Frontend:
    """The configuration with ``features.patch_half_m`` set, where its method needs it and it is not.

    The size is that of the median distance over pairs all along the sequence. It stays open when the target
    is in none of them.
    """
    if config.features.method != "polhode" or config.features.patch_half_m is not None:
        return config
    frames = np.unique(np.round(np.linspace(0, len(sequence) - 1, SAMPLES)).astype(int))
    distance = np.array([_distance_m(config, sequence, rectifier, int(k)) for k in frames])
    if not np.isfinite(distance).any():
        return config
    half_m = patch_half_m(float(np.nanmedian(distance)), rectifier.rig)
    features = config.features.model_copy(update={"patch_half_m": half_m})
    return config.model_copy(update={"features": features})


def _distance_m(config: Frontend, sequence: StereoSequence, rectifier: Rectifier, k: int) -> float:
    """Median distance of the target in pair k [m]; NaN when it is not seen."""
    rig = rectifier.rig
    disparity = matched_disparity(rectified_pair(sequence, rectifier, k), rig, config.depth)
    offset = disparity - np.float32(rig.disparity_offset_px)
    known = offset[np.isfinite(offset) & (offset > 0.5)]
    return rig.focal_px * rig.baseline_m / float(np.median(known)) if len(known) else float("nan")
