"""Two layers of synthetic pairs: far planes, a target before them, and signs that something is wrong."""

import numpy as np
import pytest

from polhode.frontend.background.far_plane import (
    FarPlane,
    border_matches,
    find_far_plane,
    plane_in_N,
    plane_seen_from,
    reduced_image,
)
from polhode.frontend.background.find_masks import MAX_CONTRADICTED
from polhode.frontend.background.near_layer import near_layer
from polhode.geometry.lie import Array, exp_so3, make_pose
from tests.frontend.background.synthetic_pairs import (
    HEIGHT,
    INFINITY,
    RIG,
    WALL,
    WIDTH,
    U,
    V,
    overlap,
    pair_of,
    texture,
)

FAR, NEAR = texture(1, 110.0, 30.0), texture(2, 110.0, 30.0)
BRIGHT, PLAIN, BLACK = texture(1, 120.0, 30.0, 4.0), *(np.full((HEIGHT, 2 * WIDTH), n) for n in (100.0, 4.0))
LIMB = texture(1, 120.0, 20.0, 4.0)
LIMB[:100] = 2.0


@pytest.mark.parametrize("plane", [INFINITY, WALL], ids=["infinity", "wall"])
def test_a_far_plane_is_found_in_one_pair(plane: FarPlane) -> None:
    left, right, *_ = pair_of(plane, FAR, NEAR)
    found = find_far_plane(border_matches(left, right, 0.0))
    assert found is not None and (plane is WALL or found == INFINITY)
    np.testing.assert_allclose(found.corners(WIDTH, HEIGHT), plane.corners(WIDTH, HEIGHT), atol=1.0)


@pytest.mark.parametrize(
    ("plane", "far", "near"),
    [
        (INFINITY, FAR, NEAR),
        (WALL, FAR, NEAR),
        (INFINITY, BRIGHT, texture(2, 22.0, 5.0)),
        (INFINITY, LIMB, texture(2, 90.0, 35.0)),
        (INFINITY, BRIGHT, BLACK),
    ],
    ids=["as bright", "before a wall", "dark side", "limb and black sky", "black before a bright background"],
)
def test_a_target_is_found_in_both_images(plane: FarPlane, far: Array, near: Array) -> None:
    left, right, disk, disk_right = pair_of(plane, far, near)
    layer = near_layer(left, right, plane)
    assert min(overlap(layer.left, disk), overlap(layer.right, disk_right)) > 0.95
    assert layer.quality.area == pytest.approx(np.pi * 50.0**2 / (HEIGHT * WIDTH), rel=0.05)
    if far is FAR:
        quality = layer.quality
        assert quality.agreement > 0.95 and quality.contradicted < 0.05 and quality.far_share > 0.9


def test_what_is_wrong_shows_in_the_quality() -> None:
    """A target that is plain and not found, a background alone, and a background that is elsewhere."""
    left, right, disk, _ = pair_of(INFINITY, BRIGHT, PLAIN)
    layer = near_layer(left, right, INFINITY)
    assert overlap(layer.left, disk) < 0.5 and layer.quality.contradicted > 2.0 * MAX_CONTRADICTED
    left, right, *_ = pair_of(WALL, FAR, NEAR, radius_px=0.0)
    layer = near_layer(left, right, WALL)
    assert not layer.left.any() and not layer.right.any()
    assert layer.quality.area == 0.0 and np.isnan(layer.quality.agreement)
    left, right, *_ = pair_of(WALL, FAR, NEAR)
    assert near_layer(left, right, INFINITY).quality.far_share < 0.5


def test_the_edge_of_what_a_rectified_image_shows_is_no_background() -> None:
    left, right, *_ = pair_of(INFINITY, np.full((HEIGHT, 2 * WIDTH), 110.0), NEAR)
    seen = np.abs(U - 170.0) < 130.0 + 0.1 * V, np.abs(U - 160.0) < 130.0 + 0.1 * V
    left, right = np.where(seen[0], left, np.uint8(0)), np.where(seen[1], right, np.uint8(0))
    assert find_far_plane(border_matches(left, right, 0.0)) is not None
    assert find_far_plane(border_matches(left, right, 0.0, seen)) is None
    layer = near_layer(left, right, INFINITY, seen=seen)
    assert not (layer.left & ~seen[0]).any() and not (layer.right & ~seen[1]).any()


def test_a_plane_seen_from_elsewhere_is_where_its_points_are() -> None:
    X_NR = make_pose(exp_so3([0.02, -0.05, 0.1]), [0.1, -0.2, 0.3])
    m_N = np.array([0.03, -0.05, 0.4])
    plane = plane_seen_from(m_N, RIG, X_NR)
    # three points of the plane in N
    p_N = np.array([[0.0, 0.0, 2.5], [1.0, 0.0, (1.0 - 0.03) / 0.4], [0.0, 1.0, (1.0 + 0.05) / 0.4]])
    uvd = RIG.project((p_N - X_NR[:3, 3]) @ X_NR[:3, :3])
    np.testing.assert_allclose(uvd[:, 2], plane.a * uvd[:, 0] + plane.b * uvd[:, 1] + plane.c, atol=1e-9)
    np.testing.assert_allclose(plane_in_N(plane, RIG, X_NR), m_N, atol=1e-12)
    assert plane_seen_from(np.zeros(3), RIG, X_NR) == FarPlane(0.0, 0.0, 4.0)


def test_a_reduced_plane_has_the_disparity_of_the_reduced_pixels() -> None:
    reduced = WALL.reduced(4)
    # the mean of columns 8 to 11 and rows 12 to 15 is column 2, row 3
    middle = WALL.a * 9.5 + WALL.b * 13.5 + WALL.c
    assert 4.0 * (reduced.a * 2 + reduced.b * 3 + reduced.c) == pytest.approx(middle)
    assert reduced.enlarged(4).c == pytest.approx(WALL.c)
    assert reduced_image(np.zeros((HEIGHT + 3, WIDTH + 1), dtype=np.uint8), 4).shape == (60, 80)
