"""The learned method: a network refines semi-global disparities and fills what they leave open."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polhode.config.depth import Depth
from polhode.frontend.disparity.crop import Crop
from polhode.frontend.disparity.network import refine
from polhode.frontend.disparity.start import classical_start
from polhode.frontend.networks.disparity import DisparityNet
from polhode.frontend.networks.weights import load_weights, shipped_path

Floats = NDArray[np.float32]
NAME = "disparity"


def learned_disparity(crop: Crop, config: Depth) -> tuple[Floats, Floats]:
    """Disparities and their standard deviations (h, w) [px]; NaN where the right camera sees nothing."""
    start = classical_start(crop, config)
    if start is None:
        nothing = np.full(crop.target.shape, np.nan, dtype=np.float32)
        return nothing, nothing.copy()
    refined = refine(_network(config.weights), start)
    known = crop.target & (refined.visible > config.min_visible)
    return (
        np.where(known, refined.disparity, np.float32(np.nan)),
        np.where(known, refined.sigma, np.float32(np.nan)),
    )


@lru_cache(maxsize=2)
def _network(path: str | None) -> DisparityNet:
    """The network with the shipped weights, or those at ``path``; read once in a process."""
    network = DisparityNet()
    load_weights(network, shipped_path(NAME) if path is None else Path(path))
    return network
