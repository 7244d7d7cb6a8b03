"""Edges side by side, what profiles tell of them, poses from edges and the accuracy that is expected it."""

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.expected_tracking import (
    WHITE_DN,
    around_camera,
    expected_profiles,
    expected_tracking,
    lit_from,
)
from polhode.planning.edges.observability_metric import edge_motion, moved, observability, pose_error
from polhode.planning.edges.profiles import (
    BLUR_PX,
    MIN_NOISE_DN,
    Displacements,
    Levels,
    _root_column,
    as_levels,
    fitted,
    gradient_extrema,
    profiles,
    searched,
)
from polhode.planning.edges.stripes import (
    FLOOR_PX,
    LINES,
    SAMPLED_PX,
    UNIFORM_SIGMA,
    Stripes,
    stripe_information,
    stripes_across,
    times_measured,
)
from polhode.planning.edges.tracking import PosePrior, TrackingOptions, track_edges
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point
from polhode.simulation.bodies.part import join
from tests.planning.edges.scenes import BOX, POSE, RIG, bevelled_box, drawn


@pytest.fixture(scope="module")
def box() -> EdgeModel:
    return edge_model(trimesh.creation.box(BOX))


def line(across_px: float, turn_deg: float = 0.0, feature: int = 0) -> ControlPoints:
    """Points of an edge through (across, 0) of the image; without a turn, its normal is along u."""
    turn = np.deg2rad(turn_deg)
    normal = np.array([np.cos(turn), np.sin(turn)])
    along = np.arange(-20.0, 20.1, SAMPLED_PX)
    return on_line(np.array([across_px, 0.0]) + along[:, None] * [-normal[1], normal[0]], normal, feature)


def on_line(uv: Array, normal: Array, feature: int = 0) -> ControlPoints:
    m = len(uv)
    sides = np.tile(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (m, 1, 1))
    return ControlPoints(
        np.zeros((m, 3)), uv, np.tile(normal, (m, 1)), np.full(m, feature), np.ones(m), sides
    )


def joined(*lines: ControlPoints) -> ControlPoints:
    names = [each.name for each in fields(ControlPoints)]
    return ControlPoints(*(np.concatenate([getattr(each, name) for each in lines]) for name in names))


def at_origin(stripes: Stripes) -> tuple[Array, Array]:
    found = np.isfinite(stripes.offset_px[0])
    order = np.argsort(stripes.offset_px[0, found])
    return stripes.offset_px[0, found][order], stripes.width_px[0, found][order]


POINT = line(0.0)[np.array([10])]


@pytest.mark.parametrize(
    ("others", "offset", "width"),
    [
        ([0.6], [0.3], [0.6]),
        ([-0.8, 0.9], [0.05], [1.7]),
        ([3.0], [0.0, 3.0], [0.0, 0.0]),
        ([3.0, 3.4, -2.0], [-2.0, 0.0, 3.2], [0.0, 0.0, 0.4]),
        ([9.0], [0.0], [0.0]),
        ([1.5 * k for k in range(1, LINES + 3)], [1.5 * k for k in range(LINES)], [0.0] * LINES),
    ],
)
def test_edges_nearer_than_a_pixel_are_one_stripe(
    others: list[float], offset: list[float], width: list[float]
) -> None:
    every = joined(line(0.0), *(line(each, feature=k + 1) for k, each in enumerate(others)))
    found = at_origin(stripes_across(POINT, every, POSE, 20.0 if len(others) > 3 else 8.0))
    assert np.allclose(found[0], offset) and np.allclose(found[1], width)


def test_a_slanting_edge_is_where_it_crosses_the_normal_and_a_steep_one_is_none() -> None:
    every = joined(line(0.0), line(2.5, 30.0, feature=1), line(4.0, 80.0, feature=2))
    stripes = stripes_across(POINT, every, POSE, 8.0)
    assert np.allclose(at_origin(stripes)[0], [0.0, 2.5])
    assert np.nanmax(stripes.slope[0]) == pytest.approx(np.tan(np.deg2rad(30.0)))


def test_edges_of_a_box_that_face_alike_are_of_one_class() -> None:
    model = edge_model(trimesh.creation.box((0.8, 0.55, 0.35)))
    points = control_points(model, RIG, POSE, SPACING_PX)
    stripes = stripes_across(points, every_point(model, RIG, POSE, SAMPLED_PX), POSE, 5.0)
    # nine edges of three faces are visible, no two of which lie between the same faces
    assert stripes.classes == len(np.unique(points.feature)) == 9
    for feature in np.unique(points.feature):
        assert len(np.unique(stripes.light[points.feature == feature])) == 1
    assert np.nanmax(stripes.width_px[:, 0]) < 0.1
    # the side turns with the normal of the point
    both = stripes_across(joined(POINT, line(0.0, 180.0)[np.array([10])]), line(0.0), POSE, 5.0)
    assert both.light.tolist() == [0, 0] and both.side[0] == -both.side[1]
    # points of outlines are on a curved surface
    model = edge_model(trimesh.creation.cylinder(radius=0.3, height=0.8, sections=48))
    turned = make_pose(POSE[:3, :3], [0.0, 0.0, 3.0])
    points = every_point(model, RIG, turned, 2.0)
    outline = points.feature >= len(model.ends_G)
    assert outline.any() and not outline.all()
    assert np.array_equal(stripes_across(points, points, turned, 6.0).curved, outline)


def test_places_in_stripes_are_eliminated_as_least_squares_would() -> None:
    rng = np.random.default_rng(1)
    f, d, weight = rng.standard_normal((30, 6)), rng.standard_normal(30), rng.uniform(0.5, 2.0, 30)
    spread, light = 0.5 * rng.standard_normal(30), rng.integers(0, 4, 30)
    found = stripe_information(f, d, weight, spread, light, 4)
    # unknowns: the step and the places, with a prior of one sigma for each place
    A = np.hstack([f, np.zeros((30, 4))])
    A[np.arange(30), 6 + light] = spread
    N = A.T @ (weight[:, None] * A) + np.diag([0.0] * 6 + [1.0] * 4)
    x = np.linalg.solve(N, A.T @ (weight * d))
    step = np.asarray(np.linalg.solve(found.C, found.pull), dtype=np.float64)
    assert np.allclose(step, x[:6]) and np.allclose(found.places(step), x[6:])
    assert np.allclose(np.linalg.inv(found.C), np.linalg.inv(N)[:6, :6])
    # the place in the stripe stays, however well its step is seen by many points
    f, spread, one = np.tile(np.eye(6)[0], (1000, 1)), np.full(1000, UNIFORM_SIGMA), np.zeros(1000, int)
    many = stripe_information(f, np.zeros(1000), np.full(1000, 100.0), spread, one, 1)
    assert 1.0 / many.C[0, 0] == pytest.approx(1.0 / 12.0, rel=1e-3)


def test_edges_two_pixels_apart_are_measured_twice_and_count_once() -> None:
    lines = joined(line(0.0, feature=0), line(2.2, feature=1), line(9.0, feature=2))
    times = times_measured(lines, lines)
    assert times.tolist() == 21 * [2.0] + 21 * [2.0] + 21 * [1.0]


@pytest.mark.parametrize("z", [-12.0, -0.71, 0.43, 5.5])
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


BEVEL_M = 0.004
"""1.3 px at the range of POSE"""
POINTS = 40


def column(offset_px: float) -> ControlPoints:
    """Points on a vertical line of an image of 100 x 60 px, at u = 50 and an offset."""
    v = np.linspace(10.0, 50.0, POINTS)
    return on_line(np.column_stack([np.full(POINTS, 50.0 + offset_px), v]), np.array([1.0, 0.0]))


def pair() -> ControlPoints:
    """Two lines, two pixels apart."""
    return joined(column(0.0), column(2.0))


def stepped(steps: list[tuple[float, float]], noise: float, seed: int = 0) -> Levels:
    """Image of vertical steps (place, height), blurred as an edge of a profile is, less the interpolation."""
    u = np.arange(100.0)
    sigma = np.sqrt(BLUR_PX**2 - 1.0 / 6.0)
    row = 40.0 + sum(height * norm.cdf((u - place) / sigma) for place, height in steps)
    return as_levels(row + noise * np.random.default_rng(seed).standard_normal((60, 100)))


def displacement(image: Levels, points: ControlPoints, stripes: Stripes, half_px: float) -> Displacements:
    return fitted(*profiles(image, points, half_px), stripes)


@pytest.mark.parametrize("true_px", [-0.8, 0.0, 0.35])
@pytest.mark.parametrize("heights", [(100.0, 60.0), (100.0, -80.0)])
def test_two_edges_are_found_displaced_together(true_px: float, heights: tuple[float, float]) -> None:
    image = stepped([(50.0 + true_px, heights[0]), (52.0 + true_px, heights[1])], 0.0)
    points = column(0.0)
    stripes = stripes_across(points, pair(), POSE, 6.0)
    found = displacement(image, points, stripes, 4.0)
    assert np.abs(found.shift_px - true_px).max() < 0.02
    assert found.spread_px.max() == 0.0
    best, good = searched(*profiles(image, points, 5.5), stripes, 4.0)
    assert good.all() and np.abs(best - true_px).max() <= 0.3
    if true_px >= 0.0:
        # one of the two is dark: the nearer is taken
        found = displacement(stepped([(50.0 + true_px, 90.0)], 0.0), points, stripes, 4.0)
        assert np.abs(found.shift_px - true_px).max() < 0.02


def test_the_sigma_of_a_displacement_is_that_of_the_noise() -> None:
    noise, points = 4.0, column(0.0)
    assert noise > MIN_NOISE_DN
    stripes = stripes_across(points, points, POSE, 6.0)
    shifts, sigmas = [], []
    for seed in range(30):
        found = displacement(stepped([(50.0, 60.0)], noise, seed), points, stripes, 4.0)
        shifts.append(found.shift_px)
        sigmas.append(found.sigma_px)
    # the profile is the mean over five pixels, whose residuals its sigma is made of
    assert np.std(shifts) == pytest.approx(np.median(sigmas), rel=0.25)
    # a profile without a step tells nothing
    assert displacement(stepped([], 0.0), points, stripes, 4.0).sigma_px.min() > 50.0
    assert not searched(*profiles(stepped([], 1.0), points, 5.5), stripes, 4.0)[1].any()


@pytest.fixture(scope="module")
def bevelled() -> EdgeModel:
    return edge_model(bevelled_box(BOX, BEVEL_M))


@pytest.fixture(scope="module")
def image(bevelled: EdgeModel) -> Array:
    return drawn(bevelled.surface, POSE)


def off_px(model: EdgeModel, X_RG: Array) -> float:
    """Largest displacement of the box's corners in the image."""
    corners = np.asarray(model.surface.vertices)
    there, here = (RIG.project(corners @ X[:3, :3].T + X[:3, 3])[:, :2] for X in (POSE, X_RG))
    return float(np.linalg.norm(there - here, axis=1).max())


def test_a_body_with_bevels_is_found_to_a_fraction_of_a_pixel(bevelled: EdgeModel, image: Array) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        step = np.concatenate([0.01 * rng.standard_normal(3), np.deg2rad(1.0) * rng.standard_normal(3)])
        found = track_edges(bevelled, RIG, image, moved(POSE, step, bevelled.centre_G))
        assert found.converged and found.reason == "" and found.agreement > 0.9
        error = pose_error(found.X_RG, POSE, bevelled.centre_G)
        assert error @ np.linalg.solve(found.covariance, error) < 22.5  # chi-squared of six, 99.9 %
        assert off_px(bevelled, found.X_RG) < 0.15
    again = track_edges(bevelled, RIG, image, moved(POSE, step, bevelled.centre_G))
    assert np.array_equal(again.X_RG, found.X_RG)


def test_edges_that_are_known_keep_half_of_the_edges_from_being_mistaken(
    bevelled: EdgeModel, image: Array
) -> None:
    half = bevelled.only(np.arange(0, len(bevelled.ends_G), 2))
    start = moved(POSE, np.full(6, 0.004), bevelled.centre_G)
    alone, helped = (track_edges(half, RIG, image, start, known=each) for each in (None, bevelled))
    assert off_px(bevelled, helped.X_RG) < 0.3 and helped.agreement > 0.9
    assert off_px(bevelled, helped.X_RG) < off_px(bevelled, alone.X_RG) + 0.02
    # what cannot be tracked says why
    behind = track_edges(bevelled, RIG, image, make_pose(np.eye(3), [0.0, 0.0, -2.0]))
    assert not behind.converged and behind.reason == "the target is behind the camera"
    dark = track_edges(bevelled, RIG, np.zeros_like(image), POSE)
    assert not dark.converged and "too few" in dark.reason


def test_a_prior_holds_what_the_edges_do_not_determine(box: EdgeModel) -> None:
    # parallel edges leave the translation along them open
    along = np.abs(box.ends_G[:, 1] - box.ends_G[:, 0])
    parallel = box.only(np.flatnonzero(along[:, 0] > 0.9 * box.lengths_m))
    drawing, o_G = drawn(box.surface, POSE), box.centre_G
    off_G = np.array([0.01, 0.006, 0.0])
    start = moved(POSE, np.concatenate([POSE[:3, :3] @ off_G, np.zeros(3)]), o_G)
    prior = PosePrior(start, np.repeat([0.01, 0.01], 3) ** -2.0 * np.eye(6))
    found = track_edges(parallel, RIG, drawing, start, options=TrackingOptions(prior=prior))
    error_G = POSE[:3, :3].T @ pose_error(found.X_RG, POSE, o_G)[:3]
    assert found.converged and found.information.describe_unobservable()
    assert np.isclose(error_G[0], off_G[0], atol=5e-4) and abs(error_G[1]) < 1e-3
    strong = PosePrior(POSE, 1e12 * np.eye(6))
    held = track_edges(box, RIG, drawing, start, options=TrackingOptions(prior=strong))
    assert np.abs(pose_error(held.X_RG, POSE, o_G)).max() < 1e-4
    # segments that are poorly known weigh less
    exact = track_edges(box, RIG, drawing, POSE)
    rough = track_edges(box, RIG, drawing, POSE, options=TrackingOptions(sigma_m=np.full(box.size, 1e-3)))
    assert rough.converged
    assert np.trace(rough.information.C) < 0.5 * np.trace(exact.information.C)


def test_extrema_of_the_gradient_are_where_the_steps_are() -> None:
    image = stepped([(50.3, 60.0), (46.0, -40.0), (53.5, 3.0)], 0.0)
    place = gradient_extrema(image, column(0.0), 6.0, 4.0)
    assert (np.isfinite(place).sum(axis=1) == 2).all()
    np.testing.assert_allclose(np.nanmax(place, axis=1), 0.3, atol=0.05)
    np.testing.assert_allclose(np.nanmin(place, axis=1), -4.0, atol=0.05)
    assert not np.isfinite(gradient_extrema(image, column(48.0), 6.0, 4.0)).any()


def lit_cylinder(place: float, radius_px: float, cosine: float) -> Levels:
    """Image of a cylinder along the columns whose right limb is at ``place``, Lambertian, before the sky.

    ``cosine`` of the angle between its normals at the limb and the Sun, which is between limb and camera.
    """
    u = np.arange(-0.495, 99.5, 0.01)
    out = np.clip((u - place + radius_px) / radius_px, -1.0, 1.0)
    light = 200.0 * np.maximum(cosine * out + np.sqrt(1.0 - cosine**2) * np.sqrt(1.0 - out**2), 0.0)
    fine = gaussian_filter1d(np.where(u < place, light, 0.0), 0.8 / 0.01)
    return as_levels(np.tile(fine.reshape(100, 100).mean(axis=1), (60, 1)))


@pytest.mark.parametrize(("cosine", "radius_px"), [(0.3, 120.0), (0.6, 30.0)])
def test_the_outline_of_a_cylinder_is_found_where_it_is(cosine: float, radius_px: float) -> None:
    points, true_px = column(0.0), 0.3
    image = lit_cylinder(50.0 + true_px, radius_px, cosine)
    stripes = stripes_across(points, points, POSE, 6.0)
    assert not stripes.curved.any()
    as_step = displacement(image, points, stripes, 3.0).shift_px - true_px
    curved = replace(stripes, curved=np.ones(POINTS, dtype=bool))
    found = displacement(image, points, curved, 3.0)
    assert np.abs(found.shift_px - true_px).max() < 0.04
    if cosine < 0.5:
        # taken as a step, the limb seems to be where the surface is bright
        assert as_step.max() < -0.25


def angle_deg(a: Array, b: Array) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def test_earth_and_sun_are_on_both_sides_of_the_camera() -> None:
    to_camera = np.array([0.0, 0.0, -1.0])
    for light in around_camera(5, 30.0), lit_from(np.array([[0.0, 0.0, -2.0], [1.0, 2.0, -2.0]])):
        for sun, earth in zip(light.sun_R, light.earth_R, strict=True):
            assert np.linalg.norm(sun) == pytest.approx(1.0) and angle_deg(sun, earth) == pytest.approx(100.0)
            assert angle_deg(sun, to_camera) + angle_deg(to_camera, earth) == pytest.approx(100.0)


def test_profiles_of_a_box_are_lit_by_lambert(box: EdgeModel) -> None:
    points = control_points(box, RIG, POSE, SPACING_PX)
    sun = np.array([0.3, -0.5, -0.8])
    grey = expected_profiles(box, points, RIG, POSE, lit_from(sun, earth=0.0))[0]
    normals = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) @ POSE[:3, :3].T
    levels = np.append(WHITE_DN * np.maximum(normals @ (sun / np.linalg.norm(sun)), 0.0), 0.0)
    # both ends of a profile show a face of the box or the sky, but where it crosses a corner
    ends = grey[:, [0, -1]]
    off = np.abs(ends[:, :, None] - levels).min(axis=2)
    assert np.median(off) < 0.3 and np.mean(off < 1.0) > 0.8


def test_of_a_box_in_good_light_it_is_the_metric(box: EdgeModel) -> None:
    found, points = expected_tracking(box, RIG, POSE), control_points(box, RIG, POSE, SPACING_PX)
    f = edge_motion(points, RIG, POSE, box.centre_G)
    ratio = found.sigma / (FLOOR_PX * observability(f, points.weight, box.radius_m).sigma)
    # the noise of the image comes on top of the floor
    assert (ratio > 1.0).all() and (ratio < 2.0).all()
    assert (np.abs(found.displacement) < 0.5 * found.sigma).all()
    # a floor that is larger than the noise of the image makes edges as much worse
    rough = expected_tracking(box, RIG, POSE, floor_px=0.5)
    ratio = np.sqrt(np.diagonal(rough.information.covariance) / np.diagonal(found.information.covariance))
    assert (ratio > 5.0).all() and (ratio < 10.0).all()
    # no edges and no light tell nothing
    away = expected_tracking(box, RIG, make_pose(np.eye(3), [50.0, 0.0, 3.0]))
    dark = expected_tracking(box, RIG, POSE, lit_from(np.array([0.1, 0.0, 1.0]), earth=0.0))
    assert "no edge is visible" in away.information.describe_unobservable()
    assert not np.isfinite(away.sigma).any() and not np.isfinite(dark.sigma).any()


def test_an_edge_between_faces_that_are_equally_light_tells_nothing(box: EdgeModel) -> None:
    # the bisector of the three faces that are seen: their common edges have no contrast, outlines have
    facing = np.sign((POSE[:3, :3] @ np.diag([1.0, 1.0, 1.0]))[2])
    sun = -(POSE[:3, :3] @ facing)
    even, uneven = (
        expected_tracking(box, RIG, POSE, lit_from(each)) for each in (sun, np.array([0.5, -0.2, -1.0]))
    )
    assert (even.sigma[3:] > 1.1 * uneven.sigma[3:]).all()


def test_a_bevel_costs_accuracy_and_edges_that_are_not_used_disturb(box: EdgeModel) -> None:
    bevelled = edge_model(bevelled_box(BOX, 0.004))
    assert (expected_tracking(bevelled, RIG, POSE).sigma > expected_tracking(box, RIG, POSE).sigma).all()
    half = bevelled.only(np.arange(0, len(bevelled.ends_G), 2))
    disturbed, known = (expected_tracking(half, RIG, POSE, known=each) for each in (None, bevelled))
    assert np.linalg.norm(disturbed.sigma / known.sigma) > np.sqrt(6.0)


def test_what_the_model_lacks_displaces_the_pose(box: EdgeModel) -> None:
    # a ridge along an edge of the box, which the model does not have, casts its shadow beside it
    ridge = trimesh.creation.box((0.9 * BOX[0], 0.012, 0.03))
    ridge.apply_translation([0.0, 0.5 * BOX[1] - 0.03, -0.5 * BOX[2]])
    whole = edge_model(join([trimesh.creation.box(BOX), ridge]))
    blind = replace(
        box, surface=whole.surface, occluder=whole.occluder, corner_normals_G=whole.corner_normals_G
    )
    clean = expected_tracking(box, RIG, POSE)
    disturbed = expected_tracking(blind, RIG, POSE)
    sigma = np.sqrt(np.diagonal(clean.information.covariance))
    assert np.abs(disturbed.displacement / sigma).max() > 3.0 * np.abs(clean.displacement / sigma).max()
