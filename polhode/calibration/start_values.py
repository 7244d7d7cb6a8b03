"""Start values of one camera: the focal length from a search, the poses of the boards by OpenCV's IPPE.

For each focal length of a geometric series, the poses of the boards under a lens without distortion are
found in closed form; the one whose corners fit best is the start. Collins and Bartoli, "Infinitesimal
plane-based pose estimation", IJCV 109, 2014, gives a plane's two poses; the one that fits better is taken.
"""

import cv2
import numpy as np

from polhode.calibration.adjustment import Adjusted, CornerData, RigState, adjust
from polhode.calibration.lenses import Lens, Model, normalized_by_newton, project, without_distortion
from polhode.geometry import fisheye
from polhode.geometry.lie import Array, exp_so3, make_pose

FOCAL_SHARES = tuple(0.2 * 1.3**k for k in range(15))
"""Focal lengths that are tried, over the larger side of the image: 0.2 to 8."""


def start(data: CornerData, model: Model, size_px: tuple[int, int], views: int) -> RigState:
    """A rough lens, and poses (V, 4, 4) of all views. Views without corners have the identity."""
    some = np.unique(np.linspace(0, views - 1, min(views, 12)).astype(int))
    sample = data.kept(np.isin(data.view, some))
    best, least = without_distortion(model, float(max(size_px)), size_px), np.inf
    for share in FOCAL_SHARES:
        lens = without_distortion(model, share * max(size_px), size_px)
        errors = board_poses(lens, sample, views)[1][some]
        error = float(np.median(errors[np.isfinite(errors)])) if np.isfinite(errors).any() else np.inf
        if error < least:
            best, least = lens, error
    return RigState((best,), board_poses(best, data, views)[0], np.eye(4))


def calibrated_alone(data: CornerData, model: Model, size_px: tuple[int, int], views: int) -> Adjusted:
    """One camera from nothing, with Cauchy's kernel: focal length, then centre and k1, then all."""
    state = start(data, model, size_px, views)
    count = len(state.lenses[0].values)
    stages = ([0, 1], [0, 1, 4], [0, 1, 2, 3, 4, 5], list(range(count)))
    result = None
    for number, stage in enumerate(stages):
        free = np.zeros(count, dtype=np.bool_)
        free[stage] = True
        result = adjust((data,), state, free, robust=True)
        state = result.state
        if number == 1:
            # with the lens roughly known, the better of a plane's two poses may be the other one
            poses, errors = board_poses(state.lenses[0], data, views)
            now = _rms(result.residuals[0], data, views)
            better = np.isfinite(errors) & (errors < now)
            state = RigState(state.lenses, np.where(better[:, None, None], poses, state.X_CB), state.X_10)
    assert result is not None
    return result


def board_poses(lens: Lens, data: CornerData, views: int) -> tuple[Array, Array]:
    """Poses (V, 4, 4) of the boards under a lens, and rms errors (V,) [px]; infinite: no pose was found."""
    poses, errors = np.tile(np.eye(4), (views, 1, 1)), np.full(views, np.inf)
    flat = normalized(lens, data.uv_px)
    for v in np.unique(data.view).tolist():
        part = data.view == v
        use = part & np.isfinite(flat).all(axis=1)
        if use.sum() < 6:
            poses[v, 2, 3] = 1.0
            continue
        poses[v], errors[v] = _plane_pose(lens, data.p_B[use], flat[use], data.uv_px[use])
    return poses, errors


def _plane_pose(lens: Lens, p_B: Array, flat: Array, uv_px: Array) -> tuple[Array, float]:
    """The pose (4, 4) of a plane z = 0 by the coordinates (n, 2) of its points at z = 1; rms error [px]."""
    middle = p_B.mean(axis=0)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            (p_B - middle)[:, None], flat[:, None], np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        turns, shifts = (), ()
    best, least = make_pose(np.eye(3), np.array([0.0, 0.0, 1.0])), np.inf
    for turn, shift in zip(turns, shifts, strict=True):
        R = exp_so3(np.ravel(turn))
        X = make_pose(R, np.ravel(shift) - R @ middle)
        error = float(np.sqrt(((project(lens, p_B @ R.T + X[:3, 3]) - uv_px) ** 2).sum(axis=1).mean()))
        if error < least:
            best, least = X, error
    return best, least


def normalized(lens: Lens, uv_px: Array) -> Array:
    """Where rays of pixels (n, 2) meet the plane z = 1, (n, 2); NaN: too far from the axis for it."""
    if lens.is_fisheye:
        rays = fisheye.rays(uv_px, lens.K, lens.coefficients)
        # rays further from the axis do not serve the first poses, which need a plane z = 1
        far = ~(rays[:, 2] > np.cos(np.radians(78.0)))
        return np.asarray(
            np.where(far[:, None], np.nan, rays[:, :2] / np.where(far, 1.0, rays[:, 2])[:, None])
        )
    if not lens.coefficients.any():
        return np.asarray((uv_px - lens.values[2:4]) / lens.values[:2])
    return normalized_by_newton(lens, uv_px)


def _rms(residuals: Array, data: CornerData, views: int) -> Array:
    """(V,) root mean square length of the residuals of each view [px]."""
    counts = np.bincount(data.view, minlength=views)
    squares = np.bincount(data.view, (residuals**2).sum(axis=1), views)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))
