"""The background behind a target that moves: known where other images show it, and only there."""

import cv2
import numpy as np
import pytest

from polhode.frontend.background.background_image import (
    REACH_FRAMES,
    BackgroundImage,
    FirstLook,
    FirstLooks,
    background_images,
    frames_around,
    plane_homography,
    reduced_homography,
)
from polhode.frontend.background.near_layer import near_layer
from polhode.geometry.lie import Array, exp_so3, make_pose
from tests.frontend.background.synthetic_pairs import HEIGHT, INFINITY, RIG, WIDTH, U, V, overlap, texture

FAR = np.clip(texture(1, 110.0, 30.0)[:, :WIDTH], 1, 254).astype(np.uint8)
ELSEWHERE = (90.0, 130.0, 210.0, 250.0)


def looks(u_px: float, grey: tuple[int, int] = (250, 250)) -> FirstLooks:
    """A disk at a column, before a background at infinity; disparity 40 px."""
    disks = [np.hypot(U - u_px + d, V - 115.0) < 30.0 for d in (0.0, 40.0)]
    left, right = (
        FirstLook(np.where(disk, np.uint8(g), FAR), disk) for disk, g in zip(disks, grey, strict=True)
    )
    return left, right


def behind(own: FirstLooks, others: list[FirstLooks]) -> tuple[BackgroundImage, BackgroundImage]:
    """Of cameras at rest, for which both images of infinity are the same."""
    level = type(RIG)(300.0, 161.0, 118.0, 0.1, WIDTH, HEIGHT, 0.0)
    return background_images(own, others, np.zeros(3), level, np.eye(4), np.tile(np.eye(4), (4, 1, 1)))


@pytest.mark.parametrize("sides", [(0, 0), (1, 1), (0, 1), (1, 0)])
def test_the_homography_moves_the_points_of_the_plane(sides: tuple[int, int]) -> None:
    X_NR = make_pose(exp_so3([0.02, -0.05, 0.1]), [0.1, -0.2, 0.3])
    X_NS = make_pose(exp_so3([-0.03, 0.04, 0.0]), [-0.1, 0.1, 0.1])
    p_N = np.array([[0.0, 0.0, 2.5], [1.0, 0.0, (1.0 - 0.03) / 0.4], [0.0, 1.0, (1.0 + 0.05) / 0.4]])

    def pixels(X: Array, side: int, scale: int) -> Array:
        uvd = RIG.project((p_N - X[:3, 3]) @ X[:3, :3])
        uv = np.column_stack([uvd[:, 0] - side * uvd[:, 2], uvd[:, 1]])
        # the centre of the first of the reduced pixels is at (scale - 1) / 2
        return np.column_stack([(uv - 0.5 * (scale - 1)) / scale, np.ones(3)])

    m_N = np.array([0.03, -0.05, 0.4])
    for scale in (1, 2):
        H = reduced_homography(plane_homography(m_N, RIG, X_NR, X_NS, sides), scale)
        moved = pixels(X_NR, sides[0], scale) @ H.T
        np.testing.assert_allclose(moved / moved[:, 2:], pixels(X_NS, sides[1], scale), atol=1e-8)


def test_the_background_is_known_where_the_target_is_elsewhere_in_other_frames() -> None:
    own = looks(170.0)
    for found, look in zip(behind(own, [looks(u) for u in ELSEWHERE]), own, strict=True):
        assert found.known[20:-20, 20:-20].all()
        assert np.abs(found.image - FAR)[look.hidden].max() < 3.0
    left, _ = behind(own, [own] * 4)
    # hidden in both cameras
    always = (np.hypot(U - 170.0, V - 115.0) < 30.0) & (np.hypot(U - 130.0, V - 115.0) < 30.0)
    assert not left.known[always].any()


def test_a_background_that_drifts_is_followed() -> None:
    own, others = looks(170.0), []
    for n, u in enumerate(ELSEWHERE):
        shift = np.array([[1.0, 0.0, 2.0 + n], [0.0, 1.0, -1.0]])
        first, second = (
            FirstLook(
                np.asarray(cv2.warpAffine(each.image, shift, (WIDTH, HEIGHT)), dtype=np.uint8),
                cv2.warpAffine(each.hidden.astype(np.uint8), shift, (WIDTH, HEIGHT)) > 0,
            )
            for each in looks(u)
        )
        others.append((first, second))
    left, _ = behind(own, others)
    inside = own[0].hidden & left.known
    assert inside.sum() > 0.9 * own[0].hidden.sum()
    assert np.median(np.abs(left.image - FAR)[inside]) < 4.0


def test_a_plain_target_that_looks_different_to_both_cameras_is_found_by_what_is_behind_it() -> None:
    """A glossy panel: no texture to match, and no common brightness."""
    own, others = looks(170.0, (60, 160)), [looks(u, (60, 160)) for u in ELSEWHERE]
    layer = near_layer(own[0].image, own[1].image, INFINITY, behind(own, others))
    assert min(overlap(layer.left, own[0].hidden), overlap(layer.right, own[1].hidden)) > 0.95
    assert overlap(near_layer(own[0].image, own[1].image, INFINITY).left, own[0].hidden) < 0.9


@pytest.mark.parametrize("count", [1, 5, 60, 500])
def test_frames_around_are_near_and_spread(count: int) -> None:
    for k in {0, count // 2, count - 1}:
        others = frames_around(k, count)
        assert k not in others and all(0 <= j < count for j in others)
        assert len(others) >= min(count - 1, 20)
        assert all(abs(j - k) <= 2 * REACH_FRAMES for j in others)
