"""The training corpus: many short simulated sequences with ground truth for each pixel, stored like any
sequence.

``polhode train`` renders the missing scenes in the folder of ``train.corpus``. Folder ``0007`` is scene 7;
``corpus.yaml`` contains the settings from which the scenes were drawn.
"""

from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from polhode.config.scene_settings import Background, Light, Motion, Render, Rig, Scene, Sensor, TargetBody
from polhode.config.train_settings import Corpus
from polhode.files.atomic import write_text
from polhode.files.output.locks import occupied
from polhode.files.output.place import folder_place, require_writable
from polhode.files.yaml_files import read_yaml
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress, Silent
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.sequence import SCENE_FILE, simulate
from polhode.train.stored import make_missing

MATERIALS = {
    "asteroid": ("regolith",),
    "cubesat": ("paint", "solar_cell", "metal", "foil"),
}
"""Materials that may cover a whole body of a family; other families use ``ANY_MATERIAL``."""
ANY_MATERIAL = ("paint", "foil", "solar_cell", "metal")
FIRST_BODY_SEED = 1000
"""Scene i shows the body of this seed plus i; smaller seeds are left to the tests."""
NOTE = "corpus.yaml"
FREE_KEYS = {"folder", "scenes", "validation_every"}
"""Settings on which no scene depends: they may change without rendering the scenes again."""


def random_scene(corpus: Corpus, index: int) -> Scene:
    """Scene ``index``, counted from 0. The body is built to measure its size."""
    rng = np.random.default_rng([corpus.seed, 0xC0, index])
    family = corpus.families[index % len(corpus.families)]
    choices = MATERIALS.get(family, ANY_MATERIAL)
    material = choices[rng.integers(len(choices))] if rng.random() < corpus.other_material else "automatic"
    body = TargetBody.model_validate({
        "family": family,
        "size_m": _uniform(rng, corpus.size_m),
        "seed": FIRST_BODY_SEED + index,
        "material": material,
        "texture": corpus.texture,
        "contrast": _logarithmic(rng, corpus.contrast),
    })  # fmt: skip
    rig = Rig()
    radius_m = _radius_m(body)
    depth_m = 2.0 * radius_m * rig.focal_px / _uniform(rng, corpus.span_px)
    baseline_m = _logarithmic(rng, corpus.disparity_px) * depth_m / rig.focal_px
    reach_m = depth_m / rig.focal_px * np.array([rig.width_px, rig.height_px]) / 2.0 - radius_m
    # largest distance between the centres of body and image, as a share of the free space beside the body
    offset_m = rng.uniform(-1.0, 1.0, 2) * np.maximum(reach_m, 0.0) * 0.5
    attitude_deg = _direction(rng) * rng.uniform(0.0, 180.0)
    spin_rpm = _direction(rng) * _uniform(rng, corpus.turn_deg) * (1.0 / 6.0)  # deg/s to RPM
    return Scene(
        frames=corpus.frames,
        interval_s=1.0,
        truth_horizon_s=0.0,
        body=body,
        motion=Motion(
            position_m=(float(offset_m[0]), float(offset_m[1]), depth_m),
            attitude_deg=_three(attitude_deg),
            spin_rpm=_three(spin_rpm),
        ),
        rig=rig.model_copy(update={"baseline_m": baseline_m}),
        light=random_light(corpus, rng),
        background=Background(
            stars=bool(rng.random() < corpus.stars), earth=bool(rng.random() < corpus.earth_behind)
        ),
        sensor=random_sensor(corpus, rng),
        render=Render(products=("depth", "normals", "mask", "shadow"), scattered=corpus.scattered),
    )


def _radius_m(body: TargetBody) -> float:
    """Radius of the sphere about the centroid of the body's surface that contains most of its area [m]."""
    mesh = build_body(body, 0).mesh
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    centres = corners.mean(axis=1)
    distance_m = np.linalg.norm(centres - np.average(centres, axis=0, weights=area), axis=1)
    order = np.argsort(distance_m)
    share = np.cumsum(area[order]) / area.sum()
    # share of the surface inside the body's nominal sphere: thin antennas may extend beyond it
    return float(distance_m[order][np.searchsorted(share, 0.95)])


def random_light(corpus: Corpus, rng: np.random.Generator) -> Light:
    """Sun, Earth and lamp of one scene."""
    phase_rad = np.deg2rad(_uniform(rng, corpus.sun_phase_deg))
    around_rad = rng.uniform(0.0, 2.0 * np.pi)
    across = np.array([np.cos(around_rad), np.sin(around_rad)]) * np.sin(phase_rad)
    hard = rng.random() < corpus.hard_light
    # largest earthlight in a scene with hard light
    earth = rng.uniform(0.0, 0.02) if hard else _uniform(rng, corpus.earth)
    lamp = rng.uniform(0.02, 0.2) if rng.random() < corpus.lamp else 0.0
    return Light(
        # The camera looks along +z, so directions towards it have z < 0.
        sun_direction_N=(float(across[0]), float(across[1]), -float(np.cos(phase_rad))),
        earth_direction_N=_three(_direction(rng)),
        earth=float(earth),
        lamp=float(lamp),
    )


def random_sensor(corpus: Corpus, rng: np.random.Generator) -> Sensor:
    """Exposure, blur and noise of one scene."""
    return Sensor(
        white_dn=_logarithmic(rng, corpus.white_dn),
        exposure_ms=_uniform(rng, corpus.exposure_ms),
        electrons_per_dn=_logarithmic(rng, corpus.electrons_per_dn),
        read_noise_dn=_uniform(rng, corpus.read_noise_dn),
        blur_px=_uniform(rng, corpus.blur_px),
        glare=0.02 if rng.random() < 0.2 else 0.0,
    )


def _uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(rng.uniform(*ends))


def _logarithmic(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return cast(Array, vector / np.linalg.norm(vector))


def _three(vector: Array) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


@dataclass(frozen=True)
class Split:
    """Numbers of the scenes; all scenes of one body are in the same part."""

    training: tuple[int, ...]
    validation: tuple[int, ...]


def split(corpus: Corpus) -> Split:
    """Training and held-out scenes. Raises InputError: no scene is held out."""
    held_out = tuple(i for i in range(corpus.scenes) if corpus.is_validation(i))
    if not held_out:
        raise InputError(
            f"train.corpus: {corpus.scenes} scenes with validation_every {corpus.validation_every} hold out "
            "none: lower validation_every"
        )
    return Split(tuple(i for i in range(corpus.scenes) if i not in held_out), held_out)


def scene_folder(corpus: Corpus, index: int) -> Path:
    """Folder of scene ``index``."""
    return Path(corpus.folder) / f"{index:04d}"


def render_corpus(corpus: Corpus, progress: Progress, workers: int) -> None:
    """Render the missing scenes; an interrupted scene is continued.

    Raises InputError as ``require_corpus``; RunFailure: a process was killed, or a file cannot be written.
    """
    begin_corpus(corpus)
    paths = {i: scene_folder(corpus, i) / SCENE_FILE for i in range(corpus.scenes)}
    make_missing("rendering scenes", partial(_render, corpus), paths, progress, workers)


def begin_corpus(corpus: Corpus) -> None:
    """Write down what the scenes are drawn from, if the folder is new. Raises as ``require_corpus``."""
    require_corpus(corpus)
    folder = Path(corpus.folder)
    if not (folder / NOTE).is_file():
        with occupied(folder, _shown(corpus)):
            write_text(folder / NOTE, yaml.safe_dump(_drawn_from(corpus), sort_keys=False))


def _render(corpus: Corpus, index: int) -> None:
    simulate(random_scene(corpus, index), scene_seed(corpus, index), scene_folder(corpus, index), Silent())


def scene_seed(corpus: Corpus, index: int) -> int:
    """Seed of a scene's noise and stars."""
    return corpus.seed * 100_000 + index


def scene_digest(folder: Path) -> str:
    """Digest of a scene's description, which names its seed: what is made from the scene carries it."""
    return sha256((folder / SCENE_FILE).read_bytes()).hexdigest()


def require_corpus(corpus: Corpus) -> None:
    """Check the folder of the corpus before anything is written, there or elsewhere.

    Raises InputError: nothing may be written there, or it contains scenes drawn from other settings, or
    something else.
    """
    shown = _shown(corpus)
    place = folder_place(Path(corpus.folder), shown)
    if not (place / NOTE).is_file():
        there = sorted(each.name for each in place.iterdir()) if place.is_dir() else []
        if others := [name for name in there if not name.startswith(".")]:
            raise InputError(
                f"{shown}: contains {others[0]} and no {NOTE}, which states what its scenes were drawn from; "
                "choose a new or empty folder"
            )
        require_writable(place, shown)
        return
    known = read_yaml(place / NOTE)
    known = known if isinstance(known, dict) else {}
    other = [key for key, value in _drawn_from(corpus).items() if known.get(key) != value]
    if other:
        raise InputError(
            f"{shown}: contains a corpus with another {', '.join(other)}; choose a new folder, "
            "or remove this one"
        )
    if not all((scene_folder(corpus, i) / SCENE_FILE).is_file() for i in range(corpus.scenes)):
        require_writable(place, shown)


def _shown(corpus: Corpus) -> Path:
    """The folder's name in messages."""
    return Path(f"train.corpus.folder: {corpus.folder}")


def _drawn_from(corpus: Corpus) -> dict[str, Any]:
    """The settings on which the scenes depend."""
    return {key: value for key, value in corpus.model_dump(mode="json").items() if key not in FREE_KEYS}
