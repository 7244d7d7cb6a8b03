"""Landmarks: marks of the surface, not of the light, at places that single detections scatter around."""

import numpy as np
from numpy.typing import NDArray

from polhode.train.surface.batches import KnownBody
from polhode.train.surface.landmarks import (
    GATHER_PX,
    MIN_IMAGES,
    MIN_SHARE,
    find_landmarks,
    near_rim,
    seen_in,
    surface_at,
)
from polhode.train.surface.lit_bodies import LIT, SKY, LitBody

FOCAL_PX, DEPTH_M = 400.0, 2.0


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
    poses = len(images) // suns
    side = len(images[0])
    depth = np.full((poses, side, side), np.nan, np.float32)
    depth[:, 8:-8, 8:-8] = DEPTH_M
    normal = np.full((poses, side, side, 3), np.nan, np.float16)
    normal[:, 8:-8, 8:-8] = [0.0, 0.0, -1.0]
    light = np.where(np.isfinite(depth), LIT, SKY).astype(np.uint8)
    middle = np.array([side / 2.0, side / 2.0])
    return LitBody(
        grey=np.stack(images),
        light=np.concatenate([light] * suns),
        depth_m=depth,
        normal_K=normal,
        right=np.stack(images[:poses]),
        shift_px=np.zeros(poses, int),
        corner_px=np.zeros((poses, 2), int),
        X_KG=np.tile(np.eye(4), (poses, 1, 1)),
        focal_px=np.array(FOCAL_PX),
        centre_px=middle,
        baseline_m=np.array(0.2),
    )


def test_what_stays_is_a_landmark_and_what_moves_with_the_light_is_none() -> None:
    rng = np.random.default_rng(3)
    marks = np.array([[25.0, 30.0], [60.0, 28.0], [44.0, 62.0]])
    images = [
        dots(np.concatenate([marks + rng.normal(0.0, 0.15, marks.shape), [[20.0 + 7 * k, 48.0]]]))
        for k in range(4)
    ]
    body = plane_body(images, suns=4)
    found = find_landmarks(body)
    good = np.flatnonzero(~found.is_weak)
    seen = seen_in(body, 0, found.p_G[good], found.normal_G[good])
    distance = np.linalg.norm(seen.uv_px[:, None] - marks[None], axis=2)
    # every mark is a landmark, more exactly than any single detection of it
    assert (distance.min(axis=0) < 0.3).all()
    light = np.array([[20.0 + 7 * k, 48.0] for k in range(4)])
    assert np.linalg.norm(seen.uv_px[:, None] - light[None], axis=2).min() > 4.0
    moving = np.linalg.norm(found.uv_px - [20.0, 48.0], axis=1) < 1.0
    assert moving.any()
    assert (found.landmark[moving & (found.view == 0)] == -1).all()


def test_shares_count_the_images_that_see_a_place(bodies: dict[int, KnownBody]) -> None:
    landmarks = bodies[0].landmarks
    good = ~landmarks.is_weak
    assert good.sum() > 30
    assert landmarks.share[good].min() >= MIN_SHARE
    assert landmarks.share.max() <= 1.0
    detections = np.bincount(landmarks.landmark[landmarks.landmark >= 0], minlength=len(landmarks.p_G))
    assert detections[good].min() >= MIN_IMAGES
    assert detections[~good].max(initial=0) == 0


def test_detections_are_near_the_landmark_that_they_show(bodies: dict[int, KnownBody]) -> None:
    body, landmarks = bodies[0].body, bodies[0].landmarks
    for view in range(len(body.grey)):
        own = np.flatnonzero((landmarks.view == view) & (landmarks.landmark >= 0))
        at = landmarks.landmark[own]
        seen = seen_in(body, view, landmarks.p_G[at], landmarks.normal_G[at])
        off = np.linalg.norm(seen.uv_px - landmarks.uv_px[own[seen.index]], axis=1)
        assert len(off) > 10
        assert off.max() < 2.5 * GATHER_PX


def test_places_beside_the_target_have_no_surface(bodies: dict[int, KnownBody]) -> None:
    body = bodies[0].body
    p_K, _ = surface_at(body, 0, np.array([[0.0, 0.0]]))
    assert np.isnan(p_K).all()


def test_rims_are_around_jumps_of_depth() -> None:
    depth = np.full((30, 30), 2.0, np.float32)
    depth[:, 15:] = 2.5
    rim = near_rim(depth)
    assert rim[:, 14:17].all()
    assert not rim[:, :11].any()
    assert not rim[:, 20:].any()


def test_a_body_that_shows_nothing_has_no_landmarks() -> None:
    body = plane_body([np.zeros((60, 60), np.uint8)] * 4, suns=2)
    found = find_landmarks(body)
    assert len(found.p_G) == len(found.view) == 0
