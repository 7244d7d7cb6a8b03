"""Rendering of the pairs of a plan, and the truth of every pixel: depth, normals, masks, shadow, albedo.

For the truth, one ray is cast through the centre of each pixel, distortion included, at the time of the
timestamp: neither motion nor the lens blurs it. Off the target, numbers are NaN.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polhode.config.scene_settings import Product
from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced
from polhode.geometry.lie import Array, Bools, inverse_pose
from polhode.records.dataset_writer import image_path, mask_path, write_png
from polhode.records.range_images import RANGE_FOLDER
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Advance
from polhode.simulation.dataset.plan import SequencePlan
from polhode.simulation.dataset.range_images import render_ranges
from polhode.simulation.dataset.resumable_dataset import StagedDataset
from polhode.simulation.rendering.render import RenderedLight, Renderer
from polhode.simulation.stereo_camera import Camera, Image, expose, sample_times


class FrameRenderer:
    """Renders images and stereo pairs of a plan."""

    def __init__(self, plan: SequencePlan, renderer: Renderer | None = None) -> None:
        """``renderer``: of the plan's body and light, if there is one already."""
        self._plan, self._given = plan, renderer

    @cached_property
    def _renderer(self) -> Renderer:
        """Built at the first frame, in the process that renders it."""
        return self._given or Renderer(self._plan.body, self._plan.scene, self._plan.seed)

    def render_image(self, k: int, index: int) -> tuple[Image, RenderedLight]:
        """Frame k of camera ``index`` (0: left) as the sensor gives it, and the light before the lens."""
        plan, camera = self._plan, self._plan.cameras[index]
        X_NC, X_NG, t_s = plan.X_NC[k], plan.target.X_NG[k], plan.time_s(k)
        exposure_s = 1e-3 * plan.scene.sensor.exposure_ms
        if exposure_s > 0:
            # (S, 4, 4), one for each sample of a pixel.
            offsets_s = exposure_s * sample_times(plan.scene.render.samples)
            X_NC = plan.inspector.poses_during(k, offsets_s)
            X_NG = plan.target.poses_during(k, offsets_s)
        X_NK = X_NC @ camera.X_CK
        picture = self._renderer.picture(camera, X_NK, X_NG, t_s)
        level, stars = plan.sky.background(picture, camera, X_NK, t_s)
        noise = np.random.default_rng([plan.seed, 0x2, k, index])
        return expose(level, plan.scene.sensor, noise, stars), picture

    def render_range(self, k: int) -> NDArray[np.uint16]:
        """Range image of frame k as stored, of a scene with a range sensor."""
        plan, sensor = self._plan, self._plan.scene.ranges
        assert sensor is not None
        camera, rng = plan.cameras[0], np.random.default_rng([plan.seed, 0x4, k])
        X_NK = plan.X_NC[k] @ camera.X_CK
        X_GK = inverse_pose(plan.target.X_NG[k]) @ X_NK
        behind = None if plan.sky.wall is None else plan.sky.wall.depth(camera, X_NK)
        return render_ranges(self._renderer.caster, camera, X_GK, sensor, rng, behind)

    def write_pair(self, k: int, mav0: Path) -> None:
        """Write frame k into a folder laid out as mav0: both images, or one and its ranges; masks and
        products on request."""
        plan, asked = self._plan, self._plan.scene.render
        stamp = int(plan.target.timestamps_ns[k])
        if plan.scene.ranges is not None:
            write_png(image_path(mav0 / RANGE_FOLDER, stamp), self.render_range(k))
        for index, camera in enumerate(plan.recording_cameras):
            image, picture = self.render_image(k, index)
            write_png(image_path(mav0 / f"cam{index}", stamp), image)
            if asked.masks:
                write_png(mask_path(mav0, index, stamp), picture.covered >= 0.5)
            if asked.products:
                X_NK = plan.X_NC[k] @ camera.X_CK
                products = render_products(self._renderer, camera, X_NK, plan.target.X_NG[k], asked.products)
                write_products(products_path(mav0, index, stamp), products)


def render_frames(
    plan: SequencePlan, staged: StagedDataset, frames: Sequence[int], workers: int, advance: Advance
) -> None:
    """Render the frames into the staged dataset and call ``advance`` after each.

    The bytes do not depend on the number of workers. Raises RunFailure when a worker is killed.
    """
    for _ in in_order(partial(_render_frame, FrameRenderer(plan), staged), frames, workers):
        advance()


def _render_frame(renderer: FrameRenderer, staged: StagedDataset, k: int) -> None:
    with staged.frame(k) as mav0:
        renderer.write_pair(k, mav0)


T = TypeVar("T", bound=np.generic)

_PRODUCTS = {"depth": ("f", 2), "normals": ("f", 3), "mask": ("b", 2), "shadow": ("u", 2), "albedo": ("f", 2)}
"""Kind of dtype and number of dimensions of each."""
CAST_SHADOW, FACING_AWAY = 1, 2
"""Values of the shadow mask: another part blocks the Sun; the surface faces away from it."""


@dataclass(frozen=True)
class Products:
    """Truth of one image (H, W); what was not requested is None."""

    depth: Array | None = None
    """(H, W) along the optical axis [m]"""
    normals: Array | None = None
    """(H, W, 3) unit, in the camera's axes, towards the camera: of the mesh's faces, as the depth"""
    mask: Bools | None = None
    """(H, W) the target"""
    shadow: NDArray[np.uint8] | None = None
    """(H, W) 1: another part blocks the Sun's centre; 2: facing away from it; 0: lit, or off the target.
    Only shadows of the body itself: independent of eclipses"""
    albedo: Array | None = None
    """(H, W) diffuse reflectance"""


def render_products(
    renderer: Renderer, camera: Camera, X_NK: Array, X_NG: Array, names: Iterable[Product]
) -> Products:
    """The products ``names`` of a camera at X_NK (4, 4) and the target at X_NG (4, 4)."""
    asked = set(names)
    X_GN = inverse_pose(X_NG)
    X_GK = X_GN @ X_NK
    hits = renderer.caster.first_hits(X_GK[:3, 3], camera.pixel_directions @ X_GK[:3, :3].T)
    sun_N = np.array(renderer.light.sun_direction_N)
    sun_G = X_GN[:3, :3] @ (sun_N / np.linalg.norm(sun_N))

    def image(values: NDArray[T], beside: float) -> NDArray[T]:
        """Values (n, ...) at the hits -> (H, W, ...)."""
        flat = np.full((camera.height_px * camera.width_px, *values.shape[1:]), beside, values.dtype)
        flat[hits.ray] = values
        return flat.reshape(camera.height_px, camera.width_px, *values.shape[1:])

    made: dict[str, Any] = {}
    if "depth" in asked:
        made["depth"] = image(hits.distance_m * camera.pixel_directions[hits.ray, 2], np.nan)
    if "normals" in asked:
        made["normals"] = image(hits.flat_normal_G @ X_GK[:3, :3], np.nan)
    if "mask" in asked:
        made["mask"] = image(np.ones(len(hits.ray), np.bool_), False)
    if "shadow" in asked:
        lit = np.where(renderer.caster.lit(hits, sun_G), 0, CAST_SHADOW)
        made["shadow"] = image(np.where(hits.normal_G @ sun_G <= 0, FACING_AWAY, lit).astype(np.uint8), 0)
    if "albedo" in asked:
        made["albedo"] = image(renderer.appearance.at(hits).albedo, np.nan)
    return Products(**made)


def products_path(mav0: Path, camera_index: int, timestamp_ns: int) -> Path:
    """File of one image's products, camera_index 0 (left) or 1 (right)."""
    return mav0 / f"truth{camera_index}" / f"{timestamp_ns}.npz"


def write_products(path: Path, products: Products) -> None:
    """Write the products compressed, numbers as float32; the file is complete or absent."""
    arrays = {name: getattr(products, name) for name in _PRODUCTS}
    narrow = {
        name: values.astype(np.float32) if values.dtype == np.float64 else values
        for name, values in arrays.items()
        if values is not None
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as partial:
        np.savez_compressed(partial, **narrow)


def read_products(path: Path) -> Products:
    """Read a file of ``write_products``. Raises InputError if it is missing or damaged."""
    try:
        stored = read_arrays(path)
        arrays: dict[str, Any] = {name: stored[name] for name in _PRODUCTS if name in stored}
        require_arrays(path, arrays, {name: _PRODUCTS[name] for name in arrays})
    except InputError as error:
        raise InputError(
            f"no truth of pixels: {str(error).partition(': give')[0]}; simulate with scene.render.products"
        ) from None
    if len({values.shape[:2] for values in arrays.values()}) > 1:
        raise InputError(f"{path}: the truth of pixels has several sizes; simulate again")
    wide = {name: v.astype(np.float64) if v.dtype == np.float32 else v for name, v in arrays.items()}
    return Products(**wide)
