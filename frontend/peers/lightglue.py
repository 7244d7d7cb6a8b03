"""LightGlue: Lindenberger, Sarlin and Pollefeys, "LightGlue: Local feature matching at light speed", 2023.

Kornia's class downloads its weights in the constructor if it is given the name of the features. Here it is
constructed from the configuration of those features instead, and the weights are loaded from a file.
"""

import re

import numpy as np
import torch
from kornia.feature import LightGlue

from polhode.config.frontend import Frontend
from polhode.errors import InputError
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import Matches
from polhode.frontend.peers.weights import State, fill, load_weights
from polhode.lie import Array

FEATURES = {"rootsift": "sift", "disk": "disk", "aliked": "aliked", "xfeat": "xfeat"}
"""Name of a feature method -> Kornia's name of LightGlue's weights for it."""


class LightGlueMatcher:
    """``MatchMethod``: LightGlue with the weights that were trained for the feature method."""

    def __init__(self, config: Frontend) -> None:
        method = config.features.method
        if method not in FEATURES:
            raise InputError(
                f"frontend.pairs.method lightglue does not go with frontend.features.method {method}; "
                f"there are weights for {', '.join(FEATURES)}"
            )
        name = FEATURES[method]
        setting = f"lightglue_{name}"
        arguments = {key: value for key, value in LightGlue.features[name].items() if key != "weights"}
        arguments["filter_threshold"] = config.pairs.min_confidence
        # Without a name of features nothing is downloaded. Kornia documents None, but its type excludes it.
        self._network = LightGlue(features=None, **arguments)  # type: ignore[arg-type]
        fill(self._network, _renamed(load_weights(setting, config.weights)), setting, config.weights)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches with at least the configured confidence."""
        if min(len(a), len(b)) == 0:
            return Matches.none()
        spans = [np.ptp(frame.uvd_px[:, :2], axis=0) + 1.0 for frame in (a, b)]
        size = np.maximum(*spans)
        with torch.inference_mode():
            found = self._network({"image0": _side(a, size), "image1": _side(b, size)})
        index, confidence = found["matches"][0], found["scores"][0]
        return Matches(index.numpy().astype(np.int64), confidence.numpy().astype(np.float64))


def _side(frame: StereoFeatures, size_px: Array) -> dict[str, torch.Tensor]:
    """Input of LightGlue for one frame; positions are relative to the bounding box of the features."""
    uv = frame.uvd_px[:, :2]
    centred = uv - (uv.min(axis=0) + uv.max(axis=0)) / 2.0 + size_px / 2.0
    side = {
        "keypoints": torch.from_numpy(centred.astype(np.float32))[None],
        "descriptors": torch.from_numpy(frame.descriptors)[None],
        "image_size": torch.from_numpy(size_px.astype(np.float32))[None],
    }
    if frame.angle_rad is not None:
        side["scales"] = torch.from_numpy(frame.scale_px.astype(np.float32))[None]
        side["oris"] = torch.from_numpy(frame.angle_rad.astype(np.float32))[None]
    return side


def _renamed(state: State) -> State:
    """Published names of tensors -> Kornia's: ``self_attn.3.x`` becomes ``transformers.3.self_attn.x``."""
    names = {key: re.sub(r"^(self|cross)_attn\.(\d+)\.", r"transformers.\2.\1_attn.", key) for key in state}
    return {name.removeprefix("matcher."): state[key] for key, name in names.items()}
