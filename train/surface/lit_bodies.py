"""Images of one body from several poses, each under several Suns, with the truth of their pixels.

Bodies and poses are those of the corpus. Images come pose by pose under the first Sun, then under the second,
and so on. Two images of one pose differ in their light, exposure and noise alone. Two images under one Sun
show a body that turns while the Sun stands still: there the light's own marks move over the surface as they
do in a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.files.images import Grey
from polhode.frontend.rectification import Crop, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.frame_renderer import CAST_SHADOW as CAST_SHADOW
from polhode.simulation.dataset.frame_renderer import FACING_AWAY as FACING_AWAY
from polhode.simulation.dataset.frame_renderer import FrameRenderer, render_products
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.light import lights_in_body
from polhode.simulation.rendering.reflection import reflected
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.sky import Sky
from polhode.train.corpus import random_light, random_scene, random_sensor, scene_seed
from polhode.train.stored import array

VERSION = 1
"""Version of the files; those of another version are not used."""
LIT, HIGHLIGHT, SKY = 0, 3, 4
"""Kinds of light on a pixel, besides ``CAST_SHADOW`` and ``FACING_AWAY``: sunlight; more of it mirrored than
scattered; no target."""


@dataclass(frozen=True)
class LitBody:
    """Parts (h, w) of the images of one body with the target: P poses, each under S Suns, V = S P."""

    grey: Grey = array("u", 3)
    """(V, h, w) left images, pose by pose under each Sun"""
    light: NDArray[np.uint8] = array("u", 3)
    """(V, h, w) kind of light on each pixel"""
    depth_m: NDArray[np.float32] = array("f", 3)
    """(P, h, w) along the optical axis; NaN off the target"""
    normal_K: NDArray[np.float16] = array("f", 4)
    """(P, h, w, 3) unit, towards the camera; NaN off the target"""
    corner_px: Ints = array("iu", 2)
    """(P, 2) first pixel (u, v) of each part in the whole image"""
    X_KG: Array = array("f", 3)
    """(P, 4, 4) body in the left camera"""
    focal_px: Array = array("f", 0)
    """()"""
    centre_px: Array = array("f", 1)
    """(2,) principal point in the whole image"""

    @property
    def poses(self) -> int:
        """Number of poses."""
        return len(self.depth_m)

    def pose_of(self, view: int) -> int:
        """Pose of an image."""
        return view % self.poses

    def sun_of(self, view: int) -> int:
        """Sun of an image."""
        return view // self.poses

    def X_between(self, pose_a: int, pose_b: int) -> Array:
        """(4, 4) points in the camera of pose b to points in that of pose a, on the body."""
        return np.asarray(self.X_KG[pose_a] @ inverse_pose(self.X_KG[pose_b]))

    def rig(self, pose: int) -> RectifiedRig:
        """The left camera, with pixels counted in the part of a pose; the baseline has no meaning."""
        height, width = self.depth_m.shape[1:]
        u, v = self.centre_px - self.corner_px[pose]
        return RectifiedRig(float(self.focal_px), float(u), float(v), 1.0, int(width), int(height))

    def on_target(self, pose: int) -> Bools:
        """Pixels (h, w) of a pose that show the target."""
        return np.asarray(np.isfinite(self.depth_m[pose]))


def lit_body_path(corpus: Corpus, config: SurfaceTraining, index: int) -> Path:
    """File of one body: its name contains what ``corpus.yaml`` does not state."""
    return Path(corpus.folder) / "lit_bodies" / f"{index:04d}-v{VERSION}-{config.poses}x{config.suns}.npz"


def render_lit_body(corpus: Corpus, config: SurfaceTraining, index: int) -> LitBody:
    """All images of body ``index``, which depend on the settings and the number alone."""
    scene = random_scene(corpus.model_copy(update={"frames": max(config.poses, 3)}), index)
    plan = plan_sequence(scene, scene_seed(corpus, index))
    renderer = Renderer(plan.body, plan.scene, plan.seed)
    left, poses = plan.cameras[0], range(config.poses)
    X_NK = [plan.X_NC[k] @ left.X_CK for k in poses]
    crops, depths, normals = list[Crop](), list[NDArray[Any]](), list[NDArray[Any]]()
    for k in poses:
        truth = render_products(renderer, left, X_NK[k], plan.target.X_NG[k], ("depth", "normals", "mask"))
        assert truth.mask is not None and truth.depth is not None and truth.normals is not None
        v, u = truth.mask.shape[0] // 2, truth.mask.shape[1] // 2
        # a target out of view leaves the middle of the image
        # width of the sky around the target that is kept [px]
        crop = target_crop(truth.mask, 16) or Crop(u - 32, v - 32, u + 32, v + 32)
        crops.append(crop)
        depths.append(np.asarray(truth.depth, np.float32)[_part(crop)])
        normals.append(np.asarray(truth.normals, np.float16)[_part(crop)])
    grey, light = list[NDArray[Any]](), list[NDArray[Any]]()
    for sun in range(config.suns):
        lit = under_sun(plan, corpus, index, sun)
        under = renderer.under(lit.scene.light)
        frames = FrameRenderer(lit, under)
        for k, crop in enumerate(crops):
            grey.append(np.asarray(frames.render_image(k, 0)[0])[_part(crop)])
            light.append(_kinds_of_light(under, plan, X_NK[k], k)[_part(crop)])
    return LitBody(
        grey=_stacked(grey, 0),
        light=_stacked(light, SKY),
        depth_m=_stacked(depths, np.nan),
        normal_K=_stacked(normals, np.nan),
        corner_px=np.array([(crop.u0, crop.v0) for crop in crops]),
        X_KG=np.stack([inverse_pose(view_of(plan, k, 0).X_GK) for k in poses]),
        focal_px=np.array(float(left.K[0, 0])),
        centre_px=np.asarray(left.K[:2, 2], np.float64),
    )


def under_sun(plan: SequencePlan, corpus: Corpus, index: int, sun: int) -> SequencePlan:
    """The plan with lights and an exposure of its own."""
    rng = np.random.default_rng([corpus.seed, 0x50, index, sun])
    scene = plan.scene.model_copy(
        update={"light": random_light(corpus, rng), "sensor": random_sensor(corpus, rng)}
    )
    return replace(plan, scene=scene, sky=Sky(scene, plan.seed + sun), seed=plan.seed + sun)


def _part(crop: Crop) -> tuple[slice, slice]:
    return np.s_[crop.v0 : crop.v1, crop.u0 : crop.u1]


def _kinds_of_light(renderer: Renderer, plan: SequencePlan, X_NK: Array, k: int) -> NDArray[np.uint8]:
    """Kind of light (H, W) on each pixel of pose k, under the renderer's light."""
    X_NG, camera = plan.target.X_NG[k], plan.cameras[0]
    truth = render_products(renderer, camera, X_NK, X_NG, ("mask", "shadow"))
    assert truth.mask is not None and truth.shadow is not None
    kind = np.where(truth.mask, truth.shadow, SKY).astype(np.uint8)
    X_GK = inverse_pose(X_NG) @ X_NK
    rays_G = camera.pixel_directions @ X_GK[:3, :3].T
    hits = renderer.caster.first_hits(X_GK[:3, 3], rays_G)
    surface = renderer.appearance.at(hits)
    sun_G = lights_in_body(renderer.light, inverse_pose(X_NG), X_GK).sun_direction_G
    toward, viewer = np.broadcast_to(sun_G, rays_G[hits.ray].shape), -rays_G[hits.ray]
    none = np.zeros_like(surface.albedo)
    lobe = surface.roughness**4
    mirrored = reflected(surface.normal_G, toward, viewer, none, surface.specular, lobe)
    scattered = reflected(surface.normal_G, toward, viewer, surface.albedo, none, lobe)
    flat = kind.reshape(-1)
    bright = hits.ray[mirrored > scattered]
    flat[bright[flat[bright] == LIT]] = HIGHLIGHT
    return kind


def _stacked(parts: Sequence[NDArray[Any]], beside: float) -> NDArray[Any]:
    """Parts of different sizes in one array, filled up at the right and below."""
    height, width = (max(part.shape[axis] for part in parts) for axis in (0, 1))
    whole = np.full((len(parts), height, width, *parts[0].shape[2:]), beside, parts[0].dtype)
    for each, part in zip(whole, parts, strict=True):
        each[: part.shape[0], : part.shape[1]] = part
    return whole
