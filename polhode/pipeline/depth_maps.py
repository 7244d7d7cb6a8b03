"""Depth maps of all pairs, for the fusion: those that are stored already, and the others.

A depth map depends on its pair and the pair's own features only, not on the motion, so that it can be made as
soon as the pair has come. It is stored as the pixels of the target's surroundings that it fills.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.config import Frontend
from polhode.files.record_files import digest_of
from polhode.frontend.disparity.depth import DisparityRange, range_of_features
from polhode.frontend.extract import depth_of_pair, extract_depth
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import Crop, RectifiedPair, Rectifier, rectified_pair, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.pipeline.context import RunContext
from polhode.pipeline.runner import MadeByPair, stage
from polhode.pipeline.stream_results import Streamed
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.dataset import StereoSequence
from polhode.records.surface import DepthMap
from polhode.run_directory.finished_stages import DEPTH, StageStore

MAX_STORED_BYTES = 2**30
"""Of the depth maps that are kept."""
MARGIN_PX = 12
"""Around the target, of the image that is stored; beyond, a stored image is black."""


@dataclass(frozen=True)
class PackedDepth:
    """A depth map as it is stored. What it does not fill is black, and its depth NaN."""

    size: tuple[int, int]
    """Rows and columns of the image"""
    corner: tuple[int, int]
    """First row and column of the part that is stored"""
    known: NDArray[np.uint8]
    """(H, W / 8) bits: where the depth is known"""
    depth_m: NDArray[np.float32]
    """(n,) where it is"""
    sigma_m: NDArray[np.float32]
    """(n,)"""
    intensity: NDArray[np.uint8]
    """(h, w) of the part"""
    target: NDArray[np.uint8]
    """(H, W / 8) bits"""

    @classmethod
    def of(cls, depth: DepthMap) -> "PackedDepth":
        """Of a depth map, without the image far from the target."""
        height, width = depth.target.shape
        crop, known = target_crop(depth.target, MARGIN_PX) or Crop(0, 0, 0, 0), np.isfinite(depth.depth_m)
        return cls(
            size=(height, width),
            corner=(crop.v0, crop.u0),
            known=np.packbits(known, axis=1),
            depth_m=depth.depth_m[known],
            sigma_m=depth.sigma_m[known],
            intensity=depth.intensity[crop.v0 : crop.v1, crop.u0 : crop.u1],
            target=np.packbits(depth.target, axis=1),
        )

    def unpacked(self) -> DepthMap:
        """The depth map."""
        (v0, u0), width = self.corner, self.size[1]
        known, target = (
            np.unpackbits(bits, axis=1, count=width).astype(np.bool_) for bits in (self.known, self.target)
        )
        depth_m, sigma_m = (np.full(self.size, np.nan, dtype=np.float32) for _ in range(2))
        depth_m[known], sigma_m[known] = self.depth_m, self.sigma_m
        intensity = np.zeros(self.size, dtype=np.uint8)
        height, wide = self.intensity.shape
        intensity[v0 : v0 + height, u0 : u0 + wide] = self.intensity
        return DepthMap(depth_m=depth_m, sigma_m=sigma_m, intensity=intensity, target=target)


@dataclass(frozen=True)
class DepthMaps(MadeByPair):
    """Depth maps of all pairs of a run, in order; what is not stored is computed when it is asked for."""

    sequence: StereoSequence
    rectifier: Rectifier
    config: Frontend
    workers: int
    ranges_px: Sequence[DisparityRange]
    """Of the disparities of each pair, in which they are searched"""
    store: StageStore
    keys: Sequence[str]
    """Under which they are stored"""
    max_stored_bytes: int = MAX_STORED_BYTES

    def __len__(self) -> int:
        return len(self.keys)

    def __iter__(self) -> Iterator[DepthMap]:
        return (packed.unpacked() for packed in self._packed(range(len(self))))

    def __getitem__(self, k: Any) -> Any:
        return next(self._packed([k])).unpacked()

    def jobs(self) -> Iterator[Callable[[RunContext], int]]:
        """What makes each missing depth map and stores it; none where there is no place for them."""
        for k, (span, key) in enumerate(zip(self.ranges_px, self.keys, strict=True)):
            if self.store.folder is not None and not self.store.has(DEPTH, key):
                yield partial(_store_depth, self.store, key, k, span)

    def _packed(self, pairs: Sequence[int]) -> Iterator[PackedDepth]:
        def computed(missing: list[int]) -> Iterator[PackedDepth]:
            chosen = [pairs[n] for n in missing]
            shown = self.sequence, self.rectifier, self.config, self.ranges_px
            return map(PackedDepth.of, extract_depth(*shown, self.workers, chosen))

        keys = [self.keys[k] for k in pairs]
        return self.store.each(DEPTH, PackedDepth, keys, computed, self.max_stored_bytes)


def _store_depth(store: StageStore, key: str, k: int, span: DisparityRange, context: RunContext) -> int:
    """Compute the depth map of pair k and store it; returns the bytes of its file."""
    pair = rectified_pair(context.sequence, context.rectifier, k)
    depth = depth_of_pair(pair, context.rig, context.config.frontend.depth, span)
    # the last one may end after the run
    is_there = store.folder is not None and store.folder.is_dir()
    return store.put(DEPTH, key, PackedDepth.of(depth)) if is_there else 0


@stage("depth", ["frontend.depth"], is_stored=False)
def depth_maps_of(
    context: RunContext, features: Sequence[StereoFeatures], streamed: Streamed | None = None
) -> DepthMaps:
    """The depth maps of all pairs.

    features: of every pair, of the first feature method; streamed: what a stream of these pairs has found.
    """
    sequence, rectifier, store = context.sequence, context.rectifier, context.stages
    ranges_px = [range_of_features(each.uvd_px[:, 2]) for each in features]
    settings, keys = Frontend(depth=context.config.frontend.depth), [""] * len(ranges_px)
    if streamed is not None and streamed.depth is not None:
        store, keys = streamed.depth, [str(k) for k in range(len(ranges_px))]
    elif store.folder is not None:
        # what a depth map depends on: its images, the range of its disparity, the settings
        alike = digest_of(replace(rectifier, found=None), settings.with_digests)
        masks = {} if rectifier.found is None else rectifier.found.encoded
        keys = [
            store.key(alike, sequence.digest_of_pair(k), masks.get(k), range_px)
            for k, range_px in enumerate(ranges_px)
        ]
    # stored ones stay with this run, even if it does not need to read them
    for key in keys:
        store.has(DEPTH, key)
    return DepthMaps(sequence, rectifier, settings, context.workers, ranges_px, store, keys)


def freed_depth(rig: RectifiedRig, correction: CalibrationEffects, depth: DepthMap) -> DepthMap:
    """A depth map freed of errors of the calibration (c = 1), as the tracks are.

    Each point moves along its ray, and beside it by less than a pixel: the depth at its new place follows
    from the slope there, by at most the sigma, as depth that jumps has no slope.
    """
    known = np.isfinite(depth.depth_m)
    v, u = np.nonzero(known)
    d = rig.focal_px * rig.baseline_m / depth.depth_m[known].astype(np.float64) + rig.disparity_offset_px
    uvd_px = np.stack([u, v, d], axis=1)
    freed_px = correction.taken_off(rig, uvd_px)
    moved = depth.depth_m.copy()
    moved[known] = rig.triangulate(freed_px)[:, 2]
    slope = np.stack([along[known] for along in np.gradient(moved)[::-1]], axis=1)
    beside = np.sum(np.nan_to_num(slope) * (uvd_px - freed_px)[:, :2], axis=1)
    limit = depth.sigma_m[known]
    moved[known] += np.clip(beside, -limit, limit)
    return replace(depth, depth_m=moved)


def depth_map_of_pair(context: RunContext, pair: RectifiedPair, features: StereoFeatures) -> DepthMap:
    """The depth map of one rectified pair, as the fusion gets it: black away from the target.

    features: of this pair; their disparities limit the search.
    """
    span = range_of_features(features.uvd_px[:, 2])
    depth = depth_of_pair(pair, context.rig, context.config.frontend.depth, span)
    return PackedDepth.of(depth).unpacked()
