"""Images of one body from several poses, each under several Suns, with the truth of their pixels.

Bodies and poses are those of the corpus. ``polhode train`` and ``known_bodies`` render the missing ones of
``train.surface.bodies``, in the folder of ``train.corpus``.

Images come pose by pose under the first Sun, then under the second, and so on. Two images of one pose differ
in their light, exposure and noise alone. Two images under one Sun show a body that turns while the Sun stands
still: there the light's own marks move over the surface as they do in a run.

With ``train.surface.albedos`` each shape is rendered with several albedos, from the same poses under the same
Suns: textures, contrast and material differ. The first albedo is that of the corpus, and its files do not
depend on how many there are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.config.scene_settings import Product
from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced
from polhode.files.images import Grey
from polhode.files.output.single_file import remove_all_partials
from polhode.frontend.rectification import Crop, target_crop
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.frame_renderer import CAST_SHADOW as CAST_SHADOW
from polhode.simulation.dataset.frame_renderer import FACING_AWAY as FACING_AWAY
from polhode.simulation.dataset.frame_renderer import FrameRenderer, Products, render_products
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.light import lights_in_body
from polhode.simulation.rendering.reflection import reflected
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera
from polhode.train.corpus import (
    FIRST_BODY_SEED,
    begin_corpus,
    random_scene,
    random_skin,
    scene_seed,
)
from polhode.train.light.lit_points import under_sun

VERSION = 1
"""Version of the files; those of another version are not used."""
LIT, HIGHLIGHT, SKY = 0, 3, 4
"""Kinds of light on a pixel, besides ``CAST_SHADOW`` and ``FACING_AWAY``: sunlight; more of it mirrored than
scattered; no target."""
MARGIN_PX = 16
"""Width of the sky around the target that is kept [px]."""
NEXT_NOISE = 10**15
"""Added to the seed of the noise for each further albedo."""
_PRODUCTS: tuple[Product, ...] = ("depth", "normals", "mask", "shadow")


@dataclass(frozen=True)
class LitBody:
    """Parts (h, w) of the images of one body with the target: P poses, each under S Suns, V = S P."""

    grey: Grey
    """(V, h, w) left images, pose by pose under each Sun"""
    light: NDArray[np.uint8]
    """(V, h, w) kind of light on each pixel"""
    depth_m: NDArray[np.float32]
    """(P, h, w) along the optical axis; NaN off the target"""
    normal_K: NDArray[np.float16]
    """(P, h, w, 3) unit, towards the camera; NaN off the target"""
    right: Grey
    """(P, h, w) right images under the first Sun: the same rows, moved left by ``shift_px``"""
    shift_px: Ints
    """(P,) disparity of the target's middle"""
    corner_px: Ints
    """(P, 2) first pixel (u, v) of each part in the whole image"""
    X_KG: Array
    """(P, 4, 4) body in the left camera"""
    focal_px: Array
    """()"""
    centre_px: Array
    """(2,) principal point in the whole image"""
    baseline_m: Array
    """()"""

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

    def centre_of_part_px(self, pose: int) -> Array:
        """(2,) principal point in the part of a pose."""
        return np.asarray(self.centre_px - self.corner_px[pose])


_DIMENSIONS = {
    "grey": ("u", 3),
    "light": ("u", 3),
    "depth_m": ("f", 3),
    "normal_K": ("f", 4),
    "right": ("u", 3),
    "shift_px": ("iu", 1),
    "corner_px": ("iu", 2),
    "X_KG": ("f", 3),
    "focal_px": ("f", 0),
    "centre_px": ("f", 1),
    "baseline_m": ("f", 0),
}
"""Kind of dtype and number of dimensions of each field of LitBody."""


def render_lit_bodies(
    corpus: Corpus, config: SurfaceTraining, progress: Progress, workers: int, bodies: Sequence[int]
) -> None:
    """Render those of the bodies, by their numbers in the corpus, that are missing, with all their albedos.

    Raises InputError as ``begin_corpus``; RunFailure: a process was killed.
    """
    begin_corpus(corpus)
    remove_all_partials(lit_body_path(corpus, config, 0).parent)
    wanted = [(i, albedo) for i in bodies for albedo in range(config.albedos)]
    missing = [each for each in wanted if not lit_body_path(corpus, config, *each).is_file()]
    if missing:
        title = f"rendering bodies under several Suns ({len(wanted) - len(missing)} were there)"
        with progress.stage(title, len(missing)) as advance:
            for _ in in_order(_make, [(corpus, config, *each) for each in missing], workers):
                advance()


def lit_body_path(corpus: Corpus, config: SurfaceTraining, index: int, albedo: int = 0) -> Path:
    """File of one body with one albedo: its name contains what ``corpus.yaml`` does not state."""
    further = f"-a{albedo}" if albedo else ""
    name = f"{index:04d}-v{VERSION}-{config.poses}x{config.suns}{further}.npz"
    return Path(corpus.folder) / "lit_bodies" / name


def read_lit_body(path: Path) -> LitBody:
    """Read what ``write_lit_body`` wrote. Raises InputError for anything else."""
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, _DIMENSIONS)
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return LitBody(**{name: arrays[name] for name in _DIMENSIONS})


def write_lit_body(path: Path, body: LitBody) -> None:
    """Write the whole file or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {each.name: getattr(body, each.name) for each in fields(body)}
    with replaced(path) as partial:
        np.savez_compressed(partial, **arrays)


def _make(work: tuple[Corpus, SurfaceTraining, int, int]) -> None:
    path = lit_body_path(*work)
    write_lit_body(path, render_lit_body(*work))


def render_lit_body(corpus: Corpus, config: SurfaceTraining, index: int, albedo: int = 0) -> LitBody:
    """All images of body ``index`` with one albedo, which depend on the settings and the numbers alone."""
    scene = random_scene(corpus.model_copy(update={"frames": max(config.poses, 3)}), index)
    plan = _with_albedo(plan_sequence(scene, scene_seed(corpus, index)), corpus, index, albedo)
    renderer = Renderer(plan.body, plan.scene, plan.seed)
    left = plan.cameras[0]
    truths = [_truth(renderer, left, plan, k) for k in range(config.poses)]
    crops = [_part(truth) for truth in truths]
    focal_px = float(left.K[0, 0])
    depths = [np.asarray(truth.depth, np.float32) for truth in truths]
    shift = [round(focal_px * scene.rig.baseline_m / float(np.nanmedian(depth))) for depth in depths]
    grey, light, right = list[Grey](), list[NDArray[np.uint8]](), list[Grey]()
    for sun in range(config.suns):
        lit = under_sun(plan, corpus, index, sun)
        under = renderer.under(lit.scene.light)
        frames = FrameRenderer(lit, under)
        for k, crop in enumerate(crops):
            grey.append(_cut(frames.render_image(k, 0)[0], crop, 0))
            light.append(_cut(_kinds_of_light(truths[k], under, left, plan, k), crop, 0, SKY))
            if sun == 0:
                right.append(_cut(frames.render_image(k, 1)[0], crop, shift[k]))
    normals = [np.asarray(truth.normals, np.float16) for truth in truths]
    return LitBody(
        grey=_stacked(grey, 0),
        light=_stacked(light, SKY),
        depth_m=_stacked([_cut(each, crop, 0) for each, crop in zip(depths, crops, strict=True)], np.nan),
        normal_K=_stacked([_cut(each, crop, 0) for each, crop in zip(normals, crops, strict=True)], np.nan),
        right=_stacked(right, 0),
        shift_px=np.array(shift),
        corner_px=np.array([(crop.u0, crop.v0) for crop in crops]),
        X_KG=np.stack([inverse_pose(view_of(plan, k, 0).X_GK) for k in range(config.poses)]),
        focal_px=np.array(focal_px),
        centre_px=np.asarray(left.K[:2, 2], np.float64),
        baseline_m=np.array(scene.rig.baseline_m),
    )


def _with_albedo(plan: SequencePlan, corpus: Corpus, index: int, albedo: int) -> SequencePlan:
    """The plan with another albedo of its body: textures, contrast and material, and noise of its own.

    Poses stay, also where the other material would move the centre of mass.
    """
    if albedo == 0:
        return plan
    rng = np.random.default_rng([corpus.seed, 0xA1BED0, index, albedo])
    body = plan.scene.body.model_copy(
        update={
            "texture_seed": FIRST_BODY_SEED + int(rng.integers(10**9)),
            **random_skin(corpus, index, rng),
        }
    )
    return replace(
        plan,
        body=build_body(body, plan.seed),
        scene=plan.scene.model_copy(update={"body": body}),
        seed=plan.seed + albedo * NEXT_NOISE,
    )


def _truth(renderer: Renderer, camera: Camera, plan: SequencePlan, k: int) -> Products:
    X_NK = plan.X_NC[k] @ camera.X_CK
    return render_products(renderer, camera, X_NK, plan.target.X_NG[k], ("depth", "normals", "mask"))


def _part(truth: Products) -> Crop:
    """The part of the image with the target; its middle if the target is out of view."""
    assert truth.mask is not None
    crop = target_crop(truth.mask, MARGIN_PX)
    if crop is None:
        height, width = truth.mask.shape
        return Crop(width // 2 - 32, height // 2 - 32, width // 2 + 32, height // 2 + 32)
    return crop


def _kinds_of_light(
    truth: Products, renderer: Renderer, camera: Camera, plan: SequencePlan, k: int
) -> NDArray[np.uint8]:
    """Kind of light (H, W) on each pixel of pose k, under the renderer's light."""
    X_NK, X_NG = plan.X_NC[k] @ camera.X_CK, plan.target.X_NG[k]
    shadow = render_products(renderer, camera, X_NK, X_NG, ("shadow",)).shadow
    assert truth.mask is not None
    assert shadow is not None
    kind = np.where(truth.mask, shadow, SKY).astype(np.uint8)
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


def _cut(image: NDArray[Any], crop: Crop, shift_px: int, beside: int = 0) -> NDArray[Any]:
    """The crop of an image (H, W, ...), moved left by ``shift_px``; ``beside`` where it leaves the image."""
    rows = image[crop.v0 : crop.v1]
    part = np.full((rows.shape[0], crop.u1 - crop.u0, *image.shape[2:]), beside, image.dtype)
    first, last = max(crop.u0 - shift_px, 0), min(crop.u1 - shift_px, image.shape[1])
    if last > first:
        at = first - (crop.u0 - shift_px)
        part[:, at : at + last - first] = rows[:, first:last]
    return part


def _stacked(parts: Sequence[NDArray[Any]], beside: float) -> NDArray[Any]:
    """Parts of different sizes in one array, filled up at the right and below."""
    height, width = (max(part.shape[axis] for part in parts) for axis in (0, 1))
    whole = np.full((len(parts), height, width, *parts[0].shape[2:]), beside, parts[0].dtype)
    for each, part in zip(whole, parts, strict=True):
        each[: part.shape[0], : part.shape[1]] = part
    return whole


def on_target(body: LitBody, pose: int) -> Bools:
    """Pixels (h, w) of a pose that show the target."""
    return np.asarray(np.isfinite(body.depth_m[pose]))
