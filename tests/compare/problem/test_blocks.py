"""The blocks add up to the common cost, and their Jacobians are its derivatives."""

import numpy as np
import pytest

from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.compare.problem.blocks import Blocks, landmark_block
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.geometry.lie import Array


def landmark(problem: MeasuredProblem, x: Array, mark: int, scale: float) -> tuple[Array, Array]:
    """Residuals (n, 3) of a landmark's block, and their Jacobian (n, 3, n_x)."""
    d, fixed, at = problem.data, problem.fixed, problem.fixed.reference
    own = slice(d.start[mark], d.start[mark + 1])
    k, mine = d.frame[own], at.n_dense + 3 * mark + np.arange(3)
    poses = x[: at.n_states].reshape(-1, at.n_state)[k, :6].copy()
    measured = (fixed.A[k], d.R_RN[k], d.t_R[k], d.uvd_px[own], d.inv_sigma[own], d.rig)
    of_poses, of_mark = np.empty((len(k), 3, 6)), np.empty((len(k), 3, 3))
    residual = landmark_block(poses, x[mine].copy(), *measured, scale, of_poses, of_mark)
    jacobian = np.zeros((len(k), 3, len(x)))
    for m, frame in enumerate(k):
        jacobian[m, :, at.n_state * frame : at.n_state * frame + 6] = of_poses[m]
        jacobian[m][:, mine] = of_mark[m]
    return np.asarray(residual), jacobian


def test_the_squares_of_the_blocks_are_the_cost(small: MeasuredProblem) -> None:
    blocks, d, at = Blocks(small.data, small.fixed), small.data, small.fixed.reference
    s, c = at.n_state, np.arange(at.n_states, at.n_dense)
    for x in (small.cold, small.start("perturbed", 3)):
        residuals = [landmark(small, x, mark, d.robust_scale)[0] for mark in range(d.n_landmarks)]
        for k in range(d.n_frames - 1):
            own = np.concatenate([x[s * k : s * (k + 2)], x[c]])
            residuals.append(blocks.step(k)(own, True)[0])
            np.testing.assert_allclose(residuals[-1], blocks.step(k)(own, False)[0], rtol=1e-9, atol=1e-12)
        residuals += [block.residual for block in blocks.others(x)]
        half_squares = 0.5 * sum(float(np.sum(r**2)) for r in residuals)
        assert half_squares == pytest.approx(GaussNewton(d).cost(small.fixed, x), rel=1e-10)


@pytest.mark.parametrize("scale", [3.0, 1e6])
def test_the_jacobian_of_a_landmark_is_the_derivative_of_its_residuals(
    small: MeasuredProblem, scale: float
) -> None:
    # the wide kernel is in its series
    x, rng, step = small.start("perturbed", 1), np.random.default_rng(0), 1e-7
    for mark in (0, small.data.n_landmarks // 2, small.data.n_landmarks - 1):
        _, jacobian = landmark(small, x, mark, scale)
        along = rng.normal(size=len(x))
        ends = [landmark(small, x + s * step * along, mark, scale)[0] for s in (1.0, -1.0)]
        slope = jacobian @ along
        assert np.abs((ends[0] - ends[1]) / (2.0 * step) - slope).max() < 1e-5 * np.abs(slope).max()
