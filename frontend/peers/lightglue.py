"""LightGlue: Lindenberger, Sarlin and Pollefeys, "LightGlue: Local feature matching at light speed", 2023.

Kornia's class downloads its weights in the constructor when it is told the features' name; built from the
bare configuration of those features it does not, and the file of ours is put in.
"""

import re

import numpy as np
import torch
from kornia.feature import LightGlue

from polhode.config.frontend import Frontend
from polhode.errors import InputError
from polhode.frontend.features.methods import Matches
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.peers.weights import State, fill, load_weights
from polhode.lie import Array

FEATURES = {"rootsift": "sift", "disk": "disk", "aliked": "aliked", "xfeat": "xfeat"}
"""Our name of a feature method -> Kornia's name of LightGlue's weights for it."""


class LightGlueMatcher:
    """Attention within and between the two frames' features, with the weights made for those features."""

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
        # No name of features: nothing is downloaded. Kornia documents it, its type does not.
        self._network = LightGlue(features=None, **arguments)  # type: ignore[arg-type]
        fill(self._network, _renamed(load_weights(setting, config.weights)), setting, config.weights)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches at least as sure as the configured confidence."""
        if min(len(a), len(b)) == 0:
            return Matches(np.zeros((0, 2), np.int64), np.zeros(0))
        spans = [np.ptp(frame.uvd_px[:, :2], axis=0) + 1.0 for frame in (a, b)]
        size = np.maximum(*spans)
        with torch.inference_mode():
            found = self._network({"image0": _side(a, size), "image1": _side(b, size)})
        index, confidence = found["matches"][0], found["scores"][0]
        return Matches(index.numpy().astype(np.int64), confidence.numpy().astype(np.float64))


def _side(frame: StereoFeatures, size_px: Array) -> dict[str, torch.Tensor]:
    """One frame as LightGlue takes it: positions in the box of the features, as in a picture full of them."""
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
    """Names of the released files -> Kornia's: ``self_attn.3.x`` is ``transformers.3.self_attn.x`` there."""
    names = {key: re.sub(r"^(self|cross)_attn\.(\d+)\.", r"transformers.\2.\1_attn.", key) for key in state}
    return {name.removeprefix("matcher."): state[key] for key, name in names.items()}
