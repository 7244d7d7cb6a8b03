"""Mutual nearest neighbours in descriptor space with a ratio test on both sides."""

import kornia.feature
import numpy as np
import torch

from polhode.config.frontend import Frontend
from polhode.frontend.features.methods import Matches
from polhode.frontend.features.stereo import StereoFeatures


class MutualNearest:
    """Kornia's ``match_smnn``: each the other's nearest, and nearer than the second by the ratio."""

    def __init__(self, config: Frontend) -> None:
        self._ratio = config.pairs.ratio

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches whose confidence is one less the distance ratio: 0 where best and second are the same."""
        if min(len(a), len(b)) < 2:
            return Matches(np.zeros((0, 2), np.int64), np.zeros(0))
        with torch.inference_mode():
            descriptors_a, descriptors_b = (torch.from_numpy(frame.descriptors) for frame in (a, b))
            ratio, index = kornia.feature.match_smnn(descriptors_a, descriptors_b, self._ratio)
        return Matches(index.numpy().astype(np.int64), 1.0 - ratio.numpy().ravel().astype(np.float64))
