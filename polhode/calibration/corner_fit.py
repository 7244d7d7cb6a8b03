"""Corners of four squares to a hundredth of a pixel: a picture of the corner is fitted to the image.

    I(u, v) = b + c E(d1 / s, d2 / s; r),
    d_k = x cos f_k + y sin f_k + h_k (t_k^2 + s^2) / 2,
    r = cos(f1 - f2) + sin(f1 - f2) (h2 t2 - h1 t1),
    E(z1, z2; r) = erf(z1 / sqrt(2)) erf(z2 / sqrt(2))
                   + 4 sum_n r^n / n! He_{n-1}(z1) phi(z1) He_{n-1}(z2) phi(z2),

with (x, y) from the corner, t_k along the edge k and s the blur: two edges, bent by the lens, that cross at
the corner. E is the mean of sign(z1 + e1) sign(z2 + e2) over normal e1 and e2 with the correlation r, as a
series (Pearson, "On the correlation of characters not quantitatively measurable", Phil. Trans. A 195, 1900):
edges that are bent, or not perpendicular, share some of the blur.

Nine unknowns a corner, in a disc around it, by Levenberg and Marquardt, all corners of an image at once. What
interpolates the image instead (``cornerSubPix``) errs by some hundredths of a pixel, by where the corner lies
between the pixels, and bent edges pull it outwards.
"""

import math

import cv2
import numpy as np
from scipy.special import erf

from polhode.files.images import Grey
from polhode.geometry.lie import Array, Bools

MIN_RADIUS_PX, MAX_RADIUS_PX = 3.0, 12.0
MIN_BLUR_PX, MAX_BLUR_PX = 0.25, 4.0
_RING = 64


def fit_corners(image: Grey, uv_px: Array, radius_px: Array) -> Array:
    """Corners (n, 2) fitted in discs of radius (n,); one that cannot be fitted stays where it was."""
    out = uv_px.copy()
    radius = np.clip(radius_px, MIN_RADIUS_PX, MAX_RADIUS_PX)
    half = np.ceil(radius).astype(int)
    height, width = image.shape
    values = image.astype(np.float64)
    for size in np.unique(half).tolist():
        centre = np.round(np.nan_to_num(uv_px, nan=-1.0)).astype(int)
        inside = (centre >= size).all(axis=1) & (centre[:, 0] < width - size) & (centre[:, 1] < height - size)
        part = np.flatnonzero((half == size) & inside & np.isfinite(uv_px).all(axis=1))
        if not len(part):
            continue
        steps = np.arange(-size, size + 1)
        rows = centre[part, 1, None, None] + steps[:, None]
        columns = centre[part, 0, None, None] + steps[None, :]
        patch = values[rows, columns].reshape(len(part), -1)
        u, v = (
            np.broadcast_to(each, (*rows.shape[:1], len(steps), len(steps))).reshape(len(part), -1)
            for each in (columns, rows)
        )
        start, known = _start(image, uv_px[part], radius[part])
        disc = np.hypot(u - uv_px[part, 0, None], v - uv_px[part, 1, None]) <= radius[part, None]
        found, misfit = _fit(patch, u.astype(np.float64), v.astype(np.float64), disc, start)
        moved = np.linalg.norm(found[:, :2] - uv_px[part], axis=1)
        contrast = np.abs(found[:, 7])
        # moved [px] from a start that is known better; contrast in grey levels
        good = known & (moved < 1.0) & (contrast > 6.0) & (misfit < 0.35 * contrast)
        out[part[good]] = found[good, :2]
    return out


def _start(image: Grey, uv_px: Array, radius: Array) -> tuple[Array, Bools]:
    """First values (n, 9), and whether four edges are seen on a ring around the corner."""
    angle = 2.0 * np.pi * np.arange(_RING) / _RING
    at = uv_px[:, None] + 0.75 * radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = cv2.remap(
        image,
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    ring = (ring + np.roll(ring, 1, axis=1) + np.roll(ring, -1, axis=1)) / 3.0
    low, high = np.percentile(ring, [10, 90], axis=1)
    side = ring > 0.5 * (low + high)[:, None]
    change = side != np.roll(side, -1, axis=1)
    known = np.asarray(change.sum(axis=1) == 4)
    out = np.zeros((len(uv_px), 9))
    out[:, :2] = uv_px
    out[:, 6] = 0.8
    out[:, 7], out[:, 8] = 0.5 * (high - low), 0.5 * (high + low)
    for k in np.flatnonzero(known).tolist():
        crossing = angle[np.flatnonzero(change[k])] + np.pi / _RING
        # of an edge both ends, the second one turned back
        first, second = (0.5 * (crossing[i] + crossing[i + 2] - np.pi) for i in (0, 1))
        out[k, 2], out[k, 3] = first + 0.5 * np.pi, second + 0.5 * np.pi
        # between the first and the second edge both distances have opposite signs
        middle = 0.5 * (crossing[0] + crossing[1])
        sign = np.sign(np.cos(middle - out[k, 2]) * np.cos(middle - out[k, 3]))
        bright = ring[k, round(middle / (2.0 * np.pi) * _RING) % _RING] > out[k, 8]
        out[k, 7] *= sign if bright else -sign
    return out, known


def _fit(patch: Array, u: Array, v: Array, disc: Bools, start: Array) -> tuple[Array, Array]:
    """Unknowns (n, 9): corner, angles of the normals, bends, blur, contrast, middle; rms residual (n,)."""
    p = start.copy()
    damping = np.full(len(p), 1e-3)
    weight = disc.astype(np.float64)
    residual, J = _model(patch, u, v, p)
    cost = (weight * residual**2).sum(axis=1)
    for _ in range(25):
        A = np.einsum("nmi,nm,nmj->nij", J, weight, J, optimize=True)
        g = np.einsum("nmi,nm->ni", J, weight * residual, optimize=True)
        diagonal = np.einsum("nii->ni", A)
        A = A + (damping[:, None] * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12)[
            :, :, None
        ] * np.eye(9)
        step = np.linalg.solve(A, g[:, :, None])[:, :, 0]
        trial = p + step
        trial[:, 6] = np.clip(trial[:, 6], MIN_BLUR_PX, MAX_BLUR_PX)
        new_residual, new_J = _model(patch, u, v, trial)
        new_cost = (weight * new_residual**2).sum(axis=1)
        better = new_cost < cost
        p[better], residual[better], J[better] = trial[better], new_residual[better], new_J[better]
        gain = np.where(better, cost - new_cost, 0.0)
        done = (gain <= 1e-6 * cost).all() and better.any()
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, damping / 10.0, damping * 10.0)
        if done or (damping > 1e6).all():
            break
    return p, np.sqrt(cost / weight.sum(axis=1))


def _model(patch: Array, u: Array, v: Array, p: Array) -> tuple[Array, Array]:
    """Residuals (n, m), and derivatives of the model (n, m, 9)."""
    x, y = u - p[:, 0, None], v - p[:, 1, None]
    c, b, s = p[:, 7, None], p[:, 8, None], p[:, 6, None]
    values, densities, parts, curved = [], [], [], []
    for k in (0, 1):
        cos, sin = np.cos(p[:, 2 + k, None]), np.sin(p[:, 2 + k, None])
        along = -x * sin + y * cos
        bend = p[:, 4 + k, None]
        # blur moves a bent edge towards the inside of the bend
        d = x * cos + y * sin + 0.5 * bend * (along**2 + s**2)
        z = d / s
        phi = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        values.append(erf(z / np.sqrt(2.0)))
        densities.append((phi, z * phi, (z**2 - 1.0) * phi, (z**2 - 3.0) * z * phi))
        by_corner = (-cos + bend * along * sin, -sin - bend * along * cos)
        by_angle = along - bend * along * (x * cos + y * sin)
        parts.append((d, by_corner, by_angle, 0.5 * (along**2 + s**2), bend * s))
        # of the correlation: bend times the place along the edge, by the corner and by the bend
        curved.append((bend * along, bend * sin, -bend * cos, along))
    between = (p[:, 2] - p[:, 3])[:, None]
    r = np.cos(between) + np.sin(between) * (curved[1][0] - curved[0][0])
    one, two = densities
    picture = values[0] * values[1]
    first, second = 2.0 * one[0] * values[1], 2.0 * two[0] * values[0]
    by_r = np.zeros_like(picture)
    for n in (1, 2, 3):
        share = 4.0 * r**n / math.factorial(n)
        picture = picture + share * one[n - 1] * two[n - 1]
        first = first - share * one[n] * two[n - 1]
        second = second - share * one[n - 1] * two[n]
        by_r += 4.0 * r ** (n - 1) / math.factorial(n - 1) * one[n - 1] * two[n - 1]
    first, second = first * c / s, second * c / s
    turned = c * by_r * np.sin(between)
    J = np.empty((*patch.shape, 9))
    for axis in (0, 1):
        J[:, :, axis] = first * parts[0][1][axis] + second * parts[1][1][axis]
        J[:, :, axis] += turned * (curved[1][1 + axis] - curved[0][1 + axis])
    J[:, :, 2], J[:, :, 3] = first * parts[0][2] - turned, second * parts[1][2] + turned
    J[:, :, 4] = first * parts[0][3] - turned * curved[0][3]
    J[:, :, 5] = second * parts[1][3] + turned * curved[1][3]
    J[:, :, 6] = sum(
        slope * (part[4] - part[0] / s) for slope, part in zip((first, second), parts, strict=True)
    )
    J[:, :, 7] = picture
    J[:, :, 8] = 1.0
    return patch - b - c * J[:, :, 7], J
