"""The classical method: least squares refine semi-global disparities, planes and facets smooth them.

Refinement is windowed least squares (Lucas and Kanade 1981) along the epipolar line: in a window, left = gain
* right(u - d - delta) + offset. The right image is warped with every pixel's own disparity, so slanted
surfaces do not bias delta. The information of the normal equations gives sigma.

Smoothing is piecewise planar: a flat facet of the target is exactly a plane in disparity. ``fit_planes``:
around every pixel a plane is fitted in several windows, centred and shifted; the one with the smallest
scatter is used (as in Kuwahara's filter), so edges between facets are not rounded. Where even that plane
leaves residuals above the noise, the surface is rough at this scale and windows of half the size are used.

``fit_facets``: inside a uniformly lit panel without texture no window determines the disparity, but the
panel's outline and the marks on it do. Each textureless patch of the image gets the plane on which its
surroundings agree (iteratively reweighted least squares); the plane's covariance limits how far it is
extrapolated.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.sgbm import MIN_INTENSITY, WINDOW_PX, Floats, StereoCrop, match_checked
from polhode.frontend.rectification import Image
from polhode.geometry.lie import Array, Bools
from polhode.runtime.compiled import compiled_fused_ieee, compiled_inline

PLANE_RADIUS_PX = 6
"""Half side of the windows in which the disparity is taken as a plane."""
SIGMA_FLOOR_PX = 0.05
"""Errors that the noise model omits: slant, specular reflection, interpolation."""
MIN_MATCHED_PIXELS = 50
"""With fewer matched pixels there is no disparity."""
_MAX_STEP_PX = 0.5
_MIN_AREA_PX = 40
_EDGE_PX = 4
"""Pixels within this distance of a textureless patch still belong to its facet."""
_SCALES_PX = (2.0, 1.0, 0.5, 0.3)
"""Scale of the robust kernel in each round."""
_MIN_FILLED_SHARE = 0.3
_OUTLIER_SIGMAS = 3.0


def classical_disparity(crop: StereoCrop, config: Depth) -> tuple[Floats, Floats]:
    """Disparities and their standard deviations (h, w) [px], NaN where there are none."""
    disparity = match_checked(crop, config)
    if np.isfinite(disparity).sum() < MIN_MATCHED_PIXELS:
        return np.full_like(disparity, np.nan), np.full_like(disparity, np.nan)
    sigma = np.full_like(disparity, 0.3)
    by_window, sigma_window = disparity, sigma
    for _ in range(3):  # rounds of sub-pixel refinement and smoothing
        by_window, sigma_window = refine_dense(crop.left, crop.right, disparity, crop.search_px)
        disparity, sigma = fit_planes(by_window, sigma_window, PLANE_RADIUS_PX, float(WINDOW_PX**2))
    facet, sigma_facet = crop_facets(crop, by_window, sigma_window)
    flat = sigma_facet < np.where(np.isfinite(sigma), sigma, np.inf)
    disparity, sigma = np.where(flat, facet, disparity), np.where(flat, sigma_facet, sigma)
    return disparity.astype(np.float32), np.hypot(sigma, SIGMA_FLOOR_PX).astype(np.float32)


def refine_dense(
    left: Image | Floats, right: Image | Floats, disparity: Floats, margin_px: int
) -> tuple[Floats, Floats]:
    """One least-squares step for every pixel.

    left, right (h, w + 2 margin): the target is in columns margin..margin + w; disparity (h, w) [px]. Returns
    disparity and sigma (h, w) [px]; NaN where the input is NaN.
    """
    known = np.isfinite(disparity)
    h, w = disparity.shape
    reference = left[:, margin_px : margin_px + w].astype(np.float32)
    filled = np.where(known, disparity, 0.0).astype(np.float32)
    u = np.arange(w, dtype=np.float32)[None, :] + margin_px - filled
    v = np.broadcast_to(np.arange(h, dtype=np.float32)[:, None], (h, w)).copy()
    other = right.astype(np.float32)
    warped = np.asarray(cv2.remap(other, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.float32)
    # derivatives along the rows [1/px]
    difference = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
    slope = cv2.filter2D(other, cv2.CV_32F, difference)
    slope_right = np.asarray(
        cv2.remap(slope, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
    )
    slope_left = np.asarray(cv2.filter2D(left.astype(np.float32), cv2.CV_32F, difference), np.float32)
    slope_left = slope_left[:, margin_px : margin_px + w]
    gradient = 0.5 * (slope_left + slope_right)
    # means over a square window; pixels outside the image count as 0
    window, beside = (WINDOW_PX, WINDOW_PX), cv2.BORDER_CONSTANT
    weight = known.astype(np.float32)
    count = np.asarray(cv2.blur(weight, window, borderType=beside), np.float32)
    safe = np.maximum(count, 1e-6)

    def mean(image: Floats) -> Floats:
        return np.asarray(cv2.blur(weight * image, window, borderType=beside) / safe, dtype=np.float32)

    m_left, m_warped, m_gradient = mean(reference), mean(warped), mean(gradient)
    var_left = mean(reference * reference) - m_left * m_left
    var_warped = mean(warped * warped) - m_warped * m_warped
    covariance = mean(reference * warped) - m_left * m_warped
    gain = np.clip(covariance / np.maximum(var_warped, 1.0), 0.6, 1.6)
    # The noise of the two images is independent: in the product of their slopes it does not look like
    # texture.
    gg = np.maximum(mean(slope_left * slope_right) - mean(slope_left) * mean(slope_right), 1e-3)
    error_gradient = (
        mean(reference * gradient)
        - m_left * m_gradient
        - gain * (mean(warped * gradient) - m_warped * m_gradient)
    )
    information = gain * gain * gg
    delta = -gain * error_gradient / information
    residual = var_left - 2 * gain * covariance + gain * gain * var_warped - delta * delta * information
    noise = np.maximum(residual, 1.0)
    samples = np.maximum(count * WINDOW_PX**2, 1.0)
    sigma = np.sqrt(noise / (information * samples))
    delta = np.clip(delta, -_MAX_STEP_PX, _MAX_STEP_PX)
    # An uncertain step is shortened.
    delta *= 0.3**2 / (0.3**2 + np.minimum(sigma, 10.0) ** 2)
    return (
        np.where(known, disparity + delta, np.nan).astype(np.float32),
        np.where(known, sigma, np.nan).astype(np.float32),
    )


def fit_planes(
    disparity: Floats, sigma: Floats, radius_px: int, correlated_px2: float
) -> tuple[Floats, Floats]:
    """Smoothed disparity and its sigma (h, w) [px] from noisy ones; NaN stays NaN.

    correlated_px2: area over which the errors of neighbours are equal, so that averaging does not reduce
    them.
    """
    known = np.isfinite(disparity) & np.isfinite(sigma)
    d = np.where(known, disparity, 0.0).astype(np.float64)
    weight = np.where(known, 1.0 / (np.square(np.where(known, sigma, 1.0), dtype=np.float64) + 0.05**2), 0.0)

    def best_plane(weight: Array, radius_px: int) -> tuple[Array, Array, Bools]:
        """Value of the best window's plane at each pixel, its variance, and whether there is one."""
        planes = plane_per_window(d, weight, radius_px, correlated_px2)
        value, variance, score = best_window(planes, max(1, round(0.7 * radius_px)))
        return value, variance, np.asarray(np.isfinite(score))

    plane, _, _ = best_plane(weight, radius_px)
    limit = _OUTLIER_SIGMAS * np.hypot(np.where(known, sigma, 1.0), 0.1)
    robust = np.where(np.abs(d - plane) < limit, weight, 0.01 * weight)
    plane, variance, good = best_plane(robust, radius_px)
    # mean squared distance from the plane, in variances, above which the surface is not planar at this scale
    rough = cv2.blur(np.square(d - plane) * weight, (5, 5)) > 2.0
    if rough.any():
        near, near_variance, near_good = best_plane(robust, max(radius_px // 2, 1))
        rough &= near_good
        plane, variance = np.where(rough, near, plane), np.where(rough, near_variance, variance)
        good |= rough
    out = known & good
    return (
        np.where(out, plane, np.nan).astype(np.float32),
        np.where(out, np.sqrt(variance), np.nan).astype(np.float32),
    )


@compiled_fused_ieee
def plane_per_window(d: Array, weight: Array, radius_px: int, correlated_px2: float) -> Array:
    """Weighted planes in the window around each pixel of d (h, w): (h, w, 5).

    Slopes a, b, value at the centre, its variance, and mean squared scatter, infinite where too few pixels of
    the window have a weight. Coordinates count from the centre; running sums over columns, then along rows.
    """
    h, w = d.shape
    r = radius_px
    out = np.empty((h, w, 5))
    column, total, term = np.zeros((w, 11)), np.empty(11), np.empty(11)
    least = _MIN_FILLED_SHARE * (2 * r + 1) ** 2
    for v in range(-r, h):
        # rows enter and leave the sums of the columns; rows outside the image have no weight
        for sign, row in ((1.0, v + r), (-1.0, v - r - 1)):
            if row < 0 or row >= h:
                continue
            for u in range(w):
                _terms(float(row), float(u), d[row, u], sign * weight[row, u], term)
                for c in range(11):
                    column[u, c] += term[c]
        if v < 0:
            continue
        total[:] = 0.0
        for u in range(-r, w):
            if u + r < w:
                total += column[u + r]
            if u < 0:
                continue
            if u - r - 1 >= 0:
                total -= column[u - r - 1]
            s = max(total[0], 1e-9)
            mu, mv, md = total[1] / s, total[2] / s, total[3] / s
            uu = total[4] / s - mu * mu + 1e-3
            vv = total[5] / s - mv * mv + 1e-3
            uv = total[6] / s - mu * mv
            ud = total[7] / s - mu * md
            vd = total[8] / s - mv * md
            dd = total[9] / s - md * md
            determinant = max(uu * vv - uv * uv, 1e-6)
            a = (ud * vv - vd * uv) / determinant
            b = (vd * uu - ud * uv) / determinant
            scatter = max(dd - a * ud - b * vd, 0.0) + 1e-4
            count = total[10]
            # Disparities of neighbours come from overlapping windows: far fewer are independent.
            independent = max(count / correlated_px2, 1.0)
            out[v, u, 0], out[v, u, 1] = a, b
            out[v, u, 2] = md + a * (u - mu) + b * (v - mv)
            out[v, u, 3] = scatter / independent + correlated_px2 / s
            out[v, u, 4] = scatter if count > least else np.inf
    return out


@compiled_inline
def _terms(v: float, u: float, d: float, weight: float, out: Array) -> None:
    """What a pixel adds to the sums of a window; a negative weight takes it away."""
    wu, wv, wd = weight * u, weight * v, weight * d
    out[0], out[1], out[2], out[3] = weight, wu, wv, wd
    out[4], out[5], out[6] = wu * u, wv * v, wu * v
    out[7], out[8], out[9] = wu * d, wv * d, wd * d
    out[10] = 0.0
    if weight > 0.0:
        out[10] = 1.0
    elif weight < 0.0:
        out[10] = -1.0


@compiled_fused_ieee
def best_window(planes: Array, step_px: int) -> tuple[Array, Array, Array]:
    """The best of nine windows, centred and shifted by a step, at each pixel: value, variance and score.

    planes (h, w, 5) as of ``plane_per_window``. The score (h, w) is infinite where no window is usable.
    """
    h, w = planes.shape[:2]
    value, variance, score = np.empty((h, w)), np.empty((h, w)), np.empty((h, w))
    for v in range(h):
        for u in range(w):
            best = planes[v, u, 4]
            dv_best, du_best = 0, 0
            for i in range(-1, 2):
                row = v + i * step_px
                if row < 0 or row >= h:
                    continue
                for j in range(-1, 2):
                    column = u + j * step_px
                    if column < 0 or column >= w or (i == 0 and j == 0):
                        continue
                    shifted = 1.15 * planes[row, column, 4]
                    if shifted < best:
                        best, dv_best, du_best = shifted, i * step_px, j * step_px
            at = planes[v + dv_best, u + du_best]
            # the window centred at (u + du, v + dv) extrapolates its plane to (u, v)
            value[v, u] = at[2] - du_best * at[0] - dv_best * at[1]
            variance[v, u] = at[3] if dv_best == 0 and du_best == 0 else 3.0 * at[3]
            score[v, u] = best
    return value, variance, score


def textureless_patches(image: Image, inside: Bools) -> tuple[NDArray[np.int32], int]:
    """Labels (h, w) of connected patches of nearly constant intensity, 0 elsewhere; and their number."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    slope_u = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3) / 8.0
    slope_v = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3) / 8.0
    slope = np.hypot(slope_u, slope_v)
    # The smallest slopes show the sensor's noise, unless there is texture everywhere.
    noise = float(np.percentile(slope[inside], 20)) if inside.any() else 0.0
    # largest slope of the intensity of a textureless pixel, as a share of the intensity [1/px]
    # largest slope that is attributed to noise [8-bit levels/px]
    even = inside & (slope < np.maximum(min(2.5 * noise, 2.0), 0.025 * smooth))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(even.astype(np.uint8), connectivity=4)
    small = np.flatnonzero(np.asarray(stats)[:, cv2.CC_STAT_AREA] < _MIN_AREA_PX)
    labels = np.asarray(labels, dtype=np.int32)
    labels[np.isin(labels, small)] = 0
    return labels, count


def crop_facets(crop: StereoCrop, disparity: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """Disparity and sigma (h, w) [px] on textureless planar patches of a crop; NaN elsewhere.

    disparity, sigma (h, w): of every pixel by its own window, NaN where there is none.
    """
    return fit_facets(
        crop.image, crop.lit, disparity, sigma, float(WINDOW_PX**2), crop.sky + 2.0 * MIN_INTENSITY
    )


def fit_facets(
    image: Image, inside: Bools, disparity: Floats, sigma: Floats, correlated_px2: float, darkest: float
) -> tuple[Floats, Floats]:
    """The same of an image, whose lit pixels of the target are ``inside`` (h, w).

    correlated_px2: as for ``fit_planes``; darkest: intensity below which facets are omitted.
    """
    labels, count = textureless_patches(image, inside)
    value = np.full(disparity.shape, np.nan, dtype=np.float32)
    value_sigma = np.full(disparity.shape, np.nan, dtype=np.float32)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1))
    known = np.isfinite(disparity) & np.isfinite(sigma)
    for label, bounds in enumerate(find_objects(labels, max_label=count - 1), start=1):
        if bounds is None:
            continue
        rows, columns = np.nonzero(labels[bounds] == label)
        rows, columns = rows + bounds[0].start, columns + bounds[1].start
        # A flat facet in sunlight has one brightness, a curved one is shaded; dark pixels show nothing.
        low, middle, high = np.percentile(image[rows, columns], [5.0, 50.0, 95.0])
        # largest spread of the intensity over a facet, as a share of the intensity
        if not (middle > darkest and high - low < 0.15 * middle + 4.0):
            continue
        box = (
            slice(max(rows.min() - _EDGE_PX, 0), rows.max() + _EDGE_PX + 1),
            slice(max(columns.min() - _EDGE_PX, 0), columns.max() + _EDGE_PX + 1),
        )
        patch = cv2.dilate((labels[box] == label).astype(np.uint8), kernel) > 0
        v, u = np.nonzero(patch & known[box])
        v, u = v + box[0].start, u + box[1].start
        fitted = _fit(u, v, disparity[v, u], sigma[v, u], correlated_px2)
        if fitted is not None:
            theta, covariance = fitted
            basis = np.stack([np.ones(len(rows)), columns - u.mean(), rows - v.mean()], axis=1)
            variance = np.einsum("ni,ij,nj->n", basis, covariance, basis)
            value[rows, columns] = basis @ theta
            value_sigma[rows, columns] = np.sqrt(variance + 0.12**2)  # deviation of a facet from a plane
    return value, value_sigma


def _fit(
    u: NDArray[np.int64], v: NDArray[np.int64], d: Floats, sigma: Floats, correlated_px2: float
) -> tuple[Array, Array] | None:
    """The plane d = value + a (u - mean u) + b (v - mean v) on which most of the information agrees: (value,
    a, b) and their covariance; None: there is none."""
    if len(u) < _MIN_AREA_PX:
        return None
    basis = np.stack([np.ones(len(u)), u - u.mean(), v - v.mean()], axis=1)
    information = 1.0 / (sigma.astype(np.float64) ** 2 + 0.05**2)
    weight = information
    values = d.astype(np.float64)
    for scale in _SCALES_PX:
        normal = (basis * weight[:, None]).T @ basis + 1e-9 * np.eye(3)
        theta = np.asarray(np.linalg.solve(normal, basis.T @ (weight * values)), dtype=np.float64)
        residual = values - basis @ theta
        weight = information / (1.0 + (residual / scale) ** 2) ** 2
    # windows along an edge mix two facets: their disparities may deviate by this in addition to their noise
    agrees = np.abs(residual) < 2.5 * np.hypot(sigma, 0.3)
    # share of the information around a patch that must agree with its plane
    if information[agrees].sum() < 0.6 * information.sum():
        return None
    normal = (basis * weight[:, None]).T @ basis + 1e-9 * np.eye(3)
    scatter = float(np.sum(weight * residual**2) / max(len(u) - 3, 1))
    return theta, np.linalg.inv(normal) * correlated_px2 * max(1.0, scatter)
