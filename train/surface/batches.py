"""Batches of the surface network: some images of a few bodies, their points, and what became of these
elsewhere."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from polhode.config.train_settings import SurfaceTraining
from polhode.frontend.networks.surface import STRIDE_PX, known_of_points
from polhode.images import Grey
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.train.surface.lit_views import SKY, LitViews
from polhode.train.task import Batch

MAX_ANGLE_DEG = 70.0
"""Largest angle between the two views of a sighting that counts [deg]."""
GAIN = (0.6, 1.5)
"""Factor on the grey values of an image, least and most."""
READ_NOISE_DN = 2.0
"""Largest standard deviation of added noise [DN]."""


def outcomes(views: LitViews) -> tuple[Ints, Ints]:
    """Of each point (N,): in how many other images it is lit, and in how many of them it is found."""
    counted = views.angle_rad < np.deg2rad(MAX_ANGLE_DEG)
    point, found = views.point[counted], views.match[counted] >= 0
    count = len(views.view)
    return np.bincount(point, minlength=count), np.bincount(point[found], minlength=count)


@dataclass(frozen=True)
class _Window:
    """A part of a stored image, mirrored and turned by quarters."""

    image: int
    corner_px: tuple[int, int]
    size_px: tuple[int, int]
    """Height and width, before it is turned"""
    quarters: int
    mirrored: bool

    def cut(self, stored: Grey) -> Grey:
        (u, v), (height, width) = self.corner_px, self.size_px
        part = np.rot90(stored[self.image, v : v + height, u : u + width], self.quarters)
        return np.ascontiguousarray(part[:, ::-1] if self.mirrored else part)

    def place(self, uv_px: Array) -> tuple[Array, Bools]:
        """Points (n, 2) of the stored image in the window, and whether they are inside."""
        height, width = self.size_px
        u, v = (uv_px - self.corner_px).T
        inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
        for _ in range(self.quarters):
            u, v = v, width - 1 - u
            height, width = width, height
        return np.column_stack([width - 1 - u if self.mirrored else u, v]), inside


class ViewBatches:
    """Draws the batch of each step."""

    def __init__(self, bodies: Mapping[int, LitViews], config: SurfaceTraining, seed: int) -> None:
        self._bodies, self._config, self._seed = bodies, config, seed
        self._drawable = [i for i, views in bodies.items() if (views.match >= 0).any()]

    @property
    def is_empty(self) -> bool:
        """Whether nothing is found again anywhere."""
        return not self._drawable

    def batch(self, step: int) -> Batch:
        """``images`` (b, 1, s, s), several of each body; ``light`` (b, s / 2, s / 2): kinds of light, SKY off
        the target.

        Points (n,): ``owner`` image, ``uv`` (n, 2) [px], ``known`` (n, 3), ``seen`` and ``found`` in how many
        other images. Matches (m,) between images of the batch: ``first`` and ``second`` points, ``square``:
        squared distance of the place from the true one, both axes [px^2].
        """
        rng = np.random.default_rng([self._seed, 0x5F, step])
        parts, images, points = [], 0, 0
        for _ in range(self._config.bodies):
            views = self._bodies[self._drawable[rng.integers(len(self._drawable))]]
            part = self._of_body(views, rng)
            parts.append(
                part
                | {"owner": part["owner"] + images}
                | {name: part[name] + points for name in ("first", "second")}
            )
            images, points = images + len(part["images"]), points + len(part["owner"])
        return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}

    def _of_body(self, views: LitViews, rng: np.random.Generator) -> Batch:
        """The part of a batch that one body contributes."""
        chosen = rng.permutation(len(views.grey))[: self._config.images]
        side = self._config.crop_px
        images = np.zeros((len(chosen), 1, side, side), np.float32)
        light = np.full((len(chosen), side, side), SKY, np.uint8)
        number = np.full(len(views.view), -1)
        owner, uv, count = list[Ints](), list[Array](), 0
        for k, image in enumerate(chosen):
            window = _draw_window(views, int(image), side, rng)
            grey, kind = window.cut(views.grey), window.cut(views.light)
            height, width = grey.shape
            images[k, 0, :height, :width] = _exposed(grey, rng)
            light[k, :height, :width] = kind
            points = np.flatnonzero(views.view == image)
            place, inside = window.place(views.uv_px[points])
            owner.append(np.full(int(inside.sum()), k))
            uv.append(place[inside])
            number[points[inside]] = count + np.arange(len(owner[-1]))
            count += len(owner[-1])
        points = np.flatnonzero(number >= 0)
        points = points[np.argsort(number[points])]
        seen, found = (each[points] for each in outcomes(views))
        both = (views.match >= 0) & (number[views.point] >= 0) & (number[views.match] >= 0)
        both &= views.angle_rad < np.deg2rad(MAX_ANGLE_DEG)
        return {
            "images": torch.from_numpy(images),
            "light": torch.from_numpy(light[:, ::2, ::2].astype(np.int64)),
            "owner": torch.from_numpy(np.concatenate(owner)),
            "uv": torch.from_numpy(np.concatenate(uv).astype(np.float32)),
            "known": known_of(views, points),
            "seen": torch.from_numpy(seen.astype(np.float32)),
            "found": torch.from_numpy(found.astype(np.float32)),
            "first": torch.from_numpy(number[views.point[both]]),
            "second": torch.from_numpy(number[views.match[both]]),
            "square": torch.from_numpy(np.sum(views.off_px[both] ** 2, axis=1).astype(np.float32)),
        }


def known_of(views: LitViews, points: Ints) -> torch.Tensor:
    """What is known of points (n, 3) besides their image."""
    parts = (views.scale_px[points], views.cosine[points], views.sigma_ls_px[points])
    return known_of_points(*(torch.from_numpy(each.astype(np.float32)) for each in parts))


def padded(grey: Grey) -> Grey:
    """Images (V, H, W) filled up with zeros to sides that the network takes."""
    height, width = grey.shape[1:]
    return np.pad(grey, ((0, 0), (0, -height % STRIDE_PX), (0, -width % STRIDE_PX)))


def _draw_window(views: LitViews, image: int, side: int, rng: np.random.Generator) -> _Window:
    height, width = views.grey.shape[1:]
    v, u = (int(rng.integers(max(size - side, 0) + 1)) for size in (height, width))
    size = min(height, side), min(width, side)
    return _Window(image, (u, v), size, int(rng.integers(4)), bool(rng.integers(2)))


def _exposed(grey: Grey, rng: np.random.Generator) -> Array:
    """The image (H, W) with another gain and more noise; black remains black, as off the target."""
    gain, noise = rng.uniform(*GAIN), rng.uniform(0.0, READ_NOISE_DN)
    level = grey * gain + noise * rng.standard_normal(grey.shape)
    return np.clip(np.where(grey > 0, level, 0.0), 0.0, 255.0)
