"""Depth maps of all pairs, for the fusion: those that are stored already, and the others.

A depth map depends on its pair and the pair's own features only, not on the motion, so that it can be made as
soon as the pair has come. It is stored as the pixels of the target's surroundings that it fills.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.array_files import read_arrays
from polhode.atomic import replaced
from polhode.config.frontend_settings import Frontend
from polhode.dataset import StereoSequence
from polhode.frontend.disparity.depth import DisparityRange, range_of_features
from polhode.frontend.extract import PRELOADED, depth_of_pair, extract_depth
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import Crop, Rectifier, rectified_pair, target_crop
from polhode.pipeline.context import RunContext
from polhode.processes import Background
from polhode.records import DepthMap

PREFIX = "polhode-depth-"
MAX_STORED_BYTES = 2**30
"""Of the depth maps that are kept."""
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
        stored: dict[str, NDArray[Any]] = read_arrays(self._path(k))
        height, width = stored["size"].tolist()
        v0, u0 = stored["corner"].tolist()
        known, target = (
            np.unpackbits(stored[name], axis=1, count=width).astype(np.bool_) for name in ("known", "target")
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


class DepthMaps:
    """Depth maps of all pairs of a run, in order; what is not stored is computed.

    While the motion is solved by one process, ``made_beside`` has another one begin with them.
    """

    def __init__(
        self, context: RunContext, features: Sequence[StereoFeatures], stored: DepthStore | None = None
    ) -> None:
        """features: of every pair, of the first feature method; stored: what is there already."""
        self._context = context
        self._ranges = [range_of_features(each.uvd_px[:, 2]) for each in features]
        self._temporary: TemporaryDirectory[str] | None = None
        self._store = stored

    def __iter__(self) -> Iterator[DepthMap]:
        context, store, everything = self._context, self._store, range(len(self._ranges))
        stored = set() if store is None else {k for k in everything if k in store}
        missing = [k for k in everything if k not in stored]
        computed = extract_depth(
            context.sequence,
            context.rectifier,
            context.config.frontend,
            self._ranges,
            context.workers,
            missing,
        )
        for k in everything:
            yield store.read(k) if store is not None and k in stored else _as_stored(next(computed))
        self.remove()

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
        self, sequence: StereoSequence, rectifier: Rectifier, config: Frontend, store: DepthStore
    ) -> None:
        self._sequence, self._rectifier, self._config, self._store = sequence, rectifier, config, store
        self._stored_bytes = 0

    def __call__(self, job: tuple[int, DisparityRange]) -> None:
        if self._stored_bytes < MAX_STORED_BYTES:
            k, span = job
            pair = rectified_pair(self._sequence, self._rectifier, k)
            depth = depth_of_pair(pair, self._rectifier.rig, self._config.depth, span)
            self._stored_bytes += self._store.write(k, depth)
