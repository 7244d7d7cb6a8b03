"""The simplified problem: derivatives, estimates, covariances, unobservable cases."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.optimize._numdiff import approx_derivative
from scipy.stats import chi2

from benchmarks.edges.planar import (
    bearings,
    directions,
    folded_bearings,
    gauss_newton,
    jacobian,
    linear_estimate,
    metric,
    printed_directions,
    rotation,
    wrapped,
)
from polhode.lie import Array

SIGMA_RAD = 2e-4
TRUTH = np.array([3.0, 0.2, 0.17])
FLAT = np.array([[0.0, 0.5], [0.0, 0.1], [0.0, -0.5]])
DEEP = np.array([[0.1, 0.5], [-0.2, 0.3], [0.0, 0.0], [0.3, -0.2], [0.0, -0.6], [0.25, 0.4]])
ONE, TWO = FLAT[:1], FLAT[[0, 2]]
COINCIDENT = FLAT[[0, 0, 2]]


def random_problem(seed: int) -> tuple[Array, Array]:
    """State anywhere around the camera, also behind it, and 3 to 8 edges."""
    rng = np.random.default_rng(seed)
    state = np.array([*rng.uniform(-4.0, 4.0, 2), rng.uniform(-np.pi, np.pi)])
    return state, rng.uniform(-0.7, 0.7, (rng.integers(3, 9), 2))


def by_complex_step(state: Array, edges: Array) -> Array:
    """H from arctan(s2 / s1), whose derivative is that of atan2, without subtraction."""
    columns = []
    for i in range(3):
        p1, p2, theta = state + 1e-30j * np.eye(3)[i]
        s1 = p1 + edges[:, 0] * np.cos(theta) - edges[:, 1] * np.sin(theta)
        s2 = p2 + edges[:, 0] * np.sin(theta) + edges[:, 1] * np.cos(theta)
        columns.append(np.arctan(s2 / s1).imag / 1e-30)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_the_jacobian_is_the_derivative_of_the_bearings(seed: int) -> None:
    state, edges = random_problem(seed)
    H = jacobian(state, edges)
    exact = by_complex_step(state, edges)
    assert np.linalg.norm(H - exact) < 1e-12 * np.linalg.norm(exact)

    def unfolded(x: Array) -> Array:
        return wrapped(bearings(x, edges) - bearings(state, edges))

    finite = approx_derivative(unfolded, state, method="3-point")
    assert np.linalg.norm(H - finite) < 1e-6 * np.linalg.norm(finite)


def test_bearings_have_signs_in_all_four_quadrants() -> None:
    state = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    found = bearings(state, np.zeros((1, 2)))[:, 0]
    np.testing.assert_allclose(found, np.pi * np.array([0.25, 0.75, -0.75, -0.25]), rtol=1e-15)


def test_many_states_at_once_are_each_alone() -> None:
    states = TRUTH + 0.1 * np.random.default_rng(1).normal(size=(2, 4, 3))
    found = bearings(states, DEEP), jacobian(states, DEEP), metric(states, DEEP)
    assert [each.shape for each in found] == [(2, 4, 6), (2, 4, 6, 3), (2, 4, 3, 3)]
    for index in np.ndindex(2, 4):
        for many, alone in zip(found, (bearings, jacobian, metric), strict=True):
            np.testing.assert_allclose(many[index], alone(states[index], DEEP), rtol=1e-12)


def test_the_metric_is_the_inverse_of_the_information() -> None:
    H = jacobian(TRUTH, DEEP)
    np.testing.assert_allclose(metric(TRUTH, DEEP), np.linalg.inv(H.T @ H), rtol=1e-9)


@pytest.mark.parametrize("middle", [0.4, 0.1, 0.0, -0.3])
def test_an_aligned_flat_model_has_its_closed_form(middle: float) -> None:
    # |s|^2 phi is a quadratic of the height, so the state's errors are its interpolation at three heights:
    # the slope does not depend on the middle one.
    R, a = 3.0, 0.5
    found = np.diag(metric(np.array([R, 0.0, 0.0]), np.array([[0.0, a], [0.0, middle], [0.0, -a]])))
    assert found[0] == pytest.approx((R**2 + a**2) ** 2 / (2.0 * a**2), rel=1e-9)
    if middle == 0.0:
        assert found[1] == pytest.approx(R**2, rel=1e-9)
        assert found[2] == pytest.approx((2.0 * (R**2 + a**2) ** 2 + 4.0 * R**4) / (4.0 * a**4), rel=1e-9)


def test_turning_the_camera_turns_the_metric() -> None:
    turn = 0.7
    state = np.array([*(rotation(np.asarray(turn)) @ TRUTH[:2]), TRUTH[2] + turn])
    np.testing.assert_allclose(bearings(state, DEEP), bearings(TRUTH, DEEP) + turn, rtol=1e-12)
    J = np.eye(3)
    J[:2, :2] = rotation(np.asarray(turn))
    np.testing.assert_allclose(metric(state, DEEP), J @ metric(TRUTH, DEEP) @ J.T, rtol=1e-9, atol=1e-10)


def test_lengths_scale_the_position_alone() -> None:
    scale = np.array([7.0, 7.0, 1.0])
    expected = metric(TRUTH, DEEP) * np.outer(scale, scale)
    np.testing.assert_allclose(metric(TRUTH * scale, 7.0 * DEEP), expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_another_edge_raises_the_information_and_lowers_the_metric(seed: int) -> None:
    state, edges = random_problem(seed)
    more = np.vstack([edges, [[0.15, -0.35]]])
    H, H_more = jacobian(state, edges), jacobian(state, more)
    gain = np.linalg.eigvalsh(H_more.T @ H_more - H.T @ H)
    assert gain[-1] > 1e-3 and gain[0] > -1e-12 * gain[-1]
    drop = np.diag(metric(state, edges)) - np.diag(metric(state, more))
    assert np.all(drop > 0.0)


# Estimates


def noisy(edges: Array, cases: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return bearings(TRUTH, edges) + SIGMA_RAD * rng.normal(size=(cases, len(edges)))


@pytest.mark.parametrize("edges", [FLAT, DEEP], ids=["flat", "deep"])
def test_the_estimate_is_that_of_scipy(edges: Array) -> None:
    prior = TRUTH + np.array([0.1, -0.1, 0.1])
    measured = noisy(edges, 5)
    found = gauss_newton(prior, edges, measured)
    assert found.converged.all() and found.iterations.max() < 10
    for state, cost, z in zip(found.state, found.cost, measured, strict=True):
        # in units of sigma, of which SciPy's limits are far below the noise
        peer = least_squares(
            lambda x, z=z: wrapped(z - bearings(x, edges)) / SIGMA_RAD,
            prior,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        scale = np.sqrt(np.diag(SIGMA_RAD**2 * metric(TRUTH, edges)))
        np.testing.assert_allclose((state - peer.x) / scale, 0.0, atol=1e-5)
        assert cost / SIGMA_RAD**2 == pytest.approx(peer.cost, rel=1e-8, abs=1e-8)


def test_the_linear_estimate_is_one_step_of_least_squares() -> None:
    prior = TRUTH + np.array([0.02, -0.01, 0.01])
    z = noisy(DEEP, 1)[0]
    step = np.linalg.lstsq(jacobian(prior, DEEP), z - bearings(prior, DEEP), rcond=None)[0]
    np.testing.assert_allclose(linear_estimate(prior, DEEP, z), prior + step, rtol=1e-12)


def test_the_error_of_one_step_is_of_second_order_and_convergence_has_none() -> None:
    off, z = np.array([0.05, 0.04, 0.05]), bearings(TRUTH, DEEP)
    far, near = (np.abs(linear_estimate(TRUTH + k * off, DEEP, z) - TRUTH).max() for k in (1.0, 0.1))
    assert 50.0 < far / near < 200.0
    np.testing.assert_allclose(gauss_newton(TRUTH + off, DEEP, z).state, TRUTH, atol=1e-11)


def test_a_model_behind_the_camera_is_found_across_the_seam_of_the_angle() -> None:
    truth = np.array([-3.0, 0.05, 2.0])
    z = bearings(truth, DEEP)
    assert z.max() > 3.0 and z.min() < -3.0
    found = gauss_newton(truth + np.array([0.1, -0.1, 0.1]), DEEP, z)
    assert found.converged
    np.testing.assert_allclose(found.state, truth, atol=1e-10)


def test_a_case_that_does_not_converge_says_so() -> None:
    # From so far off the model is moved away without end: all bearings become one.
    prior = np.array([[3.27, -0.78, 1.28], TRUTH])
    z = bearings(TRUTH, FLAT)
    found = gauss_newton(prior, FLAT, z)
    assert found.converged.tolist() == [False, True]
    assert np.linalg.norm(found.state[0, :2]) > 1e3 and found.cost[0] > 1e-3
    np.testing.assert_allclose(found.state[1], TRUTH, atol=1e-12)


@pytest.mark.parametrize("edges", [FLAT, DEEP], ids=["flat", "deep"])
def test_errors_are_as_large_as_the_covariance_says(edges: Array) -> None:
    cases = 4000
    found = gauss_newton(TRUTH, edges, noisy(edges, cases, seed=3))
    error, cov = found.state - TRUTH, SIGMA_RAD**2 * metric(TRUTH, edges)
    assert found.converged.all()
    low, high = chi2.ppf([0.0005, 0.9995], cases) / cases
    ratio = (error**2).mean(axis=0) / np.diag(cov)
    assert np.all((low < ratio) & (ratio < high))
    nees = np.einsum("ci,ij,cj->c", error, np.linalg.inv(cov), error).sum()
    assert chi2.ppf(0.0005, 3 * cases) < nees < chi2.ppf(0.9995, 3 * cases)


# What is unobservable


@pytest.mark.parametrize("edges", [ONE, TWO, COINCIDENT], ids=["one", "two", "coincident"])
def test_with_too_few_edges_everything_is_unobservable(edges: Array) -> None:
    cov = metric(TRUTH, edges)
    np.testing.assert_array_equal(cov, np.where(np.eye(3, dtype=bool), np.inf, 0.0))


def test_what_two_edges_do_determine_stays_finite() -> None:
    # Before an upright pair the difference of the bearings tells the range, whatever the turn.
    state = np.array([3.0, 0.0, 0.0])
    cov = metric(state, TWO)
    assert cov[0, 0] == pytest.approx((3.0**2 + 0.5**2) ** 2 / (2.0 * 0.5**2), rel=1e-12)
    assert np.isinf(cov[1, 1]) and np.isinf(cov[2, 2])
    at_origin = metric(state, np.zeros((1, 2)))
    assert at_origin[1, 1] == pytest.approx(9.0) and np.isinf(at_origin[0, 0]) and np.isinf(at_origin[2, 2])


def test_edges_that_come_together_go_to_infinity_in_proportion() -> None:
    roots = [
        np.sqrt(np.diag(metric(TRUTH, np.array([[0.0, 0.5], [0.0, 0.5 - gap], [0.0, -0.5]]))))
        for gap in (1e-3, 1e-5, 1e-7)
    ]
    np.testing.assert_allclose(roots[1] / roots[0], 100.0, rtol=0.01)
    np.testing.assert_allclose(roots[2] / roots[1], 100.0, rtol=0.01)


def test_edges_on_a_circle_through_the_camera_hide_the_state_however_many() -> None:
    angle = np.array([0.1, 0.5, -0.7, 1.0, -1.2])
    on_circle = np.array([1.4, 0.3]) + np.hypot(1.4, 0.3) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = (on_circle - TRUTH[:2]) @ rotation(TRUTH[2])
    np.testing.assert_allclose(directions(TRUTH, edges), on_circle, rtol=1e-12)
    assert np.all(np.isinf(np.diag(metric(TRUTH, edges))))
    assert np.isfinite(metric(TRUTH + np.array([0.3, 0.0, 0.0]), edges)).all()
    assert np.isfinite(metric(TRUTH, np.vstack([edges, [[0.3, 0.3]]]))).all()


def test_a_flat_model_seen_edge_on_hides_its_range() -> None:
    state = np.array([3.0, 0.0, np.pi / 2.0])
    variances = np.diag(metric(state, FLAT))
    assert np.isinf(variances[0]) and np.all(np.isfinite(variances[1:]))


# Misprints


def test_the_printed_sign_is_no_rotation() -> None:
    at_origin = np.array([0.0, 0.0, 0.5])
    lengths = np.linalg.norm(DEEP, axis=1)
    np.testing.assert_allclose(np.linalg.norm(directions(at_origin, DEEP), axis=1), lengths, atol=1e-15)
    assert np.abs(np.linalg.norm(printed_directions(at_origin, DEEP), axis=1) - lengths).max() > 0.05
    printed = printed_directions(at_origin, np.eye(2)).T
    assert np.linalg.det(printed) == pytest.approx(-np.cos(2.0 * 0.5), rel=1e-12)


def test_of_a_flat_model_the_printed_sign_only_makes_its_mirror_image() -> None:
    mirrored = directions(TRUTH * [1.0, 1.0, -1.0], FLAT * [1.0, -1.0])
    np.testing.assert_allclose(printed_directions(TRUTH, FLAT), mirrored, rtol=1e-15)


def test_arccos_loses_the_sign() -> None:
    np.testing.assert_allclose(folded_bearings(TRUTH, DEEP), np.abs(bearings(TRUTH, DEEP)), rtol=1e-12)
    assert bearings(TRUTH, DEEP).min() < -0.1
    upside_down = np.array([TRUTH[0], -TRUTH[1], np.pi - TRUTH[2]])
    np.testing.assert_allclose(folded_bearings(upside_down, FLAT), folded_bearings(TRUTH, FLAT), rtol=1e-12)
    assert np.abs(bearings(upside_down, FLAT) - bearings(TRUTH, FLAT)).min() > 0.05
