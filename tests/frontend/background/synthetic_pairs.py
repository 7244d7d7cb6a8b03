"""Pairs of a textured disk before a textured plane, drawn without the simulator."""

import cv2
import numpy as np

from polhode.frontend.background.far_plane import FarPlane
from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools

HEIGHT, WIDTH = 240, 320
INFINITY = FarPlane(0.0, 0.0, 0.0)
WALL = FarPlane(-0.01, 0.015, 12.0)
RIG = RectifiedRig(
    focal_px=300.0,
    cx_px=161.0,
    cy_px=118.0,
    baseline_m=0.1,
    width_px=WIDTH,
    height_px=HEIGHT,
    disparity_offset_px=4.0,
)


def texture(seed: int, mean: float, spread: float, sigma_px: float = 1.5) -> Array:
    """A random pattern (H, 2 W), which can be read at any column."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, 2 * WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    return np.asarray(mean + spread * smooth / smooth.std())


def read_at(texture: Array, u: Array) -> Array:
    v = np.mgrid[:HEIGHT, :WIDTH][0].astype(np.float32)
    at = (u + 0.5 * WIDTH).astype(np.float32)
    return np.asarray(cv2.remap(texture.astype(np.float32), at, v, cv2.INTER_CUBIC))


def pair_of(
    plane: FarPlane, far: Array, near: Array, disparity_px: float = 40.0, radius_px: float = 50.0
) -> tuple[Image, Image, Bools, Bools]:
    """A disk before a plane: left and right image and the disk's masks, with noise."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    disk = [np.hypot(u - 170.0 + d, v - 115.0) < radius_px for d in (0.0, disparity_px)]
    left = np.where(disk[0], read_at(near, u), read_at(far, u))
    behind = (u + plane.b * v + plane.c) / (1.0 - plane.a)
    right = np.where(disk[1], read_at(near, u + disparity_px), read_at(far, behind))
    rng = np.random.default_rng(9)
    images = [
        np.clip(np.round(cv2.GaussianBlur(i, (0, 0), 0.5) + rng.normal(0.0, 1.0, i.shape)), 0, 255)
        for i in (left, right)
    ]
    return images[0].astype(np.uint8), images[1].astype(np.uint8), disk[0], disk[1]


def overlap(found: Bools, truth: Bools) -> float:
    """Intersection over union."""
    return float((found & truth).sum() / (found | truth).sum())
