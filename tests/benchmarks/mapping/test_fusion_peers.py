"""Ours beside Open3D: rows of what is there, and a line for what is not."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.mapping.fusion_peers import (
    METHODS,
    cells,
    normals_of,
    read_inputs,
    read_result,
    run_method,
    write_inputs,
)
from polhode.config import Config
from tests.mapping.analytic_depth import RIG, views_of


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.08)
    path = tmp_path / "inputs.npz"
    write_inputs(path, views_of(ball, 10, sigma_m=1e-3), RIG, Config(), 3e-3)
    return path


def test_a_method_gets_what_was_written(inputs: Path) -> None:
    frames, rig, config, voxel_m = read_inputs(inputs)
    expected = views_of(trimesh.creation.icosphere(subdivisions=4, radius=0.08), 10, sigma_m=1e-3)
    assert (rig, config, voxel_m, len(frames)) == (RIG, Config(), 3e-3, len(expected))
    for (depth, X_RG), (as_made, pose) in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(X_RG, pose)
        for name in ("depth_m", "sigma_m", "intensity", "target"):
            np.testing.assert_array_equal(getattr(depth, name), getattr(as_made, name))
            assert getattr(depth, name).dtype == getattr(as_made, name).dtype


@pytest.mark.parametrize("method", ["ours", "ours again"])
def test_ours_makes_the_surface(method: str, inputs: Path, tmp_path: Path) -> None:
    run_method(method, inputs, tmp_path / "output.npz")
    found = read_result(tmp_path / "output.npz")
    assert np.linalg.norm(found["vertices"], axis=1) == pytest.approx(0.08, abs=6e-3)
    assert found["seconds"] > 0.0


def test_colmap_fuses_and_meshes_without_cuda(inputs: Path, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    run_method("colmap", inputs, tmp_path / "output.npz")
    found = read_result(tmp_path / "output.npz")
    assert np.median(np.linalg.norm(found["vertices"], axis=1)) == pytest.approx(0.08, abs=3e-3)


def test_a_plane_has_one_normal_which_looks_at_the_camera() -> None:
    v, u = np.mgrid[: RIG.height_px, : RIG.width_px]
    ray = np.stack([(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones(u.shape)], -1)
    normal = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
    found = normals_of(-0.5 / (ray @ normal), RIG)[2:-2, 2:-2]
    np.testing.assert_allclose(found, np.broadcast_to(normal, found.shape), atol=1e-9)


@pytest.mark.parametrize("method", ["open3d", "colmap"])
def test_a_peer_that_is_not_installed_is_a_row(
    method: str,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for package in ("open3d", "pycolmap"):
        monkeypatch.setitem(sys.modules, package, None)
    run_method(method, inputs, tmp_path / "output.npz")
    found = read_result(tmp_path / "output.npz")
    assert "pip install polhode[mapping-peers]" in str(
        cells(found, trimesh.creation.box(), np.zeros((0, 3)), 10)
    )
    assert set(METHODS) == {"ours", "ours again", "open3d", "colmap"}
