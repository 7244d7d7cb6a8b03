"""Lit bodies and their landmarks: marks of the surface, not of the light, that single detections scatter
around."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from polhode.config.train_settings import Corpus
from polhode.geometry.lie import transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.descriptor.surface_points import near_rim
from polhode.train.stored import read_record
from polhode.train.surface.landmarks import (
    GATHER_PX,
    MIN_IMAGES,
    MIN_SHARE,
    RIM_PX,
    KnownBody,
    find_landmarks,
    prepare_bodies,
    seen_in,
    surface_at,
)
from polhode.train.surface.lit_bodies import (
    CAST_SHADOW,
    FACING_AWAY,
    LIT,
    SKY,
    LitBody,
    lit_body_path,
    render_lit_body,
)
from tests.train.surface.conftest import CONFIG


def dots(places: NDArray[np.float64], side: int = 90) -> NDArray[np.uint8]:
    """Dark dots on a bright square."""
    v, u = np.mgrid[:side, :side]
    image = np.zeros((side, side))
    image[8:-8, 8:-8] = 180.0
    for x, y in places:
        image -= 120.0 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2.0 * 1.5**2)) * (image > 0)
    return np.clip(image, 0, 255).astype(np.uint8)


def plane_body(images: list[NDArray[np.uint8]], suns: int) -> LitBody:
    """A square that faces the camera in every image."""
    poses, side = len(images) // suns, len(images[0])
    depth = np.full((poses, side, side), np.nan, np.float32)
    depth[:, 8:-8, 8:-8] = 2.0
    normal = np.full((poses, side, side, 3), np.nan, np.float16)
    normal[:, 8:-8, 8:-8] = [0.0, 0.0, -1.0]
    light = np.concatenate([np.where(np.isfinite(depth), LIT, SKY).astype(np.uint8)] * suns)
    poses_KG, middle = np.tile(np.eye(4), (poses, 1, 1)), np.array([side / 2.0, side / 2.0])
    corner = np.zeros((poses, 2), int)
    return LitBody(np.stack(images), light, depth, normal, corner, poses_KG, np.array(400.0), middle)


def test_what_stays_is_a_landmark_and_what_moves_with_the_light_is_none() -> None:
    rng = np.random.default_rng(3)
    marks = np.array([[25.0, 30.0], [60.0, 28.0], [44.0, 62.0]])
    light = np.array([[20.0 + 7 * k, 48.0] for k in range(4)])
    images = [dots(np.concatenate([marks + rng.normal(0.0, 0.15, marks.shape), [at]])) for at in light]
    body = plane_body(images, suns=4)
    found = find_landmarks(body)
    good = np.flatnonzero(~found.is_weak)
    _, seen = seen_in(body, 0, found.p_G[good], found.normal_G[good])
    # every mark is a landmark, more exactly than any single detection of it
    assert (np.linalg.norm(seen.uv_px[:, None] - marks[None], axis=2).min(axis=0) < 0.3).all()
    assert np.linalg.norm(seen.uv_px[:, None] - light[None], axis=2).min() > 4.0
    moving = np.linalg.norm(found.uv_px - [20.0, 48.0], axis=1) < 1.0
    assert moving.any()
    assert (found.landmark[moving & (found.view == 0)] == -1).all()
    # a body that shows nothing has none
    none = find_landmarks(plane_body([np.zeros((60, 60), np.uint8)] * 4, suns=2))
    assert len(none.p_G) == len(none.view) == 0


def test_landmarks_are_near_their_detections_in_a_share_of_the_images(bodies: dict[int, KnownBody]) -> None:
    body, landmarks = bodies[0].body, bodies[0].landmarks
    good = ~landmarks.is_weak
    assert good.sum() > 30
    assert landmarks.share[good].min() >= MIN_SHARE and landmarks.share.max() <= 1.0
    detections = np.bincount(landmarks.landmark[landmarks.landmark >= 0], minlength=len(landmarks.p_G))
    assert detections[good].min() >= MIN_IMAGES and detections[~good].max(initial=0) == 0
    for view in range(len(body.grey)):
        own = np.flatnonzero((landmarks.view == view) & (landmarks.landmark >= 0))
        at = landmarks.landmark[own]
        index, seen = seen_in(body, view, landmarks.p_G[at], landmarks.normal_G[at])
        off = np.linalg.norm(seen.uv_px - landmarks.uv_px[own[index]], axis=1)
        assert len(off) > 10 and off.max() < 2.5 * GATHER_PX


def test_rims_are_around_jumps_of_depth() -> None:
    depth = np.full((30, 30), 2.0, np.float32)
    depth[:, 15:] = 2.5
    rim = near_rim(depth, RIM_PX)
    assert rim[:, 14:17].all() and not rim[:, :11].any() and not rim[:, 20:].any()


def test_images_of_one_pose_differ_in_their_light_alone_and_poses_show_one_surface(
    bodies: dict[int, KnownBody],
) -> None:
    body = bodies[0].body
    assert [body.pose_of(view) for view in range(4)] == [0, 1, 0, 1]
    assert [body.sun_of(view) for view in range(4)] == [0, 0, 1, 1]
    mask = body.on_target(0)
    np.testing.assert_array_equal(body.light[0] == SKY, body.light[2] == SKY)
    np.testing.assert_array_equal(body.light[0] != SKY, mask)
    assert np.abs(body.grey[0].astype(float) - body.grey[2])[mask].mean() > 10.0
    grey, light = body.grey[0].astype(float), body.light[0]
    shadow = np.isin(light, (CAST_SHADOW, FACING_AWAY))
    assert shadow.sum() > 50 and (light == LIT).sum() > 500
    assert grey[light == LIT].mean() > 2.0 * grey[shadow].mean() and grey[light == SKY].mean() < 5.0
    assert np.isnan(surface_at(body, 0, np.array([[0.0, 0.0]])).p_K).all()
    v, u = np.nonzero(mask)
    own = surface_at(body, 0, np.column_stack([u, v])[::31].astype(float))
    own = own[np.asarray(np.isfinite(own.p_K).all(axis=1))]
    np.testing.assert_allclose(np.linalg.norm(own.normal_K, axis=1), 1.0, atol=1e-3)
    p_B = transform_points(body.X_between(1, 0), own.p_K)
    other = surface_at(body, 1, body.rig(1).project(p_B)[:, :2])
    # the rest is hidden in the other pose
    assert (np.abs(other.p_K[:, 2] - p_B[:, 2]) < 2e-3).mean() > 0.6


def test_a_body_depends_on_its_number_alone_and_is_rendered_once(
    lit_body_corpus: Corpus, bodies: dict[int, KnownBody], tmp_path: Path
) -> None:
    again = render_lit_body(lit_body_corpus.model_copy(update={"scenes": 2}), CONFIG, 1)
    np.testing.assert_array_equal(again.grey, bodies[1].body.grey)
    copy = tmp_path / "bodies"
    shutil.copytree(lit_body_corpus.folder, copy)
    corpus = lit_body_corpus.model_copy(update={"folder": str(copy)})
    path = lit_body_path(corpus, CONFIG, 2)
    before = path.stat().st_mtime_ns
    assert len(prepare_bodies(corpus, CONFIG, Silent(), 1)) == 3 and path.stat().st_mtime_ns == before
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="remove this file, and it is made again"):
        read_record(path, LitBody)
