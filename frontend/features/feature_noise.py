"""Noise model of surface features and their matches: standard deviations of u, v and disparity.

A feature's position scatters between views more than its disparity, because the detector also responds to the
light. Both variances follow from the sharpness of the texture, as the least squares of the disparity measure
it: variance = floor^2 + gain * sigma_ls. (With the square of sigma_ls, as least squares suggest, sigmas of
sharp textures are too small on new bodies.) The confidence of a match adds information. The numbers are those
that

    python -m polhode.train.feature_noise configs/train/features.yaml

prints: maximum likelihood over the true residuals of matches that pass the geometric check, on the training
bodies, with equal weight for each scene. The form of the model was chosen among four by their results on
bodies, textures and light of other scenes, so a check on these is not entirely independent.
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
_MIN_SIGMA_LS_PX = 0.01
_MIN_CONFIDENCE, _MAX_CONFIDENCE = 1e-4, 1.0 - 1e-4


def feature_sigma(sigma_ls_px: Array) -> Array:
    """Standard deviations (n, 3) [px] of u, v and disparity between views, of single features.

    sigma_ls_px (n,): standard deviation of the disparity according to its least squares.
    """
    sigma_ls = np.maximum(sigma_ls_px, _MIN_SIGMA_LS_PX)
    uv = np.sqrt(UV_FLOOR_PX**2 + UV_GAIN_PX * sigma_ls)
    return np.column_stack([uv, uv, np.sqrt(DISPARITY_FLOOR_PX**2 + DISPARITY_GAIN_PX * sigma_ls)])


def match_sigma(a: StereoFeatures, b: StereoFeatures, pairs: Ints, confidence: Array) -> Array:
    """Standard deviations (m, 3) [px] of u, v and disparity between matched features, pairs (m, 2).

    They are those of a's measurement minus the projection of b's point, transformed to frame a.
    """
    variance = a.sigma_px[pairs[:, 0]] ** 2 + b.sigma_px[pairs[:, 1]] ** 2
    logit = confidence_logit(confidence)
    change = [first + slope * logit for first, slope in (UV_CONFIDENCE, UV_CONFIDENCE, DISPARITY_CONFIDENCE)]
    return np.asarray(np.sqrt(variance * np.exp(np.stack(change, axis=1))))


def confidence_logit(confidence: Array) -> Array:
    """Log odds (m,) of confidences, finite for 0 and 1."""
    p = np.clip(confidence, _MIN_CONFIDENCE, _MAX_CONFIDENCE)
    return np.asarray(np.log(p / (1.0 - p)))
