"""Depth maps of all pairs, for the fusion: those that are stored already, and the others.

A depth map depends on its pair and the pair's own features only, not on the motion, so that it can be made as
soon as the pair has come. It is stored as the pixels of the target's surroundings that it fills.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.atomic import replaced
from polhode.frontend.disparity.depth import range_of_features
from polhode.frontend.extract import extract_depth
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import Crop, target_crop
from polhode.pipeline.context import RunContext
from polhode.records import DepthMap

MARGIN_PX = 12
"""Around the target, of the image that is stored; beyond, a stored image is black."""


class DepthStore:
    """Depth maps in a folder, one file for each pair."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __contains__(self, k: int) -> bool:
        return self._path(k).is_file()

    def write(self, k: int, depth: DepthMap) -> int:
        """Store the depth map of pair k, whole or not at all; returns the size of its file [bytes]."""
        height, width = depth.target.shape
        part, known = _stored_part(depth), np.isfinite(depth.depth_m)
        with replaced(self._path(k)) as path, path.open("wb") as stream:
            np.savez(
                stream,
                size=np.array([height, width]),
                corner=np.array([part[0].start, part[1].start]),
                known=np.packbits(known, axis=1),
                depth_m=depth.depth_m[known],
                sigma_m=depth.sigma_m[known],
                intensity=depth.intensity[part],
                target=np.packbits(depth.target, axis=1),
            )
        return self._path(k).stat().st_size

    def read(self, k: int) -> DepthMap:
        """The stored depth map of pair k. What it does not fill is black, and its depth NaN."""
        with np.load(self._path(k), allow_pickle=False) as stored:
            height, width = stored["size"].tolist()
            v0, u0 = stored["corner"].tolist()
            known, target = (
                np.unpackbits(stored[name], axis=1, count=width).astype(np.bool_)
                for name in ("known", "target")
            )
            depth_m, sigma_m = (np.full((height, width), np.nan, dtype=np.float32) for _ in range(2))
            depth_m[known], sigma_m[known] = stored["depth_m"], stored["sigma_m"]
            part = stored["intensity"]
        intensity = np.zeros((height, width), dtype=np.uint8)
        intensity[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]] = part
        return DepthMap(depth_m=depth_m, sigma_m=sigma_m, intensity=intensity, target=target)

    def _path(self, k: int) -> Path:
        return self.folder / f"{k:06d}.npz"


def _stored_part(depth: DepthMap) -> tuple[slice, slice]:
    """Rows and columns of the image that are stored."""
    crop = target_crop(depth.target, MARGIN_PX) or Crop(0, 0, 0, 0)
    return slice(crop.v0, crop.v1), slice(crop.u0, crop.u1)


def _as_stored(depth: DepthMap) -> DepthMap:
    """The depth map as if it had been stored and read: a run does not depend on when it was made."""
    intensity = np.zeros_like(depth.intensity)
    part = _stored_part(depth)
    intensity[part] = depth.intensity[part]
    return replace(depth, intensity=intensity)


def depth_maps(
    context: RunContext, features: Sequence[StereoFeatures], stored: DepthStore | None = None
) -> Iterator[DepthMap]:
    """Depth map of every pair, in order; what is not stored is computed.

    features: of every pair, of the first feature method.
    """
    ranges = [range_of_features(each.uvd_px[:, 2]) for each in features]
    missing = [k for k in range(len(ranges)) if stored is None or k not in stored]
    computed = extract_depth(
        context.sequence, context.rectifier, context.config.frontend, ranges, context.workers, missing
    )
    waiting = set(missing)
    for k in range(len(ranges)):
        if k in waiting or stored is None:
            yield _as_stored(next(computed))
        else:
            yield stored.read(k)
