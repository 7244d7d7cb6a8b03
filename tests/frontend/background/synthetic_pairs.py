"""Pairs of a textured disk before a textured plane, drawn without the simulator."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from polhode.frontend.background.far_plane import FarPlane
from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools
from polhode.records.dataset import StereoImages, StereoSequence

HEIGHT, WIDTH = 240, 320
V, U = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
INFINITY, WALL = FarPlane(0.0, 0.0, 0.0), FarPlane(-0.01, 0.015, 12.0)
RIG = RectifiedRig(300.0, 161.0, 118.0, 0.1, WIDTH, HEIGHT, 4.0)


@dataclass
class Drawn:
    """What is read of a ``StereoSequence``: a pair by its number, at poses X_NC (F, 4, 4)."""

    pair: Callable[[int], StereoImages]
    X_NC: Array
    has_ranges: bool = False

    def __len__(self) -> int:
        return len(self.X_NC)

    def read_pair(self, k: int) -> StereoImages:
        return self.pair(k)

    def read_left(self, k: int) -> tuple[Image, Bools | None]:
        return self.pair(k).left, self.pair(k).mask_left


def drawn(pair: Callable[[int], StereoImages], X_NC: Array) -> StereoSequence:
    return cast(StereoSequence, Drawn(pair, X_NC))


def texture(seed: int, mean: float, spread: float, sigma_px: float = 1.5) -> Array:
    """A random pattern (H, 2 W), which can be read at any column."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, 2 * WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    return np.asarray(mean + spread * smooth / smooth.std())


def read_at(texture: Array, u: Array) -> Array:
    at = (u + 0.5 * WIDTH).astype(np.float32)
    return np.asarray(cv2.remap(texture.astype(np.float32), at, V.astype(np.float32), cv2.INTER_CUBIC))


def pair_of(
    plane: FarPlane, far: Array, near: Array, disparity_px: float = 40.0, radius_px: float = 50.0
) -> tuple[Image, Image, Bools, Bools]:
    """A disk before a plane: left and right image and the disk's masks, with noise."""
    disk = [np.hypot(U - 170.0 + d, V - 115.0) < radius_px for d in (0.0, disparity_px)]
    left = np.where(disk[0], read_at(near, U), read_at(far, U))
    behind = (U + plane.b * V + plane.c) / (1.0 - plane.a)
    right = np.where(disk[1], read_at(near, U + disparity_px), read_at(far, behind))
    rng = np.random.default_rng(9)
    images = [cv2.GaussianBlur(i, (0, 0), 0.5) + rng.normal(0.0, 1.0, i.shape) for i in (left, right)]
    first, second = (np.clip(np.round(i), 0, 255).astype(np.uint8) for i in images)
    return first, second, disk[0], disk[1]


def overlap(found: Bools, truth: Bools) -> float:
    """Intersection over union."""
    return float((found & truth).sum() / (found | truth).sum())
