"""The effect of each error of the calibration on rectified measurements, from the lenses and the prior.

A point projects through the true cameras, and its image is undistorted and rectified with the stated ones. To
first order that is the change of the projection with the parameter, carried back by the derivative of the
projection in the place of the rectified image, both by central differences on a grid.
"""

from dataclasses import replace

import numpy as np

from polhode.frontend.rectification import Lens, Rectifier
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose
from polhode.records.calibration_effects import CalibrationEffects, terms_at
from polhode.records.calibration_prior import CLOCK, POSITION, TURN, CalibrationPrior, prior_of
from polhode.records.rig_calibration import StereoCalibration

GRID = (29, 23)
"""Columns and rows of places in the rectified image"""
STEPS = (1e-2, 1e-5)
"""Of focal lengths and principal points [px], and of coefficients, whose powers bound the change"""


def calibration_effects(
    calibration: StereoCalibration, rectifier: Rectifier, poses_stated: bool, has_ranges: bool = False
) -> CalibrationEffects | None:
    """None: the calibration is exact.

    poses_stated: whether N is that of stated poses of the body, to which the rig's pose in it then matters.
    """
    prior, rig = prior_of(calibration), rectifier.rig
    if not prior.factor.shape[1]:
        return None
    # D: right camera as calibrated
    R_RC = rectifier.X_CR[:3, :3].T
    R_CD = (inverse_pose(calibration.X_BC0) @ calibration.X_BC1)[:3, :3]
    axes = R_RC, R_RC @ R_CD
    right_rig = replace(rig, cx_px=rig.cx_px - rig.disparity_offset_px)
    fields = [
        _lens_terms(Lens.of(calibration, i), axes[i], own, _rows(prior, i))
        for i, own in enumerate((rig, right_rig))
    ]
    of_body = np.zeros((2, 3, prior.factor.shape[1]))
    if poses_stated:
        shift_B, turn_C = _of(prior, "cam0", POSITION), _of(prior, "cam0", TURN)
        of_body[:] = R_RC @ calibration.X_BC0[:3, :3].T @ shift_B, R_RC @ turn_C
    return CalibrationEffects(
        source=prior.source,
        left=fields[0],
        right=fields[1],
        right_shift_m=R_RC @ _of(prior, "cam1", POSITION),
        right_turn_rad=axes[1] @ _of(prior, "cam1", TURN),
        right_later_s=prior.factor[prior.names.index(CLOCK)],
        body_shift_m=of_body[0],
        body_turn_rad=of_body[1],
        has_ranges=has_ranges,
        names=prior.names,
        factor=prior.factor,
    )


def _of(prior: CalibrationPrior, camera: str, names: tuple[str, ...]) -> Array:
    return prior.factor[[prior.names.index(f"{camera}.{name}") for name in names]]


def _rows(prior: CalibrationPrior, camera: int) -> Array:
    """(4 + n, c) rows of the factor of the parameters of a lens, in their order."""
    own = (*POSITION, *TURN, "clock_offset")
    split = [name.partition(".") for name in prior.names]
    return prior.factor[[name == f"cam{camera}" and rest not in own for name, _, rest in split]]


def _lens_terms(lens: Lens, R_RC: Array, rig: RectifiedRig, factor: Array) -> Array:
    """(T, 2, c) of the shift of the rectified image by one sigma of each error; factor (4 + n, c).

    ``rig`` has the principal point of this camera's rectified image.
    """
    v, u = np.mgrid[: rig.height_px - 1 : GRID[1] * 1j, : rig.width_px - 1 : GRID[0] * 1j]
    places = np.stack([u.ravel(), v.ravel()], axis=1)

    def seen(uv_px: Array, changed: Lens = lens) -> Array:
        """Pixels (n, 2) of the original image of places (n, 2) of the rectified one."""
        slopes = (uv_px - np.array([rig.cx_px, rig.cy_px])) / rig.focal_px
        return changed.project(np.column_stack([slopes, np.ones(len(slopes))]) @ R_RC)

    at = seen(places)
    low, high = -0.1 * np.array(lens.size_px), 1.1 * np.array(lens.size_px)
    inside = np.isfinite(at).all(axis=1) & (at > low).all(axis=1) & (at < high).all(axis=1)
    places = places[inside]
    step = 0.5 * np.eye(2)
    J = np.stack([seen(places + e) - seen(places - e) for e in step], axis=2)
    columns = []
    for n in range(len(factor)):
        h = STEPS[n >= 4]
        columns.append((seen(places, _moved(lens, n, h)) - seen(places, _moved(lens, n, -h))) / (2.0 * h))
    by_parameter = np.stack(columns, axis=2)
    shift = np.linalg.solve(J, by_parameter) @ factor
    # beyond what the lens shows its derivatives may be anything
    sound = np.isfinite(shift).all(axis=(1, 2)) & (np.linalg.det(J) > 0.1 * np.median(np.linalg.det(J)))
    terms = np.linalg.lstsq(terms_at(places[sound], rig), shift[sound].reshape(int(sound.sum()), -1))[0]
    return np.asarray(terms.reshape(len(terms), 2, -1))


def _moved(lens: Lens, n: int, step: float) -> Lens:
    """The lens with parameter n, of fu, fv, cu, cv and the coefficients, changed."""
    K, dist = lens.K.copy(), lens.dist.copy()
    if n < 4:
        K[(0, 1, 0, 1)[n], (0, 1, 2, 2)[n]] += step
    else:
        dist[n - 4] += step
    return replace(lens, K=K, dist=dist)
