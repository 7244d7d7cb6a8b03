"""The points of one body from several poses, each under several Suns.

    python -m polhode.train.light.lit_points CONFIG [--workers N]

makes those of ``train.light.bodies`` bodies that are missing, in the folder of ``train.corpus``; ``polhode
train`` does the same before training. The bodies and poses are those of the corpus.

The frames of these ``ScenePoints`` are the poses under the first Sun, then under the second, and so on. Two
frames of one pose differ in their light alone: the true place of a point is the same pixel in both.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from polhode.config.loader import load_config
from polhode.config.scene_settings import Product
from polhode.config.train_settings import Corpus, LightStudy
from polhode.files.images import Grey
from polhode.files.output.single_file import remove_all_partials
from polhode.geometry.lie import Ints
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress, Silent
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.frame_renderer import FrameRenderer, Products, render_products
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.sky import Sky
from polhode.train.corpus import (
    begin_corpus,
    random_light,
    random_scene,
    random_sensor,
    required_train,
    scene_seed,
)
from polhode.train.descriptor.surface_points import ScenePoints, points_of_frames, read_points, write_points

VERSION = 1
"""Version of the files; those of another version are not used."""
_PRODUCTS: tuple[Product, ...] = ("depth", "normals", "mask", "shadow")


def prepare_lit_points(
    corpus: Corpus, study: LightStudy, progress: Progress, workers: int
) -> dict[int, ScenePoints]:
    """The points of the bodies, by their numbers in the corpus; missing ones are rendered and stored."""
    if study.bodies == 0:
        return {}
    begin_corpus(corpus)
    remove_all_partials(lit_points_path(corpus, study, 0).parent)
    missing = [i for i in range(study.bodies) if not lit_points_path(corpus, study, i).is_file()]
    if missing:
        title = f"rendering bodies under several Suns ({study.bodies - len(missing)} were there)"
        with progress.stage(title, len(missing)) as advance:
            for _ in in_order(_make, [(corpus, study, i) for i in missing], workers):
                advance()
    return {i: read_points(lit_points_path(corpus, study, i))[0] for i in range(study.bodies)}


def lit_points_path(corpus: Corpus, study: LightStudy, index: int) -> Path:
    """File of one body's points: its name contains what ``corpus.yaml`` does not state."""
    name = f"{index:04d}-v{VERSION}-{study.poses}x{study.suns}.npz"
    return Path(corpus.folder) / "lit_points" / name


def pose_of(points: ScenePoints, study: LightStudy) -> Ints:
    """Number of the pose of each frame (F,)."""
    return np.arange(len(points.grey)) % study.poses


def sun_of(points: ScenePoints, study: LightStudy) -> Ints:
    """Number of the Sun of each frame (F,)."""
    return np.arange(len(points.grey)) // study.poses


def _make(work: tuple[Corpus, LightStudy, int]) -> None:
    corpus, study, index = work
    text = f"{corpus.model_dump_json()} {study.model_dump_json()} {index}"
    digest = sha256(text.encode()).hexdigest()
    write_points(lit_points_path(corpus, study, index), find_lit_points(corpus, study, index), digest)


def find_lit_points(corpus: Corpus, study: LightStudy, index: int) -> ScenePoints:
    """Render body ``index`` and find its points, which depend on the settings and the index alone."""
    scene = random_scene(corpus.model_copy(update={"frames": max(study.poses, 3)}), index)
    plan = plan_sequence(scene, scene_seed(corpus, index))
    renderer = Renderer(plan.body, plan.scene, plan.seed)
    views = [view_of(plan, k, 0) for k in range(study.poses)]
    grey, truths = list[Grey](), list[Products]()
    for sun in range(study.suns):
        lit = under_sun(plan, corpus, index, sun)
        under = renderer.under(lit.scene.light)
        frames = FrameRenderer(lit, under)
        for k, view in enumerate(views):
            grey.append(np.asarray(frames.render_image(k, 0)[0], dtype=np.uint8))
            X_NK = plan.X_NC[k] @ view.camera.X_CK
            truths.append(render_products(under, view.camera, X_NK, plan.target.X_NG[k], _PRODUCTS))
    return points_of_frames(renderer.caster, views * study.suns, np.stack(grey), truths)


def under_sun(plan: SequencePlan, corpus: Corpus, index: int, sun: int) -> SequencePlan:
    """The plan with lights and an exposure of its own."""
    rng = np.random.default_rng([corpus.seed, 0x50, index, sun])
    scene = plan.scene.model_copy(
        update={"light": random_light(corpus, rng), "sensor": random_sensor(corpus, rng)}
    )
    return replace(plan, scene=scene, sky=Sky(scene, plan.seed + sun), seed=plan.seed + sun)


def main(arguments: Sequence[str] | None = None) -> None:
    """Render the bodies of a configuration under several Suns."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.train.light.lit_points", description=main.__doc__
    )
    parser.add_argument("config", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    try:
        train = required_train(load_config(options.config).train, options.config)
        prepare_lit_points(train.corpus, train.light, Silent(), options.workers)
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    print(f"{train.light.bodies} bodies: {train.corpus.folder}")


if __name__ == "__main__":
    main()
