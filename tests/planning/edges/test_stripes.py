"""Edges side by side: which of them are one stripe, and what distances to stripes tell."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad
from scipy.stats import norm

from polhode.geometry.lie import Array
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.stripe_profiles import BLUR_PX, _root_column
from polhode.planning.edges.stripes import (
    LINES,
    SAMPLED_PX,
    UNIFORM_SIGMA,
    Stripes,
    stripe_information,
    stripes_across,
    times_measured,
)
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point
from tests.planning.edges.pictures import POSE, RIG


def line(
    across_px: float, turn_deg: float = 0.0, spacing_px: float = SAMPLED_PX, feature: int = 0
) -> ControlPoints:
    """Points of an edge through (across, 0) of the image; without a turn, its normal is along u."""
    turn = np.deg2rad(turn_deg)
    normal = np.array([np.cos(turn), np.sin(turn)])
    along = np.arange(-20.0, 20.1, spacing_px)
    uv = np.array([across_px, 0.0]) + along[:, None] * np.array([-normal[1], normal[0]])
    count = len(along)
    sides = np.tile(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (count, 1, 1))
    points = (
        np.zeros((count, 3)),
        uv,
        np.tile(normal, (count, 1)),
        np.full(count, feature),
        np.ones(count),
        sides,
    )
    return ControlPoints(*points)


def joined(*lines: ControlPoints) -> ControlPoints:
    names = ("p_G", "uv_px", "normal_px", "feature", "weight", "sides_G")
    return ControlPoints(*(np.concatenate([getattr(each, name) for each in lines]) for name in names))


def at_origin(stripes: Stripes) -> tuple[Array, Array]:
    found = np.isfinite(stripes.offset_px[0])
    order = np.argsort(stripes.offset_px[0, found])
    return stripes.offset_px[0, found][order], stripes.width_px[0, found][order]


POINT = line(0.0)[np.array([10])]


@pytest.mark.parametrize(
    ("others", "offset", "width"),
    [
        ([], [0.0], [0.0]),
        ([0.0], [0.0], [0.0]),
        ([0.6], [0.3], [0.6]),
        ([-0.8, 0.9], [0.05], [1.7]),
        ([3.0], [0.0, 3.0], [0.0, 0.0]),
        ([3.0, 3.4, -2.0], [-2.0, 0.0, 3.2], [0.0, 0.0, 0.4]),
        ([9.0], [0.0], [0.0]),
    ],
)
def test_edges_nearer_than_a_pixel_are_one_stripe(
    others: list[float], offset: list[float], width: list[float]
) -> None:
    every = joined(line(0.0), *(line(each, feature=k + 1) for k, each in enumerate(others)))
    found = at_origin(stripes_across(POINT, every, POSE, 8.0))
    assert np.allclose(found[0], offset) and np.allclose(found[1], width)


def test_a_slanting_edge_is_where_it_crosses_the_normal_and_a_steep_one_is_none() -> None:
    every = joined(line(0.0), line(2.5, 30.0, feature=1), line(4.0, 80.0, feature=2))
    stripes = stripes_across(POINT, every, POSE, 8.0)
    assert np.allclose(at_origin(stripes)[0], [0.0, 2.5])
    assert np.nanmax(stripes.slope[0]) == pytest.approx(np.tan(np.deg2rad(30.0)))


def test_the_nearest_stripes_are_kept() -> None:
    offsets = 1.5 * np.arange(1, LINES + 3)
    every = joined(*(line(each, feature=k) for k, each in enumerate(offsets)))
    found, _ = at_origin(stripes_across(POINT, every, POSE, 20.0))
    assert np.allclose(found, [0.0, *offsets[: LINES - 1]])


def test_edges_of_a_box_that_face_alike_are_of_one_class() -> None:
    model = edge_model(trimesh.creation.box((0.8, 0.55, 0.35)))
    points = control_points(model, RIG, POSE, SPACING_PX)
    stripes = stripes_across(points, every_point(model, RIG, POSE, SAMPLED_PX), POSE, 5.0)
    # nine edges of three faces are visible, no two of which lie between the same faces
    assert stripes.classes == len(np.unique(points.feature)) == 9
    for feature in np.unique(points.feature):
        assert len(np.unique(stripes.light[points.feature == feature])) == 1
    assert np.nanmax(stripes.width_px[:, 0]) < 0.1


def test_the_side_turns_with_the_normal_of_the_point() -> None:
    turned = line(0.0, 180.0)[np.array([10])]
    both = joined(POINT, turned)
    stripes = stripes_across(both, line(0.0), POSE, 5.0)
    assert stripes.light.tolist() == [0, 0] and stripes.side[0] == -stripes.side[1]


def random_distances(
    seed: int, count: int = 30, classes: int = 4
) -> tuple[Array, Array, Array, Array, np.ndarray]:
    rng = np.random.default_rng(seed)
    f, d = rng.standard_normal((count, 6)), rng.standard_normal(count)
    return (
        f,
        d,
        rng.uniform(0.5, 2.0, count),
        0.5 * rng.standard_normal(count),
        rng.integers(0, classes, count),
    )


def test_places_in_stripes_are_eliminated_as_least_squares_would() -> None:
    f, d, weight, spread, light = random_distances(1)
    found = stripe_information(f, d, weight, spread, light, 4)
    # unknowns: the step and the places, with a prior of one sigma for each place
    A = np.hstack([f, np.zeros((30, 4))])
    A[np.arange(30), 6 + light] = spread
    N = A.T @ (weight[:, None] * A) + np.diag([0.0] * 6 + [1.0] * 4)
    x = np.linalg.solve(N, A.T @ (weight * d))
    step = np.asarray(np.linalg.solve(found.C, found.pull), dtype=np.float64)
    assert np.allclose(step, x[:6]) and np.allclose(found.places(step), x[6:])
    assert np.allclose(np.linalg.inv(found.C), np.linalg.inv(N)[:6, :6])


def test_points_along_a_stripe_do_not_count_as_often_as_there_are() -> None:
    f = np.tile([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], (1000, 1))
    width_px = 1.0
    spread = np.full(1000, UNIFORM_SIGMA * width_px)
    found = stripe_information(
        f, np.zeros(1000), np.full(1000, 100.0), spread, np.zeros(1000, dtype=np.int64), 1
    )
    # the place in the stripe stays, however well its step is seen
    assert 1.0 / found.C[0, 0] == pytest.approx(width_px**2 / 12.0, rel=1e-3)


def test_edges_two_pixels_apart_are_measured_twice_and_count_once() -> None:
    lines = joined(line(0.0, feature=0), line(2.2, feature=1), line(9.0, feature=2))
    times = times_measured(lines, lines)
    assert times.tolist() == 21 * [2.0] + 21 * [2.0] + 21 * [1.0]


@pytest.mark.parametrize("z", [-12.0, -3.2, -0.71, 0.0, 0.43, 2.5, 5.5])
def test_the_blurred_root_is_the_integral_and_its_derivative(z: float) -> None:
    def root(z: float) -> float:
        # the distance is s squared, which leaves nothing singular
        peak = np.sqrt(max(-z, 0.0))
        value, _ = quad(lambda s: 2.0 * s * s * norm.pdf(s * s + z), 0.0, peak + 4.0, points=[peak])
        return float(value)

    found, by_shift = _root_column(np.array([[z * BLUR_PX]]), np.array([True]))
    assert found.item() == pytest.approx(root(z), abs=1e-5)
    slope = (root(z + 1e-3) - root(z - 1e-3)) / 2e-3
    assert by_shift.item() == pytest.approx(-slope / BLUR_PX, abs=2e-3)
