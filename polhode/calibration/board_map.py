"""Where a smooth map has the points of a board in an image, by where most of some known points are.

    u(p) = d_f(H p) + sum_k b_k T_k(p):

a homography H, the distortion d_f of an equidistant fisheye about the image's middle, of that focal length f
of a few that fits best (an infinite one: none), and a polynomial for what is left of the lens. Some of the
points may be wrong: H has the least median of squares, and the polynomial is weighted.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from polhode.geometry.lie import Array

FOCAL_SHARES = (np.inf, 1.2, 0.8, 0.6, 0.5, 0.42, 0.36, 0.3, 0.25)
"""Focal lengths that are tried, over the larger side of the image."""
_TRIALS = 300


@dataclass(frozen=True)
class BoardMap:
    """The map of a plane board into an image."""

    H: Array
    """(3, 3) from the board [m] to the undistorted image, from its middle [px]"""
    focal_px: float
    middle_px: Array
    """(2,) of the image"""
    degree: int
    centre_m: Array
    """(2,) of the points that the polynomial was fitted to"""
    side_m: float
    bend: Array
    """(k, 2) coefficients of the polynomial [px]"""

    def __call__(self, p_m: Array) -> Array:
        """Points (n, 2) of the board -> (n, 2) [px]."""
        return self.without_bend(p_m) + _terms((p_m - self.centre_m) / self.side_m, self.degree) @ self.bend

    def without_bend(self, p_m: Array) -> Array:
        """The same without the polynomial."""
        return self.middle_px + distorted(_mapped(self.H, p_m), self.focal_px)

    def scale(self, p_m: Array, step_m: float) -> Array:
        """(n,) pixels a metre at points (n, 2), along that axis of the board which is seen shorter."""
        steps = (np.array([step_m, 0.0]), np.array([0.0, step_m]))
        lengths = [np.linalg.norm(self(p_m + d) - self(p_m - d), axis=1) for d in steps]
        return np.asarray(np.min(lengths, axis=0) / (2.0 * step_m))


def fitted_map(p_m: Array, uv_px: Array, size_px: tuple[int, int]) -> BoardMap | None:
    """The map that has most of the points (n, 2) of the board where they are seen, (n, 2); NaN: not seen.

    None: too few are seen.
    """
    known = np.isfinite(uv_px).all(axis=1)
    p_m, uv_px = p_m[known], uv_px[known]
    if len(p_m) < 8:
        return None
    middle = 0.5 * (np.array(size_px) - 1.0)
    centre, side = p_m.mean(axis=0), float(np.ptp(p_m, axis=0).max())
    nothing = np.zeros((1, 2))
    best, least = None, np.inf
    for focal, flat in _flat(uv_px - middle, size_px):
        H = cv2.findHomography(p_m, flat, cv2.LMEDS, maxIters=_TRIALS)[0]
        if H is None:
            continue
        trial = BoardMap(np.asarray(H, dtype=np.float64), focal, middle, 0, centre, side, nothing)
        error = float(np.median(np.linalg.norm(trial.without_bend(p_m) - uv_px, axis=1)))
        if error < least:
            best, least = trial, error
    if best is None:
        return None
    degree = next(k for k in (4, 3, 2, 1, 0) if len(p_m) >= 1.5 * (k + 1) * (k + 2) or not k)
    bend = _bend(_terms((p_m - centre) / side, degree), uv_px - best.without_bend(p_m))
    return BoardMap(best.H, best.focal_px, middle, degree, centre, side, bend)


def misfit(p_m: Array, uv_px: Array, unit_m: float, size_px: tuple[int, int], bent: bool = True) -> float:
    """Median distance, in units, of points (n, 2) of the board from where the best homography has them.

    ``bent``: with the lens of a fisheye, if that fits better. 0: too few points to say.
    """
    if len(p_m) < 4:
        return 0.0
    least = np.inf
    for _, flat in _flat(uv_px - 0.5 * (np.array(size_px) - 1.0), size_px):
        H = cv2.findHomography(flat, p_m, cv2.LMEDS, maxIters=_TRIALS)[0]
        if H is not None:
            least = min(
                least,
                float(np.median(np.linalg.norm(_mapped(np.asarray(H, np.float64), flat) - p_m, axis=1))),
            )
        if not bent:
            break
    return least / unit_m


def distorted(xy_px: Array, focal_px: float) -> Array:
    """Points (n, 2) from the middle of an image of a pinhole -> those of an equidistant fisheye."""
    if np.isinf(focal_px):
        return xy_px
    angle = np.hypot(xy_px[:, 0], xy_px[:, 1]) / focal_px
    return xy_px * (np.arctan(angle) / np.maximum(angle, 1e-12))[:, None]


def _flat(xy_px: Array, size_px: tuple[int, int]) -> Iterator[tuple[float, Array]]:
    """Focal lengths, and where a pinhole would have points (n, 2), from the middle of the image."""
    for share in FOCAL_SHARES:
        focal = share * max(size_px)
        angle = np.hypot(xy_px[:, 0], xy_px[:, 1]) / focal
        if np.isinf(focal):
            yield focal, xy_px
        # points further from the axis would be nowhere on a plane
        elif angle.max() < 1.3:
            yield focal, xy_px * (np.tan(angle) / np.maximum(angle, 1e-12))[:, None]


def _bend(A: Array, off_px: Array) -> Array:
    """Coefficients (k, 2) for terms (n, k) that explain most of (n, 2), by reweighted least squares."""
    weight = np.ones(len(A))
    bend: Array = np.zeros((A.shape[1], 2))
    for _ in range(8):
        bend = np.asarray(np.linalg.lstsq(A * weight[:, None], off_px * weight[:, None], rcond=1e-9)[0])
        distance = np.linalg.norm(off_px - A @ bend, axis=1)
        scale = max(float(np.median(distance)), 0.02)
        weight = 1.0 / (1.0 + (distance / (2.0 * scale)) ** 2)
    return bend


def _mapped(H: Array, p: Array) -> Array:
    return np.asarray(cv2.perspectiveTransform(p[:, None], H), dtype=np.float64).reshape(-1, 2)


def _terms(unit: Array, degree: int) -> Array:
    """(n, k) terms of a polynomial at points (n, 2)."""
    x, y = unit[:, 0], unit[:, 1]
    return np.stack([x**a * y**b for a in range(degree + 1) for b in range(degree + 1 - a)], axis=1)
