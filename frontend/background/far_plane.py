"""The plane of the background, as a disparity that is linear in the image, and as a plane in N.

A plane m . p = 1 in the rectified left camera has the disparity f b m . (x, y, 1) beyond that of infinity,
where x and y are the coordinates of the ray at depth 1. At infinity m = 0: stars, Earth and clouds.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]
REACH = 0.4
"""Largest disparity that is searched for, beyond that of infinity, as a share of the image's width."""
WORKING_PX = 160
"""Width of the images in which the plane is looked for; near enough for a first guess."""
INLIER_PX = 0.75
MIN_MATCHES = 80
TRIALS = 60
BLOCK_PX = 5


@dataclass(frozen=True)
class FarPlane:
    """Disparity a u + b v + c [px] of the background at column u and row v of the left image."""

    a: float
    b: float
    c: float

    def at(self, width: int, height: int) -> Floats:
        """Disparity (H, W) at every pixel."""
        v, u = np.mgrid[:height, :width]
        return np.asarray(self.a * u + self.b * v + self.c, dtype=np.float32)

    def corners(self, width: int, height: int) -> Array:
        """Disparity (4,) at the corners of an image."""
        return np.array(
            [self.a * u + self.b * v + self.c for v in (0.0, height - 1.0) for u in (0.0, width - 1.0)]
        )

    def reduced(self, scale: int) -> "FarPlane":
        """The same in images whose pixels are the means of scale x scale pixels."""
        half = 0.5 * (scale - 1)
        return FarPlane(self.a, self.b, (self.c + (self.a + self.b) * half) / scale)

    def enlarged(self, scale: int) -> "FarPlane":
        """The opposite of ``reduced``."""
        half = 0.5 * (scale - 1)
        return FarPlane(self.a, self.b, self.c * scale - (self.a + self.b) * half)


def plane_in_N(plane: FarPlane, rig: RectifiedRig, X_NR: Array) -> Array:
    """m (3,) of the plane m . p_N = 1, of the disparity seen from X_NR (4, 4)."""
    scale = rig.focal_px * rig.baseline_m
    m_x, m_y = plane.a * rig.focal_px / scale, plane.b * rig.focal_px / scale
    beyond = plane.c - rig.disparity_offset_px
    m_z = (beyond + plane.a * rig.cx_px + plane.b * rig.cy_px) / scale
    m = X_NR[:3, :3] @ np.array([m_x, m_y, m_z])
    return np.asarray(m / (1.0 + m @ X_NR[:3, 3]))


def plane_seen_from(m_N: Array, rig: RectifiedRig, X_NR: Array) -> FarPlane:
    """The disparity of a plane m . p_N = 1 from X_NR (4, 4); m = 0: infinity."""
    m = X_NR[:3, :3].T @ m_N / (1.0 - m_N @ X_NR[:3, 3])
    scale = rig.focal_px * rig.baseline_m
    a, b = scale * m[0] / rig.focal_px, scale * m[1] / rig.focal_px
    c = rig.disparity_offset_px + scale * m[2] - a * rig.cx_px - b * rig.cy_px
    return FarPlane(float(a), float(b), float(c))


def reduced_image(image: Image, scale: int) -> Image:
    """The means of scale x scale pixels."""
    if scale == 1:
        return image
    height, width = image.shape
    part = image[: height - height % scale, : width - width % scale]
    size = (width // scale, height // scale)
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def semi_global(left: Image, right: Image, least: int, count: int) -> Floats:
    """Disparity (H, W) of the left image from ``least`` on, among at least ``count``; NaN: none.

    Hirschmueller's semi-global matching along three directions, by OpenCV.
    """
    count = 16 * -(-count // 16)
    before, after = count + max(least, 0), max(-least, 0) + 8
    wide = [cv2.copyMakeBorder(i, 0, 0, before, after, cv2.BORDER_REPLICATE) for i in (left, right)]
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=40 * BLOCK_PX**2,
        disp12MaxDiff=-1,
        preFilterCap=31,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    found = np.asarray(matcher.compute(*wide), dtype=np.float32)[:, before : before + left.shape[1]] / 16.0
    return np.where(found >= least, found, np.nan).astype(np.float32)


def both_ways(left: Image, right: Image, least: int, count: int) -> tuple[Floats, Floats]:
    """Disparities (H, W) of the left image, and of the right one, whose match is at u + d."""
    mirrored = semi_global(
        np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]), least, count
    )
    return semi_global(left, right, least, count), mirrored[:, ::-1]


def agreeing(left: Floats, right: Floats, tolerance_px: float = 1.0) -> Bools:
    """Pixels of the left image (H, W) whose match has the same disparity."""
    columns = np.arange(left.shape[1]) - np.round(np.nan_to_num(left)).astype(np.int64)
    inside = (columns >= 0) & (columns < left.shape[1]) & np.isfinite(left)
    back = np.take_along_axis(right, np.clip(columns, 0, left.shape[1] - 1), axis=1)
    return np.asarray(inside & (np.abs(left - back) <= tolerance_px))


def reduced_seen(seen: Bools, scale: int) -> Bools:
    """Pixels (h, w) of a reduced image of which the camera shows all, and those around them."""
    whole = reduced_image(seen.astype(np.uint8) * np.uint8(255), scale) == 255
    return np.asarray(cv2.erode(whole.astype(np.uint8), np.ones((3, 3)), borderValue=1) > 0)


def border_ring(seen: Bools) -> Bools:
    """The border (h, w), of what a camera shows, in which the background is looked for."""
    # width of the border in which the background is looked for, as a share of the smaller side
    size = 2 * max(2, round(0.12 * min(seen.shape))) + 1
    inner = cv2.erode(
        seen.astype(np.uint8), np.ones((size, size)), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return np.asarray(seen & (inner == 0))


def matched_inside(disparity: Floats, seen: Bools, seen_right: Bools, margin_px: int = BLOCK_PX) -> Bools:
    """Pixels (h, w) whose match lies in what both cameras show, not at the edge of that."""
    kernel = np.ones((2 * margin_px + 1, 2 * margin_px + 1))
    left, right = (cv2.erode(each.astype(np.uint8), kernel, borderValue=1) > 0 for each in (seen, seen_right))
    columns = np.arange(disparity.shape[1]) - np.round(np.nan_to_num(disparity)).astype(np.int64)
    inside = (columns >= 0) & (columns < disparity.shape[1]) & np.isfinite(disparity)
    there = np.take_along_axis(right, np.clip(columns, 0, disparity.shape[1] - 1), axis=1)
    return np.asarray(left & inside & there)


def textured(image: Image) -> Bools:
    """Pixels (H, W) with a gradient along the rows."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    # grey levels per pixel along the rows, below which a match says little
    return np.asarray(np.abs(cv2.Scharr(smooth, cv2.CV_32F, 1, 0)) / 32.0 > 1.0)


def plane_of_most(A: Array, d: Array, allowed: Array | float, known: Array, lead: float = 1.0) -> Array:
    """The plane (3,) through three of the points A @ plane = d (n,) that has most within the ``allowed``
    distance (RANSAC); the ``known`` one unless another has ``lead`` times as many."""
    random = np.random.default_rng(0)
    best, most = known, lead * float(np.count_nonzero(np.abs(A @ known - d) < allowed))
    for _ in range(TRIALS):
        chosen = random.choice(len(d), 3, replace=False)
        if abs(np.linalg.det(A[chosen])) < 1.0:
            continue
        plane = np.asarray(np.linalg.solve(A[chosen], d[chosen]), dtype=np.float64)
        count = np.count_nonzero(np.abs(A @ plane - d) < allowed)
        if count > most:
            best, most = plane, float(count)
    return best


@dataclass(frozen=True)
class BorderMatches:
    """Matches along the border of a rectified pair, at the size in which the plane is looked for."""

    place_px: Array
    """(n, 3) columns, rows, ones"""
    disparity_px: Array
    """(n,)"""
    infinity_px: float
    """The disparity of infinity"""
    scale: int
    """Pixels of the pair for one of this size"""

    @property
    def share_at_infinity(self) -> float:
        """Of the matches; a target's surface has none, whatever it fills."""
        if len(self.disparity_px) < MIN_MATCHES:
            return 0.0
        return float(np.mean(np.abs(self.disparity_px - self.infinity_px) < INLIER_PX))


def border_matches(
    left: Image, right: Image, offset_px: float, seen: tuple[Bools, Bools] | None = None
) -> BorderMatches:
    """The matches of a rectified pair (H, W) in whose plane the background is looked for.

    offset_px: disparity at infinity; seen (H, W): what each camera shows; None: all.
    """
    scale = max(1, round(left.shape[1] / WORKING_PX))
    small = [reduced_image(image, scale) for image in (left, right)]
    width = small[0].shape[1]
    least = int(np.floor(offset_px / scale)) - 2
    there, back = both_ways(small[0], small[1], least, int(REACH * width) + 2)
    whole = np.ones(left.shape, dtype=bool)
    shown, shown_right = (reduced_seen(each, scale) for each in (seen or (whole, whole)))
    good = agreeing(there, back) & matched_inside(there, shown, shown_right)
    v, u = np.nonzero(good & border_ring(shown) & textured(small[0]))
    A = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64)
    return BorderMatches(A, there[v, u].astype(np.float64), offset_px / scale, scale)


def find_far_plane(matches: BorderMatches) -> FarPlane | None:
    """The plane of most matches; None: there is none.

    That at infinity is taken if it explains nearly as many matches as another.
    """
    A, d = matches.place_px, matches.disparity_px
    if len(d) < MIN_MATCHES:
        return None
    infinity = np.array([0.0, 0.0, matches.infinity_px])
    best = plane_of_most(A, d, INLIER_PX, infinity, 1.05)
    infinite = best is infinity
    inlier = np.abs(A @ best - d) < INLIER_PX
    if inlier.mean() < 0.5:
        return None
    if not infinite:
        for _ in range(3):
            best = np.asarray(np.linalg.lstsq(A[inlier], d[inlier])[0], dtype=np.float64)
            inlier = np.abs(A @ best - d) < INLIER_PX
    return FarPlane(float(best[0]), float(best[1]), float(best[2])).enlarged(matches.scale)
