"""Depth maps on disk: what is read is what was written, and what is stored is not computed again."""

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.pipeline.depth_maps import MARGIN_PX, DepthMaps, PackedDepth, freed_depth
from polhode.records.calibration_effects import CalibrationEffects, terms_at
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


@pytest.mark.parametrize(("longer", "shift_px"), [(0.004, 0.0), (0.0, 0.4), (-0.003, -0.3)])
def test_a_plane_seen_by_a_wrong_calibration_is_where_it_is(longer: float, shift_px: float) -> None:
    rig = RectifiedRig(300.0, 60.0, 45.0, 0.1, SIZE[1], SIZE[0])
    true = replace(rig, focal_px=rig.focal_px * (1.0 + longer), cx_px=rig.cx_px + shift_px)
    v, u = np.indices(SIZE, dtype=np.float64)

    def plane(seen_by: RectifiedRig) -> Any:
        """Depth of z = 1 + 0.5 x - 0.2 y in each pixel."""
        x, y = (u - seen_by.cx_px) / seen_by.focal_px, (v - seen_by.cy_px) / seen_by.focal_px
        return 1.0 / (1.0 - 0.5 * x + 0.2 * y)

    # the disparities that the true cameras give, read with the stated ones
    known = np.zeros(SIZE, dtype=np.bool_)
    known[10:80, 10:110] = True
    depth_m, sigma_m = (
        np.where(known, each, np.nan).astype(np.float32) for each in (plane(true) / (1.0 + longer), 1e-2)
    )
    depth = DepthMap(depth_m, sigma_m, np.zeros(SIZE, np.uint8), known)
    # both lenses alike: of the place in the image, to which disparities add nothing
    places = np.random.default_rng(0).uniform([0.0, 0.0], [SIZE[1] - 1.0, SIZE[0] - 1.0], (400, 2))
    moved = longer * (places - [rig.cx_px, rig.cy_px]) + [shift_px, 0.0]
    terms: Array = np.linalg.lstsq(terms_at(places, rig), moved)[0][:, :, None].astype(np.float64)
    none = np.zeros((3, 1))
    correction = CalibrationEffects("test", terms, terms, none, none, np.zeros(1), none, none)
    found = freed_depth(rig, correction, depth).depth_m
    # where the right image shows it too
    inner = np.s_[12:78, 35:108]
    np.testing.assert_array_equal(np.isfinite(found), known)
    np.testing.assert_allclose(found[inner], plane(rig)[inner], atol=3e-5)
    # what follows from the slope is bounded where depth jumps
    stepped = replace(depth, depth_m=np.where(u < 60, depth_m, depth_m + 1.0).astype(np.float32))
    assert np.nanmax(np.abs(freed_depth(rig, correction, stepped).depth_m - stepped.depth_m)) < 0.06
    # a frame in the dark has none
    dark = replace(depth, depth_m=np.full(SIZE, np.nan, dtype=np.float32))
    assert not np.isfinite(freed_depth(rig, correction, dark).depth_m).any()
