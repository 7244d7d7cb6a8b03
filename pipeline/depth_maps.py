"""Depth maps of all pairs, for the fusion: those that are stored already, and the others.

A depth map depends on its pair and the pair's own features only, not on the motion, so that it can be made as
soon as the pair has come. It is stored as the pixels of the target's surroundings that it fills.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from polhode.config import Frontend
from polhode.dataset import StereoSequence
from polhode.errors import RunFailure
from polhode.frontend.disparity.depth import DisparityRange, range_of_features
from polhode.frontend.extract import PRELOADED, depth_of_pair, extract_depth
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import Crop, RectifiedPair, Rectifier, rectified_pair, target_crop
from polhode.pipeline.context import RunContext
from polhode.pipeline.run_directory.stages import StageStore
from polhode.processes import Background
from polhode.record_files import digest_of, read_record, write_record
from polhode.records import DepthMap

PREFIX, STAGE = "polhode-depth-", "depth"
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


class DepthStore:
    """Depth maps in a folder, one file for each pair."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __contains__(self, k: int) -> bool:
        return self._path(k).is_file()

    @property
    def is_there(self) -> bool:
        """Whether there is a folder to store in."""
        return self.folder.is_dir()

    def write(self, k: int, depth: DepthMap) -> int:
        """Store the depth map of pair k, whole or not at all; returns the size of its file [bytes]."""
        write_record(self._path(k), f"{k}", PackedDepth.of(depth))
        return self._path(k).stat().st_size

    def read(self, k: int) -> DepthMap:
        """The stored depth map of pair k. Raises RunFailure: the file has changed."""
        found = self.packed(k)
        if found is None:
            raise RunFailure(f"{self._path(k)}: changed while in use")
        return found.unpacked()

    def packed(self, k: int) -> PackedDepth | None:
        """The same as it is stored; None: the file has changed."""
        return read_record(self._path(k), f"{k}", PackedDepth)

    def _path(self, k: int) -> Path:
        return self.folder / f"{k:06d}.npz"


@dataclass
class StagedDepth:
    """The same among the results of stages of a run, as far as there is room for them."""

    stages: StageStore
    keys: Sequence[str]
    """Of each pair: what its depth map depends on"""
    bytes: int = 0
    """That were written here"""

    def __contains__(self, k: int) -> bool:
        return self.stages.has(STAGE, self.keys[k])

    @property
    def is_there(self) -> bool:
        """As ``DepthStore.is_there``: a run that is complete has moved."""
        return self.stages.folder is not None and self.stages.folder.is_dir()

    def write(self, k: int, depth: DepthMap) -> int:
        """As ``DepthStore.write``; nothing if there are too many."""
        size = 0
        if self.bytes < MAX_STORED_BYTES:
            size = self.stages.put(STAGE, self.keys[k], PackedDepth.of(depth))
            self.bytes += size
        return size

    def packed(self, k: int) -> PackedDepth | None:
        """As ``DepthStore.packed``."""
        return self.stages.find(STAGE, self.keys[k], PackedDepth)


def depth_keys(context: RunContext, ranges_px: Sequence[DisparityRange]) -> list[str]:
    """What the depth map of each pair depends on: its images, the range of its disparity, the settings."""
    sequence, rectifier, stages = context.sequence, context.rectifier, context.stages
    alike = digest_of(
        replace(rectifier, found=None), Frontend(depth=context.config.frontend.depth).with_digests
    )
    masks = {} if rectifier.found is None else rectifier.found.encoded
    return [
        stages.key(alike, sequence.digest_of_pair(k), masks.get(k), range_px)
        for k, range_px in enumerate(ranges_px)
    ]


def depth_map_of_pair(context: RunContext, pair: RectifiedPair, features: StereoFeatures) -> DepthMap:
    """The depth map of one rectified pair, as the fusion gets it: black away from the target.

    features: of this pair; their disparities limit the search.
    """
    span = range_of_features(features.uvd_px[:, 2])
    depth = depth_of_pair(pair, context.rig, context.config.frontend.depth, span)
    return PackedDepth.of(depth).unpacked()


class DepthMaps:
    """Depth maps of all pairs of a run, in order; what is not stored is computed.

    While the motion is solved by one process, ``made_beside`` has another one begin with them.
    """

    def __init__(
        self, context: RunContext, features: Sequence[StereoFeatures], stored: DepthStore | None = None
    ) -> None:
        """features: of every pair, of the first feature method; stored: what a stream has made already."""
        self._context = context
        self._ranges = [range_of_features(each.uvd_px[:, 2]) for each in features]
        self._temporary: TemporaryDirectory[str] | None = None
        self._store: DepthStore | StagedDepth | None = stored
        self.keys: list[str] = []
        """Those of the results of this stage, if they are stored"""
        if context.stages.keeps:
            self.keys = depth_keys(context, self._ranges)
            if stored is None:
                self._store = StagedDepth(context.stages, self.keys)

    def __iter__(self) -> Iterator[DepthMap]:
        store, everything = self._store, range(len(self._ranges))
        stored = set() if store is None else {k for k in everything if k in store}
        missing = [k for k in everything if k not in stored]
        computed = self._computed(missing) if missing else iter(())
        for k in everything:
            packed = store.packed(k) if store is not None and k in stored else None
            if packed is None:
                depth = next(computed if k not in stored else self._computed([k]))
                if isinstance(store, StagedDepth):
                    store.write(k, depth)
                packed = PackedDepth.of(depth)
            yield packed.unpacked()
        self.remove()

    def _computed(self, pairs: list[int]) -> Iterator[DepthMap]:
        context, frontend = self._context, self._context.config.frontend
        return extract_depth(
            context.sequence, context.rectifier, frontend, self._ranges, context.workers, pairs
        )

    @contextmanager
    def made_beside(self) -> Iterator[None]:
        """Have another process begin with what is missing; at the end of the block it stops."""
        process = self._begin() if self._context.workers > 1 else None
        try:
            yield
        finally:
            if process is not None:
                process.close()

    def remove(self) -> None:
        """Remove what was stored here."""
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = self._store = None

    def _begin(self) -> "Background[tuple[int, DisparityRange], None] | None":
        if self._store is None:
            self._temporary = TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True)
            self._store = DepthStore(Path(self._temporary.name))
        missing = [(k, span) for k, span in enumerate(self._ranges) if k not in self._store]
        if not missing:
            return None
        context = self._context
        work = _Making(context.sequence, context.rectifier, context.config.frontend, self._store)
        try:
            process = Background(work, PRELOADED)
        except OSError:
            # made later, where it is said
            return None
        for job in missing:
            process.submit(job)
        return process


class _Making:
    """Runs in the other process."""

    def __init__(
        self,
        sequence: StereoSequence,
        rectifier: Rectifier,
        config: Frontend,
        store: DepthStore | StagedDepth,
    ) -> None:
        self._sequence, self._rectifier, self._config, self._store = sequence, rectifier, config, store
        self._stored_bytes = 0

    def __call__(self, job: tuple[int, DisparityRange]) -> None:
        if self._stored_bytes < MAX_STORED_BYTES:
            k, span = job
            pair = rectified_pair(self._sequence, self._rectifier, k)
            depth = depth_of_pair(pair, self._rectifier.rig, self._config.depth, span)
            # the last one may end after the run
            if self._store.is_there:
                self._stored_bytes += self._store.write(k, depth)
