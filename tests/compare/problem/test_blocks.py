"""The blocks add up to the common cost, and their Jacobians are its derivatives."""

import numpy as np

from polhode.compare.problem.blocks import (
    Block,
    Blocks,
    SingleBlocks,
    landmark_block,
    root_of_kernel,
    stacked,
)
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.geometry.lie import Array


def roots(problem: MeasuredProblem, x: Array) -> tuple[Array, Array]:
    blocks = Blocks(problem.data, problem.fixed)
    residual, jacobian = stacked(
        [root_of_kernel(block, problem.data.robust_scale) for block in blocks.all(x)], blocks.n_x
    )
    return residual, jacobian


def test_the_squares_of_the_blocks_are_the_cost(small: MeasuredProblem) -> None:
    blocks = Blocks(small.data, small.fixed)
    for x in (small.cold, small.solution, small.start("perturbed", 3)):
        residual, _ = roots(small, x)
        assert np.isclose(0.5 * residual @ residual, blocks.cost(x), rtol=1e-10)


def test_the_jacobian_is_the_derivative_of_the_residuals(small: MeasuredProblem) -> None:
    x = small.start("near", 1)
    _, jacobian = roots(small, x)
    rng = np.random.default_rng(0)
    for _ in range(3):
        along, step = rng.normal(size=len(x)), 1e-7
        difference = (roots(small, x + step * along)[0] - roots(small, x - step * along)[0]) / (2.0 * step)
        slope = jacobian @ along
        assert np.abs(difference - slope).max() < 1e-5 * np.abs(slope).max()


def test_the_kernel_has_no_jump_where_its_series_begins() -> None:
    J = np.eye(3)[None]
    for size in (1e-5, 0.99e-4 * 3.0, 1.01e-4 * 3.0, 1.0):
        r = np.array([[size, 0.0, 0.0]])
        found = root_of_kernel(Block(r, J, np.arange(3)[None], robust=True), 3.0)
        assert np.isclose(np.sum(found.residual**2), 9.0 * np.log1p(size**2 / 9.0), rtol=1e-9)
        assert np.isclose(found.jacobian[0, 1, 1], found.residual[0, 0] / size, rtol=1e-9)


def test_one_landmark_alone_is_the_same(small: MeasuredProblem) -> None:
    d, fixed, x = small.data, small.fixed, small.start("perturbed", 0)
    blocks = Blocks(d, fixed)
    whole = root_of_kernel(blocks.stereo(x), d.robust_scale)
    for mark in (0, d.n_landmarks // 2, d.n_landmarks - 1):
        at = slice(d.start[mark], d.start[mark + 1])
        frames = d.frame[at]
        poses = x[: blocks.n_states].reshape(-1, blocks.n_state)[frames, :6]
        p_G = x[blocks.n_dense + 3 * mark : blocks.n_dense + 3 * mark + 3]
        measured = (fixed.A[frames], d.R_RN[frames], d.t_R[frames], d.uvd_px[at], d.inv_sigma[at], d.rig)
        of_poses, of_mark = np.empty((len(frames), 3, 6)), np.empty((len(frames), 3, 3))
        residual = landmark_block(poses.copy(), p_G.copy(), *measured, d.robust_scale, of_poses, of_mark)
        assert np.allclose(residual, whole.residual[at], rtol=1e-9, atol=1e-11)
        assert np.allclose(of_poses, whole.jacobian[at, :, :6], rtol=1e-7, atol=1e-7)
        assert np.allclose(of_mark, whole.jacobian[at, :, 6:], rtol=1e-7, atol=1e-7)


def test_one_step_alone_is_the_same(small: MeasuredProblem) -> None:
    blocks, x = Blocks(small.data, small.fixed), small.start("perturbed", 0)
    whole, single = blocks.dynamics(x), SingleBlocks(blocks)
    for k in (0, 7, len(whole.residual) - 1):
        own = x[whole.slots[k]]
        residual, jacobian = single.step(k)(own, True)
        assert np.allclose(residual, whole.residual[k], rtol=1e-10)
        assert np.allclose(single.step(k)(own, False)[0], whole.residual[k], rtol=1e-9)
        assert np.allclose(jacobian, whole.jacobian[k], rtol=1e-10)
