"""The calibrated covariance: noise of its own model comes out as it went in."""

import numpy as np
import pytest
import trimesh

from benchmarks.edges.tracking.calibrated_covariance import (
    EdgeNoise,
    NoiseParts,
    fitted,
    nees,
    noise_parts,
    parts_of,
)
from benchmarks.edges.tracking.tracker import body_beside, polarity, track
from polhode.lie import Array, exp_so3, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.observability_metric import edge_motion, observability
from polhode.planning.edges.visible_edges import ControlPoints, control_points
from polhode.records import Ints
from tests.planning.edges.pictures import BOX, POSE, RIG, drawn

MODEL = edge_model(trimesh.creation.box(BOX))


def seen(seed: int) -> tuple[ControlPoints, Array, Ints]:
    """Control points of a random view of a box, their motion and polarity."""
    rng = np.random.default_rng(seed)
    X = make_pose(exp_so3(rng.uniform(-2, 2, 3)), [0.0, 0.0, rng.uniform(2.0, 4.0)])
    points = control_points(MODEL, RIG, X)
    sign = polarity(body_beside(points, MODEL, RIG, X))
    return points, edge_motion(points, RIG, X, MODEL.centre_G), sign


def drawn_error(seed: int, levels: tuple[float, float, float]) -> tuple[Array, Array]:
    """Noise parts of a view, and the error of a fit to distances with the three kinds of noise."""
    points, f, sign = seen(seed)
    rng = np.random.default_rng([seed, 1])
    own, shared, limb = np.sqrt(levels)
    n = own * rng.standard_normal(len(points)) + shared * rng.standard_normal(MODEL.size)[points.feature]
    n += limb * rng.standard_normal() * sign
    C = (f * points.weight[:, None]).T @ f
    return noise_parts(f, points.weight, points.feature, sign), np.linalg.solve(C, f.T @ (points.weight * n))


def test_a_box_against_the_sky_is_brighter_inside() -> None:
    points, _, sign = seen(3)
    inward = np.mean(points.uv_px, axis=0) - points.uv_px
    towards = np.sign(np.einsum("mk,mk->m", inward, points.normal_px))
    assert (sign != 0).sum() > 30
    assert (sign[sign != 0] == towards[sign != 0]).all()


def test_independent_noise_of_equal_weights_is_c_inverse() -> None:
    points, f, sign = seen(0)
    parts = noise_parts(f, np.ones(len(points)), points.feature, sign)
    known = observability(f, np.ones(len(points)), MODEL.radius_m)
    assert np.allclose(parts[0], known.covariance, rtol=1e-6)


@pytest.mark.parametrize("levels", [(0.04, 0.0, 0.0), (0.0, 0.02, 0.0), (0.01, 0.02, 0.01)])
def test_the_covariance_is_that_of_the_noise(levels: tuple[float, float, float]) -> None:
    trials = [drawn_error(seed, levels) for seed in range(150)]
    noise = NoiseParts(np.array([parts for parts, _ in trials]), np.zeros(150))
    covariance = EdgeNoise(levels, (0.0, 0.0, 0.0)).covariance(noise)
    errors = np.array([error for _, error in trials])
    # noise of an edge as a whole has as many dimensions as edges in sight: at least six here
    assert np.mean(nees(errors, covariance)) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 150))


def test_fitting_finds_the_levels() -> None:
    levels = (0.02, 0.03, 0.005)
    trials = [drawn_error(seed, levels) for seed in range(400)]
    noise = NoiseParts(np.array([parts for parts, _ in trials]), np.zeros(400))
    errors = np.array([error for _, error in trials])
    found = fitted(noise, errors, with_image=False)
    assert found.floor_px2[1] == pytest.approx(levels[1], rel=0.3)
    assert sum(found.floor_px2) == pytest.approx(sum(levels), rel=0.5)
    assert np.mean(nees(errors, found.covariance(noise))) == pytest.approx(6.0, abs=0.05)


def test_slopes_follow_the_residual() -> None:
    parts, _ = drawn_error(1, (1.0, 0.0, 0.0))
    noise = NoiseParts(np.stack([parts, parts]), np.array([0.1, 0.2]))
    small, large = EdgeNoise((0.0, 0.0, 0.0), (1.0, 0.5, 0.0)).covariance(noise)
    assert np.allclose(large, 4.0 * small)


def test_a_tracked_pose_has_its_parts() -> None:
    tracked = track(MODEL, RIG, drawn(MODEL.surface, POSE), POSE)
    noise = parts_of(tracked)
    assert noise.parts.shape == (1, 3, 6, 6)
    assert noise.residual_px[0] == tracked.sigma_px
    assert (np.linalg.eigvalsh(noise.parts[0, 0]) > 0.0).all()
