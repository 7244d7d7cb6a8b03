"""What errors of the calibration do to a rectified stereo measurement: data, which need no camera model.

The lens of each camera moves its image by a smooth function of the place, here polynomials in Chebyshev's
basis; pose and clock of the right camera, and the pose of the rig in its body, act on the point itself.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from polhode.geometry.camera import RectifiedRig, stereo_jacobian
from polhode.geometry.lie import Array, Bools

DEGREE = 7
"""Of the polynomials: the fifth coefficient of a lens has the seventh power of the radius."""

MIN_DISPARITY_PX = 0.1
"""From which on the place of a point is known well enough for the effects."""


@dataclass(frozen=True)
class CalibrationEffects:
    """Effects of one sigma of each of c independent errors of the calibration."""

    source: str
    """Of the sigmas, in words"""
    left: Array
    """(T, 2, c) terms of the shift of the left rectified image [px], true minus stated calibration"""
    right: Array
    """(T, 2, c) of the right one"""
    right_shift_m: Array
    """(3, c) of the right camera along the axes of R"""
    right_turn_rad: Array
    """(3, c)"""
    right_later_s: Array
    """(c,) how much later its images are"""
    body_shift_m: Array
    """(3, c) of the rig in the body whose poses are stated, along the axes of R"""
    body_turn_rad: Array
    """(3, c)"""
    has_ranges: bool = False
    """Whether disparities are from measured ranges, on which no camera has an effect"""
    names: tuple[str, ...] = ()
    """(n,) parameters of the calibration, as in ``CalibrationPrior``"""
    factor: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, c) their changes by one sigma of each error"""

    def mixed(self, by: Array) -> "CalibrationEffects":
        """Effects of k combinations of these errors; by (c, k)."""
        parts = "left", "right", "right_shift_m", "right_turn_rad", "body_shift_m", "body_turn_rad", "factor"
        return replace(
            self, right_later_s=self.right_later_s @ by, **{name: getattr(self, name) @ by for name in parts}
        )

    def taken_off(self, rig: RectifiedRig, uvd_px: Array) -> Array:
        """Measurements (M, 3) [px] without these errors (c = 1), where nothing moves."""
        nearest = np.maximum(uvd_px[:, 2], rig.disparity_offset_px + MIN_DISPARITY_PX)
        p_R = rig.triangulate(np.column_stack([uvd_px[:, :2], nearest]))
        return np.asarray(uvd_px - self.at(rig, p_R)[:, :, 0])

    def at(self, rig: RectifiedRig, p_R: Array, velocity_R: Array | None = None) -> Array:
        """Effects (M, 3, c) on u, v and disparity [px] of points p_R (M, 3) [m].

        velocity_R (M, 3): of the points relative to the camera [m/s], for the clock; None: at rest.
        """
        uvd = rig.project(p_R)
        out = np.zeros((len(p_R), 3, self.left.shape[2]))
        out[:, :2] = _field(self.left, uvd[:, :2], rig)
        if not self.has_ranges:
            q = p_R - np.array([rig.baseline_m, 0.0, 0.0])
            right_uv = uvd[:, :2] - np.stack([uvd[:, 2], np.zeros(len(uvd))], axis=1)
            moved = -_moves(q, self.right_shift_m, self.right_turn_rad)
            if velocity_R is not None:
                moved += velocity_R[:, :, None] * self.right_later_s
            of_pose = rig.focal_px * (moved[:, 0] - (q[:, 0] / q[:, 2])[:, None] * moved[:, 2])
            lens = _field(self.right, right_uv, rig)[:, 0]
            out[:, 2] = out[:, 0] - lens - of_pose / q[:, 2, None]
        if self.body_shift_m.any() or self.body_turn_rad.any():
            J = stereo_jacobian(p_R, rig.focal_px, rig.baseline_m)
            out -= J @ _moves(p_R, self.body_shift_m, self.body_turn_rad)
        return out


def _moves(p: Array, shift: Array, turn: Array) -> Array:
    """(M, 3, c) shift + turn x p, of shifts and turns (3, c)."""
    crossed = np.cross(turn.T[None], p[:, None]).transpose(0, 2, 1)
    return np.asarray(shift + crossed)


def terms_at(uv_px: Array, rig: RectifiedRig) -> Array:
    """(M, T) values of the polynomials' basis at pixels (M, 2); constant beyond a tenth of the image."""
    half = 0.5 * np.array([rig.width_px - 1, rig.height_px - 1])
    x, y = np.clip(uv_px / half - 1.0, -1.2, 1.2).T
    # chebvander2d refuses to make the basis of no pixels, as a frame in the dark has them
    of_x, of_y = (np.polynomial.chebyshev.chebvander(each, DEGREE) for each in (x, y))
    return np.asarray((of_x[:, :, None] * of_y[:, None, :])[:, kept_terms().reshape(DEGREE + 1, -1)])


def kept_terms() -> Bools:
    """Of the basis, those of at most ``DEGREE`` in all."""
    i, j = np.indices((DEGREE + 1, DEGREE + 1))
    return np.asarray((i + j <= DEGREE).ravel())


def _field(terms: Array, uv_px: Array, rig: RectifiedRig) -> Array:
    return np.tensordot(terms_at(uv_px, rig), terms, axes=1)
