"""Rendering the pairs of a plan, in this process or in several."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polhode.dataset_writer import image_path, mask_path, write_png
from polhode.lie import Array
from polhode.processes import in_order
from polhode.progress import Advance
from polhode.simulation.camera.cameras import sample_times
from polhode.simulation.camera.sensor import Image, expose
from polhode.simulation.dataset.plan import SequencePlan
from polhode.simulation.dataset.products import products_path, render_products, write_products
from polhode.simulation.dataset.staging import StagedDataset
from polhode.simulation.rendering.render import RenderedLight, Renderer


class FrameRenderer:
    """Renders images and stereo pairs of a plan."""

    def __init__(self, plan: SequencePlan) -> None:
        self._plan = plan
        self._renderer = Renderer(plan.body, plan.scene, plan.seed)

    def render_image(self, k: int, index: int) -> tuple[Image, RenderedLight]:
        """Frame k of camera ``index`` (0: left) as the sensor gives it, and the light before the lens."""
        plan, camera = self._plan, self._plan.cameras[index]
        X_NC, X_NG = self._poses(k)
        X_NK, t_s = X_NC @ camera.X_CK, plan.time_s(k)
        picture = self._renderer.picture(camera, X_NK, X_NG, t_s)
        level, stars = plan.sky.background(picture, camera, X_NK, t_s)
        noise = np.random.default_rng([plan.seed, 0x2, k, index])
        return expose(level, plan.scene.sensor, noise, stars), picture

    def write_pair(self, k: int, mav0: Path) -> None:
        """Write frame k into a folder laid out as mav0: both images; masks and products on request."""
        plan, asked = self._plan, self._plan.scene.render
        stamp = int(plan.target.timestamps_ns[k])
        for index, camera in enumerate(plan.cameras):
            image, picture = self.render_image(k, index)
            write_png(image_path(mav0 / f"cam{index}", stamp), image)
            if asked.masks:
                write_png(mask_path(mav0, index, stamp), picture.covered >= 0.5)
            if asked.products:
                X_NK = plan.X_NC[k] @ camera.X_CK
                products = render_products(self._renderer, camera, X_NK, plan.target.X_NG[k], asked.products)
                write_products(products_path(mav0, index, stamp), products)

    def _poses(self, k: int) -> tuple[Array, Array]:
        """X_NC and X_NG at frame k; with an exposure time (S, 4, 4), one for each sample of a pixel."""
        plan = self._plan
        exposure_s = 1e-3 * plan.scene.sensor.exposure_ms
        if exposure_s == 0:
            return plan.X_NC[k], plan.target.X_NG[k]
        offsets_s = exposure_s * sample_times(plan.scene.render.samples)
        return plan.inspector.poses_during(k, offsets_s), plan.target.poses_during(k, offsets_s)


def render_frames(
    plan: SequencePlan, staged: StagedDataset, frames: Sequence[int], workers: int, advance: Advance
) -> None:
    """Render the frames into the staged dataset and call ``advance`` after each.

    The bytes do not depend on the number of workers. Raises RunFailure when a worker is killed.
    """
    for _ in in_order(_RenderFrame(plan, staged), frames, workers):
        advance()


class _RenderFrame:
    """Renders frames of a plan into its staged dataset; each process makes a renderer at its first frame."""

    def __init__(self, plan: SequencePlan, staged: StagedDataset) -> None:
        self._plan, self._staged = plan, staged
        self._renderer: FrameRenderer | None = None

    def __call__(self, k: int) -> None:
        if self._renderer is None:
            self._renderer = FrameRenderer(self._plan)
        with self._staged.frame(k) as mav0:
            self._renderer.write_pair(k, mav0)
