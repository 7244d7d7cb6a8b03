"""Depth maps on disk: what is read is what was written, and what is stored is not computed again."""

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.depth_maps import MARGIN_PX, DepthMaps, PackedDepth
from polhode.records.surface import DepthMap
from polhode.run_directory.finished_stages import DEPTH, StageStore

SIZE = 90, 120


def depth_map(seed: int) -> DepthMap:
    rng, target = np.random.default_rng(seed), np.zeros(SIZE, dtype=np.bool_)
    target[40:60, 50:85] = True
    known = target & (rng.random(SIZE) > 0.3)
    depth_m, sigma_m = (np.where(known, rng.random(SIZE), np.nan).astype(np.float32) for _ in range(2))
    return DepthMap(depth_m, sigma_m, rng.integers(0, 255, SIZE, dtype=np.uint8), target)


def assert_equal(found: DepthMap, wanted: DepthMap) -> None:
    for each in fields(DepthMap):
        np.testing.assert_array_equal(getattr(found, each.name), getattr(wanted, each.name))


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    depth, nothing = depth_map(1), np.full(SIZE, np.nan, dtype=np.float32)
    empty = replace(depth, depth_m=nothing, sigma_m=nothing, target=np.zeros(SIZE, dtype=np.bool_))
    store = StageStore(tmp_path)
    size = store.put(DEPTH, "3", PackedDepth.of(depth))
    assert size < 8 * np.isfinite(depth.depth_m).sum() + 10_000
    store.put(DEPTH, "4", PackedDepth.of(empty))
    found, without = (StageStore(tmp_path).find(DEPTH, key, PackedDepth) for key in "34")
    assert found is not None and without is not None
    part = np.s_[40 - MARGIN_PX : 60 + MARGIN_PX, 50 - MARGIN_PX : 85 + MARGIN_PX]
    intensity = found.unpacked().intensity
    np.testing.assert_array_equal(intensity[part], depth.intensity[part])
    assert not np.delete(intensity, np.r_[part[0]], axis=0).any()
    assert_equal(replace(found.unpacked(), intensity=depth.intensity), depth)
    # a pair without the target is stored, too
    assert_equal(without.unpacked(), replace(empty, intensity=np.zeros(SIZE, dtype=np.uint8)))


def test_only_what_is_not_stored_is_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, whole = StageStore(tmp_path), [depth_map(k) for k in range(4)]
    asked: list[list[int]] = []

    def computed(*arguments: Any) -> Iterator[DepthMap]:
        asked.append(arguments[-1])
        return iter([whole[k] for k in arguments[-1]])

    monkeypatch.setattr("polhode.pipeline.depth_maps.extract_depth", computed)
    nothing: Any = None
    maps = DepthMaps(nothing, nothing, nothing, 1, [None] * 4, StageStore(), [""] * 4)
    without = list(maps)
    for k in (0, 2):
        store.put(DEPTH, str(k), PackedDepth.of(whole[k]))
    maps = replace(maps, store=store, keys=list("0123"))
    assert len(list(maps.jobs())) == 2
    for found, wanted in zip(maps, without, strict=True):
        assert_equal(found, wanted)
    assert asked == [[0, 1, 2, 3], [1, 3]]
    assert_equal(maps[3], without[3])
    assert not list(maps.jobs()) and len(asked) == 2
