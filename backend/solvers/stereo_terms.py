"""The stereo terms of the program for CasADi: cost, gradient and Hessian entries by compiled loops.

Nearly all terms of a program are stereo measurements. On CasADi's virtual machine they took two thirds of
IPOPT's time, and building their expressions took longer than solving; here they are external functions.
"""

import numpy as np

from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.robust_kernel import kernel_curvature, robust_cost, robust_weight
from polhode.backend.solvers.schur import stereo_normal_equations, stereo_residuals
from polhode.lie import Array, exp_so3, right_jacobian_so3
from polhode.records import Ints


class StereoTerms:
    """Robust cost of all stereo measurements as a function of the program's unknowns.

    x (n,): per frame ``n_state`` numbers, the pose p_NG, theta first; landmarks from ``n_dense`` on.
    A (9 F,): R_RN R_ref of each frame, by columns.
    """

    def __init__(self, data: MotionData, n_state: int, n_dense: int) -> None:
        self.data, self.n_state, self.n_dense = data, n_state, n_dense
        self.n_x = n_dense + 3 * data.n_landmarks

    def cost(self, x: Array, A: Array) -> float:
        """Sum of the Cauchy kernel over the measurements."""
        residuals, *_ = self._residuals(x, A)
        return robust_cost(np.sum(residuals**2, axis=1), self.data.robust_scale)

    def gradient(self, x: Array, A: Array) -> Array:
        """(n,)"""
        _, g, _, h, _ = self._blocks(x, A)
        out = np.zeros(self.n_x)
        np.add.at(out, self._of_poses(), g)
        out[self.n_dense :] += h.ravel()
        return out

    def keys(self) -> Ints:
        """Cells ``column * n + row`` of the entries of ``hessian``, all on or above the diagonal."""
        d, n = self.data, self.n_x
        cols, rows = np.tril_indices(6)
        poses = self._of_poses()
        marks = self.n_dense + np.arange(3 * d.n_landmarks).reshape(-1, 3)
        own_cols, own_rows = np.tril_indices(3)
        return np.concatenate(
            [
                (poses[:, cols] * n + poses[:, rows]).ravel(),
                (marks[d.landmark][:, None, :] * n + poses[d.frame][:, :, None]).ravel(),
                (marks[:, own_cols] * n + marks[:, own_rows]).ravel(),
            ]
        )

    def hessian(self, x: Array, A: Array) -> Array:
        """Entries of the Gauss-Newton Hessian with the kernel's curvature, in the order of ``keys``."""
        H, _, C, _, E = self._blocks(x, A)
        cols, rows = np.tril_indices(6)
        own_cols, own_rows = np.tril_indices(3)
        return np.concatenate([H[:, cols, rows].ravel(), E.ravel(), C[:, own_cols, own_rows].ravel()])

    def _of_poses(self) -> Ints:
        return self.n_state * np.arange(self.data.n_frames)[:, None] + np.arange(6)

    def _residuals(self, x: Array, A: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Whitened residuals (M, 3); attitudes in the camera (F, 3, 3), theta (F, 3), p_NG, p_G."""
        d = self.data
        poses = x[self._of_poses()]
        p_NG, theta = np.ascontiguousarray(poses[:, :3]), poses[:, 3:]
        now = np.swapaxes(A.reshape(-1, 3, 3), 1, 2) @ exp_so3(theta)
        p_G = x[self.n_dense :].reshape(-1, 3)
        fixed = (d.frame, d.landmark, d.uvd_px, d.inv_sigma, d.rig)
        return stereo_residuals(*fixed, now, d.R_RN, d.t_R, p_NG, p_G), now, theta, p_NG, p_G

    def _blocks(self, x: Array, A: Array) -> tuple[Array, Array, Array, Array, Array]:
        d = self.data
        residuals, now, theta, p_NG, p_G = self._residuals(x, A)
        s = np.sum(residuals**2, axis=1)
        fixed = (d.frame, d.landmark, d.inv_sigma, d.rig)
        point = (now, d.R_RN, d.t_R, p_NG, p_G, right_jacobian_so3(theta), residuals)
        return stereo_normal_equations(
            *fixed, *point, robust_weight(s, d.robust_scale), kernel_curvature(s, d.robust_scale)
        )
