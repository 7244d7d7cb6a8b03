"""One body from several poses, each under several Suns: what of an image is surface, and what is light.

    python -m polhode.train.surface.lit_views CONFIG [--workers N]

makes the missing ones in the folder of ``train.corpus``; ``polhode train`` does the same before training.

Every image has the candidates that a run would detect in it. By rays to the body their true places in all
other images are known, and so whether the candidate there with the most similar descriptor is the right one,
and by how much its place is off. Two images of one pose differ in their light alone: there the true place is
the same pixel, and what is off is the drift with the light.
"""

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.array_files import read_arrays, require_arrays
from polhode.atomic import replaced
from polhode.camera import RectifiedRig
from polhode.config.frontend_settings import Features
from polhode.config.loader import load_config
from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.errors import InputError, RunFailure
from polhode.frontend.features.keypoints import find_candidates
from polhode.frontend.features.patch_descriptors import describe, descriptor_network
from polhode.frontend.features.patches import cut_patches, tangent_affines
from polhode.frontend.features.stereo import texture_sigma
from polhode.frontend.rectification import target_crop
from polhode.images import Grey
from polhode.lie import Array, inverse_pose
from polhode.output.single_file import remove_all_partials
from polhode.processes import in_order
from polhode.progress import Progress, Silent
from polhode.records import Ints
from polhode.simulation.dataset.correspondence import CameraView, correspond, view_of
from polhode.simulation.dataset.frame_renderer import FrameRenderer, Products, render_products
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.light import lights_in_body
from polhode.simulation.rendering.reflection import reflected
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.sky import Sky
from polhode.simulation.stereo_camera import Camera
from polhode.train.corpus import (
    begin_corpus,
    random_light,
    random_scene,
    random_sensor,
    required_train,
    scene_seed,
)
from polhode.train.descriptor.batches import perturbed_normals

VERSION = 1
"""Version of the files; those of another version are not used."""
RIGHT_PX = 3.0
"""Largest distance of the most similar candidate from the true place [px], if it is the right one: edges of
shadows drift this far."""
PATCH_HALF_PX = 12.0
"""Half the side of the patches at the median depth of their image [px]."""
NORMAL_NOISE_DEG = 8.0
"""Error of the normals, rms, as in a run [deg]."""
LIT, CAST_SHADOW, FACING_AWAY, HIGHLIGHT, SKY = range(5)
"""Kinds of light on a pixel: Sun, another part in the way, turned from the Sun, more mirrored than diffuse
sunlight; no target."""


@dataclass(frozen=True)
class LitViews:
    """V images of one body, N candidates in them, and M sightings of these in other images."""

    grey: Grey
    """(V, H, W) parts with the target, filled up with zeros"""
    corner_px: Ints
    """(V, 2) first pixel of each part in the whole image"""
    light: NDArray[np.uint8]
    """(V, H, W) kind of light on each pixel"""
    pose: Ints
    """(V,) number of the pose: images of one pose differ in their light alone"""
    view: Ints
    """(N,) image of each candidate"""
    uv_px: Array
    """(N, 2) in the part"""
    scale_px: Array
    """(N,)"""
    cosine: Array
    """(N,) between the surface's normal, known as in a run, and the ray"""
    sigma_ls_px: Array
    """(N,) as ``texture_sigma``"""
    point: Ints
    """(M,) candidate whose surface another image shows in sunlight"""
    other: Ints
    """(M,) the other image"""
    match: Ints
    """(M,) candidate there with the most similar descriptor, -1: it is a wrong one"""
    off_px: Array
    """(M, 2) its place less the true one; 0 where it is wrong"""
    angle_rad: Array
    """(M,) between the two views, at the point"""


_DIMENSIONS = {
    "grey": ("u", 3),
    "corner_px": ("iu", 2),
    "light": ("u", 3),
    "pose": ("iu", 1),
    "view": ("iu", 1),
    "uv_px": ("f", 2),
    "scale_px": ("f", 1),
    "cosine": ("f", 1),
    "sigma_ls_px": ("f", 1),
    "point": ("iu", 1),
    "other": ("iu", 1),
    "match": ("iu", 1),
    "off_px": ("f", 2),
    "angle_rad": ("f", 1),
}
"""Kind of dtype and number of dimensions of each field of LitViews."""


def prepare_views(
    corpus: Corpus, config: SurfaceTraining, progress: Progress, workers: int
) -> dict[int, LitViews]:
    """The views of all bodies of the corpus, by their numbers; missing ones are rendered and stored."""
    begin_corpus(corpus)
    remove_all_partials(views_path(corpus, config, 0).parent)
    missing = [i for i in range(corpus.scenes) if not views_path(corpus, config, i).is_file()]
    if missing:
        title = f"rendering bodies under several Suns ({corpus.scenes - len(missing)} were there)"
        with progress.stage(title, len(missing)) as advance:
            for _ in in_order(_make, [(corpus, config, i) for i in missing], workers):
                advance()
    return {i: read_views(views_path(corpus, config, i)) for i in range(corpus.scenes)}


def views_path(corpus: Corpus, config: SurfaceTraining, index: int) -> Path:
    """File of one body's views: its name contains all that the corpus does not state."""
    kind = f"v{VERSION}-{config.poses}x{config.suns}-{config.max_points}"
    return Path(corpus.folder) / "lit_views" / f"{index:04d}-{kind}.npz"


def read_views(path: Path) -> LitViews:
    """Read what ``write_views`` wrote. Raises InputError for anything else."""
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, _DIMENSIONS)
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return LitViews(**{name: arrays[name] for name in _DIMENSIONS})


def write_views(path: Path, views: LitViews) -> None:
    """Write the whole file or nothing, numbers in single precision."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {each.name: getattr(views, each.name) for each in fields(views)}
    narrow = {
        name: value.astype({"f": np.float32, "i": np.int32}.get(value.dtype.kind, value.dtype))
        for name, value in arrays.items()
    }
    with replaced(path) as partial:
        np.savez_compressed(partial, **narrow)


def _make(work: tuple[Corpus, SurfaceTraining, int]) -> None:
    corpus, config, index = work
    write_views(views_path(corpus, config, index), render_views(corpus, config, index))


@dataclass(frozen=True)
class _Image:
    """One image with its candidates."""

    grey: Grey
    light: NDArray[np.uint8]
    pose: int
    uv_px: Array
    scale_px: Array
    cosine: Array
    sigma_ls_px: Array
    descriptors: NDArray[np.float32]


def render_views(corpus: Corpus, config: SurfaceTraining, index: int) -> LitViews:
    """All images of body ``index``, which depend only on the settings and on it."""
    scene = random_scene(corpus.model_copy(update={"frames": max(config.poses, 3)}), index)
    plan = plan_sequence(scene, scene_seed(corpus, index))
    renderer = Renderer(plan.body, plan.scene, plan.seed)
    views = [view_of(plan, k, 0) for k in range(config.poses)]
    images = []
    for sun in range(config.suns):
        lit = _under_sun(plan, corpus, index, sun)
        under = renderer.under(lit.scene.light)
        for k in range(config.poses):
            rng = np.random.default_rng([plan.seed, 0x5E, sun, k])
            images.append(_image(lit, FrameRenderer(lit, under), under, k, config.max_points, rng))
    seen = list(_sightings(renderer, views, images))
    start = np.cumsum([0, *(len(image.uv_px) for image in images)])
    grey, light, corner = _parts(images)
    own = np.concatenate([np.full(len(image.uv_px), k) for k, image in enumerate(images)])
    return LitViews(
        grey=grey,
        corner_px=corner,
        light=light,
        pose=np.array([image.pose for image in images]),
        view=own,
        uv_px=np.concatenate([image.uv_px for image in images]) - corner[own],
        scale_px=np.concatenate([image.scale_px for image in images]),
        cosine=np.concatenate([image.cosine for image in images]),
        sigma_ls_px=np.concatenate([image.sigma_ls_px for image in images]),
        point=np.concatenate([each.row + start[each.a] for each in seen]),
        other=np.concatenate([np.full(len(each.row), each.b) for each in seen]),
        match=np.concatenate([np.where(each.match >= 0, each.match + start[each.b], -1) for each in seen]),
        off_px=np.concatenate([each.off_px for each in seen]),
        angle_rad=np.concatenate([each.angle_rad for each in seen]),
    )


def _under_sun(plan: SequencePlan, corpus: Corpus, index: int, sun: int) -> SequencePlan:
    """The plan with other lights and another exposure."""
    rng = np.random.default_rng([corpus.seed, 0x50, index, sun])
    scene = plan.scene.model_copy(
        update={"light": random_light(corpus, rng), "sensor": random_sensor(corpus, rng)}
    )
    return replace(plan, scene=scene, sky=Sky(scene, plan.seed + sun), seed=plan.seed + sun)


def _image(
    plan: SequencePlan,
    frames: FrameRenderer,
    renderer: Renderer,
    k: int,
    max_points: int,
    rng: np.random.Generator,
) -> _Image:
    """Frame k of the left camera under the plan's light."""
    camera = plan.cameras[0]
    X_NK, X_NG = plan.X_NC[k] @ camera.X_CK, plan.target.X_NG[k]
    grey = np.asarray(frames.render_image(k, 0)[0], dtype=np.uint8)
    truth = render_products(renderer, camera, X_NK, X_NG, ("depth", "normals", "mask", "shadow"))
    assert truth.mask is not None
    assert truth.depth is not None
    assert truth.normals is not None
    found = find_candidates(grey, truth.mask, Features(max_features=max_points))
    row = np.clip(np.round(found.uv_px[:, 1]).astype(int), 0, grey.shape[0] - 1)
    column = np.clip(np.round(found.uv_px[:, 0]).astype(int), 0, grey.shape[1] - 1)
    known = np.isfinite(truth.depth[row, column])
    uv, row, column = found.uv_px[known], row[known], column[known]
    rays = camera.directions(uv) if len(uv) else np.zeros((0, 3))
    p_K = rays / rays[:, 2:] * truth.depth[row, column][:, None]
    normal_K = perturbed_normals(truth.normals[row, column], np.deg2rad(NORMAL_NOISE_DEG), rng)
    return _Image(
        grey=grey,
        light=_light_on_pixels(truth, renderer, camera, X_NK, X_NG),
        pose=k,
        uv_px=uv,
        scale_px=found.scale_px[known],
        cosine=np.abs(np.einsum("nk,nk->n", rays, normal_K)),
        sigma_ls_px=texture_sigma(grey, uv),
        descriptors=_descriptors(grey, uv, p_K, normal_K, camera),
    )


def _descriptors(
    grey: Grey, uv_px: Array, p_K: Array, normal_K: Array, camera: Camera
) -> NDArray[np.float32]:
    """Descriptors (n, d) of the shipped network at points, cut as in a run."""
    rig = RectifiedRig(camera.K[0, 0], camera.K[0, 2], camera.K[1, 2], 1.0, camera.width_px, camera.height_px)
    middle_m = float(np.median(p_K[:, 2])) if len(p_K) else 1.0
    half_m = np.full(len(p_K), PATCH_HALF_PX * middle_m / rig.focal_px)
    patches = cut_patches(grey, uv_px, tangent_affines(p_K, normal_K, rig, half_m))
    return describe(descriptor_network(), patches).descriptors


def _light_on_pixels(
    truth: Products, renderer: Renderer, camera: Camera, X_NK: Array, X_NG: Array
) -> NDArray[np.uint8]:
    """Kind of light (H, W) on each pixel."""
    assert truth.mask is not None
    assert truth.shadow is not None
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
    diffuse = reflected(surface.normal_G, toward, viewer, surface.albedo, none, lobe)
    flat = kind.reshape(-1)
    bright = hits.ray[mirrored > diffuse]
    flat[bright[flat[bright] == LIT]] = HIGHLIGHT
    return kind


@dataclass(frozen=True)
class _Sightings:
    """Candidates of image a whose surface image b shows in sunlight."""

    a: int
    b: int
    row: Ints
    match: Ints
    off_px: Array
    angle_rad: Array


def _sightings(
    renderer: Renderer, views: Sequence[CameraView], images: Sequence[_Image]
) -> Iterator[_Sightings]:
    """All ordered pairs of images."""
    for a, image in enumerate(images):
        if not len(image.uv_px):
            continue
        for pose, view in enumerate(views):
            found = correspond(renderer.caster, views[image.pose], view, image.uv_px)
            same = pose == image.pose
            uv = image.uv_px if same else found.uv_b_px
            visible = np.isfinite(found.p_G).all(axis=1) & (found.visible | same)
            for b, other in enumerate(images):
                if b == a or other.pose != pose or not len(other.uv_px):
                    continue
                pixel = np.round(uv[visible]).astype(int)
                lit = np.isin(other.light[pixel[:, 1], pixel[:, 0]], (LIT, HIGHLIGHT))
                row = np.flatnonzero(visible)[lit]
                best = (image.descriptors[row] @ other.descriptors.T).argmax(axis=1)
                off = other.uv_px[best] - uv[row]
                right = np.linalg.norm(off, axis=1) < RIGHT_PX
                match, off = np.where(right, best, -1), np.where(right[:, None], off, 0.0)
                yield _Sightings(a, b, row, match, off, found.angle_rad[row])


def _parts(images: Sequence[_Image]) -> tuple[Grey, NDArray[np.uint8], Ints]:
    """The parts of the images with the target (V, h, w), their kinds of light, and their corners (V, 2)."""
    crops = [target_crop(image.light != SKY) for image in images]
    width = max((crop.width_px for crop in crops if crop), default=1)
    height = max((crop.height_px for crop in crops if crop), default=1)
    grey = np.zeros((len(images), height, width), np.uint8)
    light = np.full(grey.shape, SKY, np.uint8)
    corner = np.zeros((len(images), 2), np.int64)
    for k, (image, crop) in enumerate(zip(images, crops, strict=True)):
        if crop is not None:
            rows, columns = slice(crop.v0, crop.v1), slice(crop.u0, crop.u1)
            grey[k, : crop.height_px, : crop.width_px] = image.grey[rows, columns]
            light[k, : crop.height_px, : crop.width_px] = image.light[rows, columns]
            corner[k] = crop.u0, crop.v0
    return grey, light, corner


def main(arguments: Sequence[str] | None = None) -> None:
    """Render the bodies of a configuration under several Suns."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.train.surface.lit_views", description=main.__doc__
    )
    parser.add_argument("config", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    try:
        train = required_train(load_config(options.config).train, options.config)
        prepare_views(train.corpus, train.surface, Silent(), options.workers)
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    print(f"{train.corpus.scenes} bodies: {train.corpus.folder}")


if __name__ == "__main__":
    main()
