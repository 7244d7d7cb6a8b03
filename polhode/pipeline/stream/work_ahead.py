"""What the batch will want of each pair, done while the stream goes on: its depth map, and further links.

Another process does it, at a low priority: it takes the time that the stream leaves. What it does
depends on the pairs alone, so it does not matter how far it gets: the batch does the rest, with the same
result.
"""

import logging
from collections.abc import Collection, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from polhode.config import Config
from polhode.frontend.disparity.depth import range_of_features
from polhode.frontend.extract import PRELOADED, depth_of_pair
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch, match_pair
from polhode.frontend.rectification import Rectifier, rectified_images
from polhode.geometry.lie import Array
from polhode.mapping.fusion.field import KEPT_SHARE, Field, choose_voxel_m
from polhode.mapping.fusion.surface_extraction import empty_surface
from polhode.pipeline.depth_maps import MAX_STORED_BYTES, PackedDepth
from polhode.records.dataset import StereoImages
from polhode.records.surface import SurfaceModel
from polhode.run_directory.finished_stages import DEPTH, StageStore
from polhode.runtime.processes import Background

_log = logging.getLogger(__name__)
MAX_WAITING = 40
"""Pairs that wait for the process; with more, it will not catch up, and the batch does the rest."""

Tried = Mapping[tuple[int, int], PairMatch | None]


@dataclass(frozen=True)
class ComingPair:
    """A pair after its state is known."""

    k: int
    images: StereoImages | None
    """None: its depth is left to the batch"""
    features: StereoFeatures
    tried: Collection[int]
    """Earlier frames that it was matched with"""
    X_RG: Array | None
    """(4, 4) the target in the rectified left camera, in the present frame G; None: the pair shows nothing
    that agrees with the motion"""
    restarts: int
    """Frames G before the present one"""


class Ahead:
    """Keeps another process busy with the pairs that have come, and collects what it has found."""

    def __init__(self, rectifier: Rectifier, config: Config) -> None:
        """rectifier: with which the features are extracted."""
        self._temporary = TemporaryDirectory(prefix="polhode-depth-", ignore_cleanup_errors=True)
        self.depth = StageStore(Path(self._temporary.name))
        """Depth maps, by the number of the pair"""
        self._waiting: list[Future[Tried | SurfaceModel]] = []
        self._tried: dict[tuple[int, int], PairMatch | None] = {}
        work = _Work(rectifier, config, self.depth)
        self._process: Background[ComingPair | None, Tried | SurfaceModel] | None = None
        try:
            self._process = Background(work, PRELOADED)
        except OSError as error:
            _log.info("no process can be started that works ahead: %s", error)

    def add(self, pair: ComingPair) -> None:
        """A pair, later than those before."""
        self._collect()
        if self._process is not None and len(self._waiting) < MAX_WAITING:
            self._submit(pair)

    def surface(self) -> SurfaceModel | None:
        """The surface so far, of the pairs whose depth maps are made; None: nothing works ahead, or the
        process has ended.

        It waits for the pairs before.
        """
        future = self.request_surface()
        found = future.result() if future is not None and future.exception() is None else None
        self._collect()
        return found if isinstance(found, SurfaceModel) else None

    def request_surface(self) -> "Future[Tried | SurfaceModel] | None":
        """The surface of ``surface`` as soon as it is made; None: it will not be, the process has ended."""
        return self._submit(None)

    def finish(self) -> Tried:
        """Stop; returns the links that were tried ahead. The depth maps stay until ``remove``."""
        if self._process is not None:
            self._process.close()
            self._process = None
        self._collect()
        self._waiting.clear()
        return self._tried

    def remove(self) -> None:
        """Stop, and remove the depth maps."""
        self.finish()
        self._temporary.cleanup()

    def _submit(self, item: ComingPair | None) -> "Future[Tried | SurfaceModel] | None":
        future = None if self._process is None else self._process.submit(item)
        if future is None:
            self._process = None
        else:
            self._waiting.append(future)
        return future

    def _collect(self) -> None:
        waiting = []
        for future in self._waiting:
            if not future.done():
                waiting.append(future)
            elif not future.cancelled():
                if (error := future.exception()) is not None:
                    _log.info("not done ahead: %s", error)
                elif not isinstance(found := future.result(), SurfaceModel):
                    self._tried.update(found)
        self._waiting = waiting


class _Work:
    """Runs in the other process, which keeps the features of earlier pairs and the growing surface."""

    def __init__(self, rectifier: Rectifier, config: Config, store: StageStore) -> None:
        self._rectifier, self._config, self._store = rectifier, config, store
        self._features: dict[int, StereoFeatures] = {}
        self._restarts = 0
        self._field: Field | None = None
        self._to_fuse: dict[int, Array] = {}

    def __call__(self, pair: ComingPair | None) -> Tried | SurfaceModel:
        if pair is None:
            return self._surface()
        if pair.images is not None and self._store.bytes < MAX_STORED_BYTES:
            self._make_depth(pair.k, pair.images, pair.features)
        if pair.restarts != self._restarts:
            self._restarts, self._field, self._to_fuse = pair.restarts, None, {}
        if pair.X_RG is not None:
            self._to_fuse[pair.k] = pair.X_RG
        if pair.k >= self._config.frontend.pairs.exhaustive_frames:
            return {}
        self._features[pair.k] = pair.features
        rig, frontend, seed = self._rectifier.rig, self._config.frontend, self._config.seed
        return {
            (i, pair.k): match_pair(self._features, i, pair.k, rig, frontend, seed)
            for i in self._features
            if i < pair.k and i not in pair.tried
        }

    def _make_depth(self, k: int, images: StereoImages, features: StereoFeatures) -> None:
        rectified, rig = rectified_images(images, self._rectifier), self._rectifier.rig
        span = range_of_features(features.uvd_px[:, 2])
        depth = depth_of_pair(rectified, rig, self._config.frontend.depth, span)
        self._store.put(DEPTH, str(k), PackedDepth.of(depth))

    def _surface(self) -> SurfaceModel:
        """Fuse what has come since the last time, at the poses as they were known then."""
        config, rig = self._config.mapping, self._rectifier.rig
        for k, X_RG in self._to_fuse.items():
            packed = self._store.find(DEPTH, str(k), PackedDepth)
            if packed is None:
                continue
            depth = packed.unpacked()
            if self._field is None:
                voxel_m = choose_voxel_m([depth], rig, config)
                self._field = Field(rig, config, voxel_m, KEPT_SHARE * config.memory_mib)
            self._field.add(depth, X_RG)
        self._to_fuse = {}
        return empty_surface(()) if self._field is None else self._field.surface()
