"""How certain surface features and their matches are: standard deviations in u, v and disparity.

A feature's place scatters between views more than its disparity does: the detector answers to light as well.
Both follow the disparity's own least squares, which know how sharp the texture is: variance = floor^2 + gain
sigma_ls. (With the square of sigma_ls, as least squares have it, sharp textures of new bodies are believed
too much.) A match's confidence tells more than either feature alone. The numbers are those that

    python -m polhode.train.feature_noise configs/train/features.yaml

prints: maximum likelihood over the true residuals of matches that pass the geometric check, on the training
bodies, each scene counting the same. The form of the law was chosen among four by how each did on bodies,
textures and light of other scenes, so that check does not stand quite by itself.
"""

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.lie import Array
from polhode.records import Ints

UV_FLOOR_PX, UV_GAIN_PX = 0.293, 3.287
"""In the image [px]."""
DISPARITY_FLOOR_PX, DISPARITY_GAIN_PX = 0.0, 0.189
"""Of the disparity [px]."""
UV_CONFIDENCE = (-0.165, -0.126)
DISPARITY_CONFIDENCE = (-0.051, -0.049)
"""Log of a match's variance over the sum of its features': first + second * logit(confidence)."""
_LEAST_LS_PX = 0.01
_SMALLEST, _LARGEST = 1e-4, 1.0 - 1e-4


def feature_sigma(sigma_ls_px: Array) -> Array:
    """Standard deviations (n, 3) [px] of u, v and disparity between views, of features taken alone.

    sigma_ls_px (n,): what the least squares say of the disparity.
    """
    sharp = np.maximum(sigma_ls_px, _LEAST_LS_PX)
    uv = np.sqrt(UV_FLOOR_PX**2 + UV_GAIN_PX * sharp)
    return np.column_stack([uv, uv, np.sqrt(DISPARITY_FLOOR_PX**2 + DISPARITY_GAIN_PX * sharp)])


def match_sigma(a: StereoFeatures, b: StereoFeatures, pairs: Ints, confidence: Array) -> Array:
    """Standard deviations (m, 3) [px] of u, v and disparity between matched features, pairs (m, 2).

    Of a's measurement less that of b's point, moved into a.
    """
    variance = a.sigma_px[pairs[:, 0]] ** 2 + b.sigma_px[pairs[:, 1]] ** 2
    logit = confidence_logit(confidence)
    change = [first + slope * logit for first, slope in (UV_CONFIDENCE, UV_CONFIDENCE, DISPARITY_CONFIDENCE)]
    return np.asarray(np.sqrt(variance * np.exp(np.stack(change, axis=1))))


def confidence_logit(confidence: Array) -> Array:
    """Log odds (m,) of confidences, finite for 0 and 1."""
    p = np.clip(confidence, _SMALLEST, _LARGEST)
    return np.asarray(np.log(p / (1.0 - p)))
