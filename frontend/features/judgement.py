"""Which candidates of an image will be found again, and how far their places scatter, by the surface
network."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from polhode.frontend.features.stereo import texture_sigma
from polhode.frontend.networks.precision import multiplies_in_bfloat16
from polhode.frontend.networks.surface import STRIDE_PX, SurfaceNet, known_of_points
from polhode.frontend.networks.weights import load_weights, shipped_path
from polhode.frontend.rectification import Image, target_crop
from polhode.lie import Array
from polhode.records import Bools

NAME = "surface"
"""Name of the shipped weights."""


@dataclass(frozen=True)
class PointJudgement:
    """What the network says of n points."""

    reliability: Array
    """(n,) probability that the most similar descriptor of another image, in which it is lit, is the right
    one"""
    sigma_px: Array
    """(n,) standard deviation of the place between images, each axis [px]"""


@cache
def surface_network(path: Path | None = None) -> SurfaceNet:
    """The network with the weights of a file, or the shipped ones. Raises InputError as ``load_weights``."""
    network = SurfaceNet()
    load_weights(network, path or shipped_path(NAME))
    return network


def judge(
    network: SurfaceNet, image: Image, mask: Bools, uv_px: Array, scale_px: Array, cosine: Array
) -> PointJudgement:
    """Judge points uv (n, 2) of a rectified image (H, W) on the target, which ``mask`` (H, W) shows.

    scale_px (n,): standard deviation of the blob's Gaussian; cosine (n,): between the surface's normal and
    ray.
    """
    crop = target_crop(mask)
    if crop is None or len(uv_px) == 0:
        return PointJudgement(np.zeros(len(uv_px)), np.ones(len(uv_px)))
    part = image[crop.v0 : crop.v1, crop.u0 : crop.u1]
    filled = np.pad(part, ((0, -part.shape[0] % STRIDE_PX), (0, -part.shape[1] % STRIDE_PX)))
    places = uv_px - [crop.u0, crop.v0]
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
        judged, _ = network(
            torch.from_numpy(filled[None, None].astype(np.float32)),
            torch.zeros(len(uv_px), dtype=torch.int64),
            _tensor(places),
            known_of_points(_tensor(scale_px), _tensor(cosine), _tensor(texture_sigma(image, uv_px))),
        )
    return PointJudgement(
        torch.sigmoid(judged.reliability).numpy().astype(np.float64),
        judged.log_sigma.exp().numpy().astype(np.float64),
    )


def _tensor(values: Array) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
