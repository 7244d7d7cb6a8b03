"""Truth of every pixel, against closed forms on plates and balls, and on disk."""

from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.runtime.errors import InputError
from polhode.simulation.bodies.part import Body, Part, assemble
from polhode.simulation.dataset.frame_renderer import (
    CAST_SHADOW,
    FACING_AWAY,
    Products,
    read_products,
    render_products,
    write_products,
)
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, build_cameras
from polhode.simulation.surface.materials import Material

ALL: tuple[config.Product, ...] = get_args(config.Product)
DISTORTED = config.Rig(
    width_px=96,
    height_px=72,
    focal_px=90.0,
    distortion=(-0.2, 0.05, 1e-3, -5e-4),
    right_rotation_deg=(1, -5, 2),
)
MATT = Material(0.4, specular=0.0)


def _box(extents_m: tuple[float, float, float], centre_m: tuple[float, float, float] = (0, 0, 0)) -> Part:
    mesh = trimesh.creation.box(extents_m)
    mesh.apply_translation(centre_m)
    return Part(mesh, MATT)


def _products(body: Body, camera: Camera, X_NG: Array, sun_N: Array) -> Products:
    light = config.Light(sun_direction_N=tuple(sun_N.tolist()))
    renderer = Renderer(body, config.Scene(light=light), 0)
    return render_products(renderer, camera, camera.X_CK, X_NG, ALL)


def test_a_tilted_plate_has_the_depth_and_the_normal_of_its_plane() -> None:
    X_NG = make_pose(exp_so3([0.4, -0.5, 0.3]), [0.03, 0.01, 0.8])
    for camera in build_cameras(DISTORTED):
        truth = _products(assemble([_box((0.4, 0.3, 0.02))]), camera, X_NG, np.array([0.0, 0.0, -1.0]))
        X_KG = inverse_pose(camera.X_CK) @ X_NG
        n_K, corner_K = -X_KG[:3, 2], X_KG[:3] @ [0.0, 0.0, -0.01, 1.0]
        assert truth.depth is not None and truth.normals is not None and truth.mask is not None
        front = truth.mask & (truth.normals @ n_K > 0.9)
        assert front.sum() > 500
        rays = camera.pixel_directions.reshape(*truth.mask.shape, 3)
        expected = (n_K @ corner_K) / (rays @ n_K) * rays[..., 2]
        np.testing.assert_allclose(truth.depth[front], expected[front], atol=1e-9)
        np.testing.assert_allclose(truth.normals[front], np.tile(n_K, (front.sum(), 1)), atol=1e-12)


def test_the_shadow_mask_tells_a_cast_shadow_from_a_face_turned_away() -> None:
    """A small plate 0.18 to 0.20 m before a large one. With the Sun 45 degrees to the right, its shadow spans
    x = -0.05 - 0.20 to 0.05 - 0.18."""
    body = assemble([_box((0.5, 0.5, 0.02)), _box((0.1, 0.1, 0.02), (0, 0, -0.2))])
    camera, _ = build_cameras(config.Rig(width_px=96, height_px=72, focal_px=120.0))
    X_NG = make_pose(np.eye(3), [0.0, 0.0, 1.0])
    truth = _products(body, camera, X_NG, np.array([1.0, 0.0, -1.0]))
    assert truth.shadow is not None
    expected = {-0.24: CAST_SHADOW, -0.19: CAST_SHADOW, -0.14: CAST_SHADOW, -0.12: 0, 0.0: 0, 0.2: 0}
    uv = camera.project(np.array([[x, 0.01, 0.99] for x in expected]))
    column, row = np.rint(uv).astype(int).T
    assert truth.shadow[row, column].tolist() == list(expected.values())
    behind = _products(body, camera, X_NG, np.array([0.3, 0.0, 1.0]))
    assert behind.shadow is not None and behind.mask is not None
    assert (behind.shadow[behind.mask] == FACING_AWAY).all()
    assert (behind.shadow[~behind.mask] == 0).all()


def test_albedo_is_that_of_the_material_and_beside_the_target_nothing_is_known() -> None:
    camera, _ = build_cameras(DISTORTED)
    X_NG = make_pose(exp_so3([0.1, 0.2, 0.0]), [0.0, 0.0, 0.8])
    truth = _products(assemble([_box((0.3, 0.2, 0.05))]), camera, X_NG, np.array([0.2, 0.3, -1.0]))
    assert truth.mask is not None and truth.albedo is not None
    np.testing.assert_allclose(truth.albedo[truth.mask], MATT.albedo)
    assert 0 < truth.mask.sum() < truth.mask.size
    for values in (truth.albedo, truth.depth, truth.normals):
        assert values is not None
        assert np.isnan(values[~truth.mask]).all()
        assert np.isfinite(values[truth.mask]).all()


def test_a_file_holds_what_was_asked_for(tmp_path: Path) -> None:
    camera, _ = build_cameras(DISTORTED)
    renderer = Renderer(assemble([_box((0.3, 0.2, 0.05))]), config.Scene(), 0)
    X_NG = make_pose(np.eye(3), [0.0, 0.0, 0.8])
    write_products(
        tmp_path / "7.npz", render_products(renderer, camera, np.eye(4), X_NG, ("shadow", "depth"))
    )
    found = read_products(tmp_path / "7.npz")
    assert [f.name for f in fields(found) if getattr(found, f.name) is not None] == ["depth", "shadow"]
    assert [path.name for path in tmp_path.iterdir()] == ["7.npz"]


@pytest.mark.parametrize("content", [None, b"", b"not an archive"])
def test_a_missing_or_damaged_file_gives_one_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "7.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"7\.npz.*scene\.render\.products") as caught:
        read_products(path)
    assert "\n" not in str(caught.value)
