"""Poses from edges: displaced profiles, extrema of the gradient, bodies with bevels, what a prior holds."""

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.image_profiles import Levels, as_levels, gradient_extrema, profiles
from polhode.planning.edges.observability_metric import moved, pose_error
from polhode.planning.edges.stripe_profiles import BLUR_PX, MIN_NOISE_DN, Displacements, fitted, searched
from polhode.planning.edges.stripes import Stripes, stripes_across
from polhode.planning.edges.tracking import PosePrior, TrackingOptions, track_edges
from polhode.planning.edges.visible_edges import ControlPoints, every_point
from tests.planning.edges.pictures import BOX, POSE, RIG, bevelled_box, drawn

BEVEL_M = 0.004
"""1.3 px at the range of POSE"""
POINTS = 40


def column(offset_px: float) -> ControlPoints:
    """Points on a vertical line of an image of 100 x 60 px, at u = 50 and an offset."""
    v = np.linspace(10.0, 50.0, POINTS)
    uv = np.column_stack([np.full(POINTS, 50.0 + offset_px), v])
    normal = np.tile([1.0, 0.0], (POINTS, 1))
    none = np.zeros((POINTS, 3))
    sides = np.tile(np.eye(3)[:2], (POINTS, 1, 1))
    return ControlPoints(none, uv, normal, np.zeros(POINTS, dtype=np.int64), np.ones(POINTS), sides)


def pair() -> ControlPoints:
    """Two lines, two pixels apart."""
    lines, names = (column(0.0), column(2.0)), [each.name for each in fields(ControlPoints)]
    return ControlPoints(*(np.concatenate([getattr(each, name) for each in lines]) for name in names))


def stepped(steps: list[tuple[float, float]], noise: float, seed: int = 0) -> Levels:
    """Image of vertical steps (place, height), blurred as an edge of a profile is, less the interpolation."""
    u = np.arange(100.0)
    sigma = np.sqrt(BLUR_PX**2 - 1.0 / 6.0)
    row = 40.0 + sum(height * norm.cdf((u - place) / sigma) for place, height in steps)
    return as_levels(row + noise * np.random.default_rng(seed).standard_normal((60, 100)))


def displacement(image: Levels, points: ControlPoints, stripes: Stripes, half_px: float) -> Displacements:
    return fitted(*profiles(image, points, half_px), stripes)


@pytest.mark.parametrize("true_px", [-0.8, -0.2, 0.0, 0.35, 0.7])
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


def test_of_two_edges_of_which_one_is_dark_the_nearer_is_taken() -> None:
    points = column(0.0)
    stripes = stripes_across(points, pair(), POSE, 6.0)
    for true_px in (-0.6, 0.4):
        found = displacement(stepped([(50.0 + true_px, 90.0)], 0.0), points, stripes, 4.0)
        assert np.abs(found.shift_px - true_px).max() < 0.02


def test_its_sigma_is_that_of_the_noise() -> None:
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


def test_a_profile_without_a_step_tells_nothing() -> None:
    points = column(0.0)
    found = displacement(stepped([], 0.0), points, stripes_across(points, points, POSE, 6.0), 4.0)
    assert found.sigma_px.min() > 50.0
    profile = profiles(stepped([], 1.0), points, 5.5)
    assert not searched(*profile, stripes_across(points, points, POSE, 6.0), 4.0)[1].any()


@pytest.fixture(scope="module")
def bevelled() -> EdgeModel:
    return edge_model(bevelled_box(BOX, BEVEL_M))


@pytest.fixture(scope="module")
def image(bevelled: EdgeModel) -> Array:
    return drawn(bevelled.surface, POSE)


@pytest.fixture(scope="module")
def block() -> EdgeModel:
    return edge_model(trimesh.creation.box(BOX))


def off_px(model: EdgeModel, X_RG: Array) -> float:
    """Largest displacement of the box's corners in the image."""
    corners = np.asarray(model.surface.vertices)
    there, here = (RIG.project(corners @ X[:3, :3].T + X[:3, 3])[:, :2] for X in (POSE, X_RG))
    return float(np.linalg.norm(there - here, axis=1).max())


def test_a_body_with_bevels_is_found_to_a_fraction_of_a_pixel(bevelled: EdgeModel, image: Array) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        step = np.concatenate([0.01 * rng.standard_normal(3), np.deg2rad(1.0) * rng.standard_normal(3)])
        found = track_edges(bevelled, RIG, image, moved(POSE, step, bevelled.centre_G))
        assert found.converged and found.reason == "" and found.agreement > 0.9
        error = pose_error(found.X_RG, POSE, bevelled.centre_G)
        assert error @ np.linalg.solve(found.covariance, error) < 22.5  # chi-squared of six, 99.9 %
        assert off_px(bevelled, found.X_RG) < 0.15


def test_edges_that_are_known_keep_half_of_the_edges_from_being_mistaken(
    bevelled: EdgeModel, image: Array
) -> None:
    half = bevelled.only(np.arange(0, len(bevelled.ends_G), 2))
    start = moved(POSE, np.full(6, 0.004), bevelled.centre_G)
    alone, helped = (track_edges(half, RIG, image, start, known=each) for each in (None, bevelled))
    assert off_px(bevelled, helped.X_RG) < 0.3 and helped.agreement > 0.9
    assert off_px(bevelled, helped.X_RG) < off_px(bevelled, alone.X_RG) + 0.02


def test_the_same_image_gives_the_same_pose(bevelled: EdgeModel, image: Array) -> None:
    start = moved(POSE, np.full(6, 0.004), bevelled.centre_G)
    one, other = (track_edges(bevelled, RIG, image, start) for _ in range(2))
    assert np.array_equal(one.X_RG, other.X_RG) and np.array_equal(one.information.C, other.information.C)


def test_what_cannot_be_tracked_says_why(bevelled: EdgeModel, image: Array) -> None:
    behind = track_edges(bevelled, RIG, image, make_pose(np.eye(3), [0.0, 0.0, -2.0]))
    assert not behind.converged and behind.reason == "the target is behind the camera"
    dark = track_edges(bevelled, RIG, np.zeros_like(image), POSE)
    assert not dark.converged and "too few" in dark.reason


def test_a_prior_holds_what_the_edges_do_not_determine(block: EdgeModel) -> None:
    # parallel edges leave the translation along them open
    along = np.abs(block.ends_G[:, 1] - block.ends_G[:, 0])
    parallel = block.only(np.flatnonzero(along[:, 0] > 0.9 * block.lengths_m))
    drawing, o_G = drawn(block.surface, POSE), block.centre_G
    off_G = np.array([0.01, 0.006, 0.0])
    start = moved(POSE, np.concatenate([POSE[:3, :3] @ off_G, np.zeros(3)]), o_G)
    prior = PosePrior(start, np.repeat([0.01, 0.01], 3) ** -2.0 * np.eye(6))
    found = track_edges(parallel, RIG, drawing, start, options=TrackingOptions(prior=prior))
    error_G = POSE[:3, :3].T @ pose_error(found.X_RG, POSE, o_G)[:3]
    assert found.converged and found.information.describe_unobservable()
    assert np.isclose(error_G[0], off_G[0], atol=5e-4) and abs(error_G[1]) < 1e-3
    strong = PosePrior(POSE, 1e12 * np.eye(6))
    held = track_edges(block, RIG, drawing, start, options=TrackingOptions(prior=strong))
    assert np.abs(pose_error(held.X_RG, POSE, o_G)).max() < 1e-4


def test_segments_that_are_poorly_known_weigh_less(block: EdgeModel) -> None:
    drawing = drawn(block.surface, POSE)
    exact = track_edges(block, RIG, drawing, POSE)
    sigma = TrackingOptions(sigma_m=np.full(block.size, 1e-3))
    rough = track_edges(block, RIG, drawing, POSE, options=sigma)
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


@pytest.mark.parametrize("cosine", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("radius_px", [30.0, 120.0])
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


def test_points_of_outlines_are_on_a_curved_surface() -> None:
    model = edge_model(trimesh.creation.cylinder(radius=0.3, height=0.8, sections=48))
    turned = make_pose(POSE[:3, :3], [0.0, 0.0, 3.0])
    points = every_point(model, RIG, turned, 2.0)
    stripes = stripes_across(points, points, turned, 6.0)
    outline = points.feature >= len(model.ends_G)
    assert outline.any() and not outline.all()
    assert np.array_equal(stripes.curved, outline)
