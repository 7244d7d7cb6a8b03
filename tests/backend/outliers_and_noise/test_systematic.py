"""Errors that every frame shares: what they do to the position, and to nothing else."""

from dataclasses import replace

import numpy as np

from polhode.backend.outliers_and_noise.systematic import SharedErrors, common_slide, position_spread
from polhode.backend.uncertainty.covariance import observation_jacobians
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.records.estimate import MotionEstimate
from polhode.simulation.monte_carlo import RIG, SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, at_truth, estimated, sigmas

SCENE = SyntheticScene(
    frames=25, landmarks=300, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=BOX,
    sigma_uv_px=0.1, sigma_d_px=0.1, accel_psd=1e-9, torque_psd=1e-9,
)  # fmt: skip
SIGMA_PX = (0.3, 0.2, 0.1)


def _run(
    sequence: SyntheticSequence, sigma_px: tuple[float, float, float], light_px: float = 0.0, most: int = 200
) -> MotionEstimate:
    config = Backend(
        solver="gauss_newton", process_noise="given", systematic_px=sigma_px, light_px=light_px,
        max_iterations=most, accel_psd=SCENE.accel_psd, torque_psd=SCENE.torque_psd,
    )  # fmt: skip
    return estimated(sequence, config)


def test_the_covariance_is_that_of_drawn_offsets() -> None:
    X_NR = make_pose(exp_so3([[0.3, -0.5, 0.2], [0.0, 0.1, 0.0]]), [[0.1, 0.2, -0.3], [0.0, 0.0, 0.0]])
    r_N = transform_points(X_NR, np.array([[[0.1, -0.05, 0.7]], [[0.0, 0.1, 1.2]]]))[:, 0]
    uvd = RIG.project(transform_points(inverse_pose(X_NR), r_N[:, None])[:, 0])
    # small ones: the covariance is of first order
    offsets = 0.01 * np.random.default_rng(0).normal(size=(20000, 1, 3)) * SIGMA_PX
    moved = transform_points(X_NR[None], RIG.triangulate(uvd + offsets)[:, :, None])[:, :, 0]
    for k in range(2):
        expected = np.cov(moved[:, k].T) * 1e4
        spread = position_spread(RIG, X_NR, r_N, SharedErrors(SIGMA_PX))[k]
        np.testing.assert_allclose(spread @ spread.T, expected, atol=0.04 * np.trace(expected))


def test_a_slide_shifts() -> None:
    X_NR, none = make_pose(exp_so3([[0.3, -0.5, 0.2]]), [[0.1, 0.2, -0.3]]), (0.0, 0.0, 0.0)
    p_R = np.array([[0.1, -0.05, 0.7]])
    r_N = transform_points(X_NR, p_R[:, None])[:, 0]
    spread = position_spread(RIG, X_NR, r_N, SharedErrors(none, slide_px=0.3))[0]
    np.testing.assert_allclose(RIG.focal_px * np.sqrt(np.diag(spread @ spread.T)) / 0.7, 0.3)


def slide_of(sequence: SyntheticSequence, sigma_px: float) -> tuple[Array, Array]:
    """Changes (M, 3, 3) of the observations [px] by slides along the axes of N, in their order; landmarks."""
    fit = at_truth(sequence)
    data, to_landmark = fit.data, observation_jacobians(fit)[1]
    changes = np.empty((len(data.frame), 3, 3))
    # a residual is an observation minus what is expected
    changes[data.order] = -common_slide(fit, to_landmark, sigma_px) / data.inv_sigma[:, :, None]
    return changes, fit.iterate.p_G


def test_a_slide_moves_what_is_seen_along_the_surface() -> None:
    sequence = generate(SCENE, 0)
    changes, p_G = slide_of(sequence, 0.2)
    tracks, X_NG = sequence.tracks, sequence.X_NG
    outward = p_G - np.median(p_G, axis=0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    sigma_m = 0.2 * np.median(np.linalg.norm(X_NG[:, :3, 3], axis=1)) / RIG.focal_px
    to_R = inverse_pose(tracks.X_NR) @ X_NG
    for m in range(0, len(tracks.frame), 500):
        k, normal = tracks.frame[m], outward[tracks.landmark[m]]
        for axis in range(3):
            along = X_NG[k, :3, :3].T @ np.eye(3)[axis]
            along = sigma_m * (along - normal * (normal @ along))
            ends = [
                RIG.project(transform_points(to_R[k], p_G[tracks.landmark[m]] + s * along)[None])
                for s in (0.5, -0.5)
            ]
            np.testing.assert_allclose(changes[m, :, axis], (ends[0] - ends[1]).ravel(), atol=1e-4)


def test_a_shared_offset_moves_the_position_by_what_its_sigma_allows() -> None:
    sequence = generate(SCENE, 0)
    shifted = sequence.tracks.uvd_px + np.array([0.3, -0.2, 0.1])
    estimate = _run(replace(sequence, tracks=replace(sequence.tracks, uvd_px=shifted)), SIGMA_PX)
    blind = _run(sequence, (0.0, 0.0, 0.0))
    error = estimate.r_N - sequence.truth.r_N
    sigma, stated = (sigmas(each.covariance)[:, :3] for each in (estimate, blind))
    assert np.abs(error / stated).max() > 4.0
    assert np.abs(error / sigma).max() < 2.5
    # the offset is hardly seen by anything else
    np.testing.assert_allclose(
        estimate.covariance[:, 3:, 3:], blind.covariance[:, 3:, 3:], rtol=0.1, atol=1e-9
    )
    assert abs(estimate.mass.k2 - blind.mass.k2) < np.sqrt(blind.mass.cov_k[1, 1])
    # G is where the first pose was seen: the true centre of mass in it is elsewhere
    com_true = transform_points(inverse_pose(estimate.X_NG[0]), sequence.truth.r_N[:1])[0]
    off = estimate.mass.com_G - com_true
    assert off @ np.linalg.solve(estimate.mass.cov_com_G, off) < 12.0
    assert off @ np.linalg.solve(blind.mass.cov_com_G, off) > 30.0
    # and the verdict says the same
    known = estimate.mass.identifiable
    in_P = np.diagonal(estimate.mass.R_GP.T @ estimate.mass.cov_com_G @ estimate.mass.R_GP)
    np.testing.assert_allclose(known.sigma[:3], np.sqrt(in_P), rtol=0.05)
    for name, sigma in zip(("com_x", "com_y", "com_z"), known.sigma, strict=False):
        assert f"about {1e3 * sigma:.2g} mm" in known.detail[name]
    last = estimate.covariance[-1, :3, :3]
    np.testing.assert_allclose(estimate.covariance_last_joint[:3, :3], last, rtol=1e-9)
    assert estimate.covariance_last_body is not None
    np.testing.assert_allclose(estimate.covariance_last_body[:3, :3], last, rtol=1e-6)


def test_a_sigma_across_an_undetermined_direction_is_not_lost() -> None:
    R = np.asarray(exp_so3(np.array([0.5, -0.6, 0.3])))
    w_G = tuple((0.8 * R[:, 2]).tolist())
    spin = generate(
        replace(SCENE, w_G=w_G, J_G=R @ np.diag([1.5, 1.2, 0.9]) @ R.T, sigma_uv_px=0.5, sigma_d_px=0.5), 2
    )
    # along what is not known the solver would walk on without an end
    blind, wide = (_run(spin, sigma, most=40) for sigma in ((0.0, 0.0, 0.0), SIGMA_PX))
    bare, grown = blind.mass.identifiable, wide.mass.identifiable
    known = bare.com_P
    assert np.isinf(sigmas(wide.covariance)[:, 9:]).any() and not np.isnan(wide.covariance).any()
    assert np.isinf(np.diagonal(blind.mass.cov_com_G)).sum() >= 2 and known.sum() == 2
    off_P = blind.R_NP[0].T @ (blind.r_N[0] - spin.truth.r_N[0])
    assert np.all(np.abs(off_P[known]) < 4.0 * bare.sigma[:3][known])
    assert np.all(bare.sigma[:3][known] < 1e-3) and np.all((grown.sigma > bare.sigma)[:3][known])
    for k in np.flatnonzero(known):
        assert f"about {1e3 * grown.sigma[k]:.2g} mm" in grown.detail[f"com_{'xyz'[k]}"]
