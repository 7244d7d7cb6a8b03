"""The points of one body from several poses, each under several Suns.

The frames of these ``ScenePoints`` are the poses of the corpus under the first Sun, then under the second,
and so on. Two frames of one pose differ in their light alone: the true place of a point is the same pixel in
both.
"""

from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np

from polhode.config.train_settings import Corpus, LightStudy
from polhode.files.images import Grey
from polhode.files.output.single_file import remove_all_partials
from polhode.runtime.progress import Progress
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.frame_renderer import FrameRenderer, Products, render_products
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.sky import Sky
from polhode.train.corpus import begin_corpus, random_light, random_scene, random_sensor, scene_seed
from polhode.train.descriptor.surface_points import TRUTHS, ScenePoints, points_of_frames
from polhode.train.stored import make_missing, read_record, write_record

VERSION = 1
"""Version of the files; those of another version are not used."""


def prepare_lit_points(
    corpus: Corpus, study: LightStudy, progress: Progress, workers: int
) -> dict[int, ScenePoints]:
    """The points of the bodies, by their numbers in the corpus; missing ones are rendered and stored."""
    if study.bodies == 0:
        return {}
    begin_corpus(corpus)
    paths = {i: lit_points_path(corpus, study, i) for i in range(study.bodies)}
    remove_all_partials(paths[0].parent)
    make = partial(_make, corpus, study)
    make_missing("rendering bodies under several Suns", make, paths, progress, workers)
    return {i: read_record(path, ScenePoints)[0] for i, path in paths.items()}


def lit_points_path(corpus: Corpus, study: LightStudy, index: int) -> Path:
    """File of one body's points: its name contains what ``corpus.yaml`` does not state."""
    name = f"{index:04d}-v{VERSION}-{study.poses}x{study.suns}.npz"
    return Path(corpus.folder) / "lit_points" / name


def _make(corpus: Corpus, study: LightStudy, index: int) -> None:
    """Render a body and find its points, which depend on the settings and the index alone."""
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
            truths.append(render_products(under, view.camera, X_NK, plan.target.X_NG[k], TRUTHS))
    points = points_of_frames(renderer.caster, views * study.suns, np.stack(grey), truths)
    text = f"{corpus.model_dump_json()} {study.model_dump_json()} {index}"
    write_record(lit_points_path(corpus, study, index), points, sha256(text.encode()).hexdigest())


def under_sun(plan: SequencePlan, corpus: Corpus, index: int, sun: int) -> SequencePlan:
    """The plan with lights and an exposure of its own."""
    rng = np.random.default_rng([corpus.seed, 0x50, index, sun])
    scene = plan.scene.model_copy(
        update={"light": random_light(corpus, rng), "sensor": random_sensor(corpus, rng)}
    )
    return replace(plan, scene=scene, sky=Sky(scene, plan.seed + sun), seed=plan.seed + sun)
