"""The bundle adjustment: lenses of one camera or two, the pose between them, and a pose of each board view.

Minimized is

    sum over cameras c, views v, corners i of  rho(|z_cvi - project_c(X_cB(v) p_i)|^2 / sigma_cv^2),
    X_0B(v) = X_v,  X_1B(v) = X_10 X_v,

over the values of the lenses, X_10 and all X_v, by Gauss-Newton with Levenberg's damping. rho is the square,
or Cauchy's kernel while spoiled views may be among the data. Poses of views appear in their own
residuals alone, so they are eliminated first (Schur complement); Triggs et al., "Bundle adjustment - a modern
synthesis", 1999. Coefficients of a rational lens that the data leave open have a wide prior about 0
(lenses.py). Steps of poses: R Exp(theta), t + dt.

The covariance of lenses and X_10 is the inverse of the reduced normal matrix, with the standard deviation
sigma_cv of a coordinate that the residuals of each view show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.calibration.lenses import Lens, project_with_derivatives, rays
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, hat

CAUCHY = 2.385
"""Standard deviations; 95 % efficiency for normal noise."""
FLOOR_PX = 1e-4
"""Least standard deviation of a corner: synthetic data without noise must not divide by 0."""
POOL_COUNTS = 20.0
"""Weight of the camera's variance beside that of a view, in residuals: views with few corners follow it."""


@dataclass(frozen=True)
class CornerData:
    """Corners that one camera saw, N of them, sorted by view."""

    view: Ints
    """(N,) index of the pose"""
    p_B: Array
    """(N, 3) on the board [m]"""
    uv_px: Array
    """(N, 2)"""

    def kept(self, good: Bools) -> "CornerData":
        """The part (N,) of them."""
        return CornerData(self.view[good], self.p_B[good], self.uv_px[good])


@dataclass(frozen=True)
class RigState:
    """The unknowns."""

    lenses: tuple[Lens, ...]
    """Of one camera or two"""
    X_CB: Array
    """(V, 4, 4) board in the left (or only) camera"""
    X_10: Array
    """(4, 4) from the left into the right camera"""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of values of the lenses."""
        return tuple(len(lens.values) for lens in self.lenses)

    @property
    def shared(self) -> int:
        """Number of unknowns that all views share: lenses, and X_10 (theta, t) of two cameras."""
        return sum(self.sizes) + (6 if len(self.lenses) == 2 else 0)

    @property
    def values(self) -> Array:
        """(shared,) the values of the lenses, then zeros for X_10."""
        own = np.concatenate([lens.values for lens in self.lenses])
        return np.concatenate([own, np.zeros(self.shared - len(own))])

    @property
    def prior_sigmas(self) -> Array:
        """(shared,) of the prior about 0; infinite: none."""
        own = np.concatenate([lens.prior_sigmas for lens in self.lenses])
        return np.concatenate([own, np.full(self.shared - len(own), np.inf)])

    def moved(self, step: Array, poses: Array) -> "RigState":
        """After a step (shared,) and those of the views (V, 6)."""
        lenses, at = [], 0
        for lens in self.lenses:
            lenses.append(lens.moved(step[at : at + len(lens.values)]))
            at += len(lens.values)
        X_10 = move_poses(self.X_10[None], step[at:][None])[0] if len(self.lenses) == 2 else self.X_10
        return RigState(tuple(lenses), move_poses(self.X_CB, poses), X_10)


def move_poses(X: Array, step: Array) -> Array:
    """Poses (V, 4, 4) after steps (V, 6): R Exp(theta), t + dt."""
    out = X.copy()
    out[:, :3, :3] = X[:, :3, :3] @ exp_so3(step[:, :3])
    out[:, :3, 3] += step[:, 3:]
    return out


@dataclass(frozen=True)
class Adjusted:
    """The result of an adjustment."""

    state: RigState
    residuals: tuple[Array, ...]
    """By camera (N, 2), measured minus projected [px]; NaN: behind the camera"""
    covariance: Array
    """(shared, shared) of the values of the lenses, and of theta and t of X_10; 0 for what was fixed"""
    sigma_px: tuple[Array, ...]
    """By camera (V,) standard deviation of a coordinate of a corner in each view; NaN: no corners there"""
    converged: bool


def residuals_of(state: RigState, data: Sequence[CornerData]) -> tuple[Array, ...]:
    """Measured minus projected [px], by camera (N, 2)."""
    return tuple(_linearize(state, data, c)[0] for c in range(len(data)))


def _linearize(state: RigState, data: Sequence[CornerData], c: int) -> tuple[Array, Array, Array]:
    """Residuals (N, 2), and derivatives of the projection by the shared unknowns (N, 2, S) and by the pose of
    the view (N, 2, 6)."""
    seen = data[c]
    R_0B, t_0B = state.X_CB[seen.view, :3, :3], state.X_CB[seen.view, :3, 3]
    p_0 = (R_0B @ seen.p_B[:, :, None])[:, :, 0] + t_0B
    p_C = p_0 if c == 0 else p_0 @ state.X_10[:3, :3].T + state.X_10[:3, 3]
    uv, by_point, by_values = project_with_derivatives(state.lenses[c], p_C)
    by_shared = np.zeros((len(uv), 2, state.shared))
    at = sum(state.sizes[:c])
    by_shared[:, :, at : at + state.sizes[c]] = by_values
    by_p0 = by_point
    if c == 1:
        R_10 = state.X_10[:3, :3]
        by_shared[:, :, -6:-3] = -by_point @ (R_10 @ hat(p_0))
        by_shared[:, :, -3:] = by_point
        by_p0 = by_point @ R_10
    by_pose = np.concatenate([-by_p0 @ (R_0B @ hat(seen.p_B)), by_p0], axis=2)
    return seen.uv_px - uv, by_shared, by_pose


def adjust(
    data: Sequence[CornerData], state: RigState, free: Bools, robust: bool, by_view: bool = True
) -> Adjusted:
    """Minimize from a start; ``free`` (shared,) says which shared unknowns may move.

    ``robust``: Cauchy's kernel. ``by_view``: each view has its own standard deviation, else each camera.
    """
    views = len(state.X_CB)
    sigmas = tuple(np.full(views, _spread(each)) for each in residuals_of(state, data))
    result = _minimize(data, state, free, sigmas, robust)
    # The weights follow from the residuals, which follow from the weights.
    for _ in range(3):
        sigmas = _sigmas(result.residuals, data, views, robust, by_view)
        result = _minimize(data, result.state, free, sigmas, robust)
    sigmas = _sigmas(result.residuals, data, views, robust, by_view)
    system = _System(data, result.state, sigmas, False)
    return replace(result, sigma_px=sigmas, covariance=system.covariance(free))


def _spread(residuals: Array) -> float:
    """Robust standard deviation of a coordinate [px]."""
    lengths = np.hypot(residuals[:, 0], residuals[:, 1])
    lengths = lengths[np.isfinite(lengths)]
    # of the length of a residual, in standard deviations of one coordinate
    return max(float(np.median(lengths)) / 1.1774, FLOOR_PX) if len(lengths) else 1.0


def _sigmas(
    residuals: Sequence[Array], data: Sequence[CornerData], views: int, robust: bool, by_view: bool
) -> tuple[Array, ...]:
    """By camera (V,) [px]: of each view, with some weight of the whole camera."""
    if robust:
        return tuple(np.full(views, _spread(each)) for each in residuals)
    # of 2 N residuals the poses, which both cameras share, take 6 a view; the shared unknowns the rest
    total = sum(len(each) for each in residuals)
    out = []
    seen_by = np.array([np.bincount(each.view, minlength=views) for each in data])
    cameras = (seen_by > 0).sum(axis=0)
    for each, seen, counts in zip(residuals, data, seen_by, strict=True):
        squares = np.bincount(seen.view, np.nan_to_num((each**2).sum(axis=1)), views)
        taken = 6.0 / np.maximum(cameras, 1) + (24.0 * counts / total)
        freedom = np.where(counts > 0, np.maximum(2.0 * counts - taken, 1.0), 0.0)
        pooled = squares.sum() / max(freedom.sum(), 1.0)
        own = (
            (squares + POOL_COUNTS * pooled) / (freedom + POOL_COUNTS) if by_view else np.full(views, pooled)
        )
        out.append(np.where(counts > 0, np.sqrt(np.maximum(own, FLOOR_PX**2)), np.nan))
    return tuple(out)


class _System:
    """The normal equations at a state: cost, reduced matrix, step."""

    def __init__(
        self, data: Sequence[CornerData], state: RigState, sigmas: Sequence[Array], robust: bool
    ) -> None:
        S, views = state.shared, len(state.X_CB)
        information = state.prior_sigmas**-2.0
        self.H = np.diag(information)
        self.g = -information * state.values
        self.H_sv, self.H_vv = np.zeros((views, S, 6)), np.zeros((views, 6, 6))
        self.g_v = np.zeros((views, 6))
        self.cost = float(information @ state.values**2)
        self.residuals = []
        for c, seen in enumerate(data):
            r, by_shared, by_pose = _linearize(state, data, c)
            self.residuals.append(r)
            scaled = (r**2).sum(axis=1) / sigmas[c][seen.view] ** 2
            # a point behind a camera has no derivative, and must not be a way to a lower cost
            lost = ~np.isfinite(scaled)
            scaled = np.where(lost, 1e6, scaled)
            weight = 1.0 / sigmas[c][seen.view] ** 2
            if robust:
                self.cost += float((CAUCHY**2 * np.log1p(scaled / CAUCHY**2)).sum())
                weight = weight / (1.0 + scaled / CAUCHY**2)
            else:
                self.cost += float(scaled.sum())
            J = np.concatenate([by_shared, by_pose], axis=2)
            J[lost], r = 0.0, np.where(lost[:, None], 0.0, r)
            root = np.sqrt(weight)[:, None]
            J, r = J * root[:, :, None], r * root
            ends = np.searchsorted(seen.view, np.arange(views + 1))
            for v in range(views):
                part = slice(ends[v], ends[v + 1])
                if part.start == part.stop:
                    continue
                A = J[part].reshape(-1, S + 6)
                M, b = A.T @ A, A.T @ r[part].ravel()
                self.H += M[:S, :S]
                self.g += b[:S]
                self.H_sv[v] += M[:S, S:]
                self.H_vv[v] += M[S:, S:]
                self.g_v[v] += b[S:]

    def _eliminated(self, damping: float) -> tuple[Array, Array]:
        """Inverses (V, 6, 6) of the views' blocks, and H_sv H_vv^-1 (V, S, 6)."""
        diagonal = np.einsum("vii->vi", self.H_vv)
        scale = np.sqrt(np.maximum(diagonal, 1e-12))
        blocks = self.H_vv / (scale[:, :, None] * scale[:, None, :]) + (damping + 1e-13) * np.eye(6)
        inverse = np.linalg.inv(blocks) / (scale[:, :, None] * scale[:, None, :])
        return inverse, self.H_sv @ inverse

    def step(self, free: Bools, damping: float) -> tuple[Array, Array]:
        """The damped step: (shared,) and (V, 6)."""
        inverse, through = self._eliminated(damping)
        own = np.diag(self.H) * damping
        reduced = self.H + np.diag(own) - np.einsum("vsi,vti->st", through, self.H_sv)
        right = self.g - np.einsum("vsi,vi->s", through, self.g_v)
        step = np.zeros(len(self.g))
        step[free] = _solve(reduced[np.ix_(free, free)], right[free])
        poses = np.einsum("vij,vj->vi", inverse, self.g_v - np.einsum("vsi,s->vi", self.H_sv, step))
        return step, poses

    def covariance(self, free: Bools) -> Array:
        """(shared, shared), 0 for what is fixed."""
        _, through = self._eliminated(0.0)
        reduced = (self.H - np.einsum("vsi,vti->st", through, self.H_sv))[np.ix_(free, free)]
        out = np.zeros_like(self.H)
        scale = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
        inverse = np.linalg.pinv(reduced / np.outer(scale, scale), rcond=1e-14, hermitian=True)
        out[np.ix_(free, free)] = inverse / np.outer(scale, scale)
        return out


def _solve(matrix: Array, right: Array) -> Array:
    if not len(right):
        return right
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix / np.outer(scale, scale)
    return np.asarray(np.linalg.lstsq(unit, right / scale, rcond=1e-14)[0] / scale)


def _minimize(
    data: Sequence[CornerData], state: RigState, free: Bools, sigmas: Sequence[Array], robust: bool
) -> Adjusted:
    """Levenberg and Marquardt with fixed standard deviations."""
    damping, converged = 1e-4, False
    system = _System(data, state, sigmas, robust)
    for _ in range(60):
        step, poses = system.step(free, damping)
        moved = state.moved(step, poses)
        trial = _System(data, moved, sigmas, robust)
        if np.isfinite(trial.cost) and trial.cost <= system.cost:
            gain = system.cost - trial.cost
            state, system, damping = moved, trial, max(damping / 10.0, 1e-12)
            if gain <= 1e-9 * (1.0 + system.cost):
                converged = True
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                converged = True
                break
    none = np.zeros((state.shared, state.shared))
    return Adjusted(state, tuple(system.residuals), none, tuple(sigmas), converged)


def epipolar_errors(state: RigState, data: tuple[CornerData, CornerData]) -> tuple[Array, Array]:
    """Right pixels (n, 2) of the corners that both cameras see, and how far they are from the epipolar planes
    of the left ones, (n,) signed [px].

    The angle between the right ray and the plane through the left ray and the baseline, times the pixels that
    an angle has where the right ray is seen.
    """
    keys = [
        [(int(view), *point) for view, point in zip(each.view, each.p_B.tolist(), strict=True)]
        for each in data
    ]
    place = {key: k for k, key in enumerate(keys[1])}
    both = [(k, place[key]) for k, key in enumerate(keys[0]) if key in place]
    of_left, of_right = np.array(both, dtype=np.int64).reshape(-1, 2).T
    right_px = data[1].uv_px[of_right]
    left = rays(state.lenses[0], data[0].uv_px[of_left]) @ state.X_10[:3, :3].T
    right = rays(state.lenses[1], right_px)
    normal = np.cross(state.X_10[:3, 3], left)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.arcsin(np.clip((normal * right).sum(axis=1), -1.0, 1.0))
    # by a step of one pixel along each axis of the image
    change = [((rays(state.lenses[1], right_px + step) - right) * normal).sum(axis=1) for step in np.eye(2)]
    return right_px, np.asarray(angle / np.hypot(change[0], change[1]))
