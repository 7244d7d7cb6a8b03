"""A random scene of the corpus, determined by the corpus's seed and the scene's number."""

from typing import cast

import numpy as np

from polhode.config.scene import Background, Light, Motion, Render, Rig, Scene, Sensor, TargetBody
from polhode.config.train import Corpus
from polhode.lie import Array
from polhode.simulation.bodies import build_body

MATERIALS = {
    "asteroid": ("regolith",),
    "cubesat": ("paint", "solar_cell", "metal", "foil"),
}
"""Materials that may cover a whole body of a family; other families use ``ANY_MATERIAL``."""
ANY_MATERIAL = ("paint", "foil", "solar_cell", "metal")
MAX_HARD_EARTH = 0.02
"""Largest earthlight in a scene with hard light."""
MAX_OFFSET = 0.5
"""Largest distance between the centres of body and image, as a share of the free space beside the body."""
ENCLOSED_AREA = 0.95
"""Share of the surface inside the body's nominal sphere: thin antennas may extend beyond it."""
DEG_S_TO_RPM = 1.0 / 6.0


def random_scene(corpus: Corpus, index: int) -> Scene:
    """Scene ``index``, counted from 0. The body is built to measure its size."""
    rng = np.random.default_rng([corpus.seed, 0xC0, index])
    body = _body(corpus, index, rng)
    rig = Rig()
    radius_m = _radius_m(body)
    depth_m = 2.0 * radius_m * rig.focal_px / _uniform(rng, corpus.span_px)
    baseline_m = _logarithmic(rng, corpus.disparity_px) * depth_m / rig.focal_px
    return Scene(
        frames=corpus.frames,
        interval_s=1.0,
        truth_horizon_s=0.0,
        body=body,
        motion=_motion(corpus, rig, depth_m, radius_m, rng),
        rig=rig.model_copy(update={"baseline_m": baseline_m}),
        light=_light(corpus, rng),
        background=Background(
            stars=bool(rng.random() < corpus.stars), earth=bool(rng.random() < corpus.earth_behind)
        ),
        sensor=_sensor(corpus, rng),
        render=Render(products=("depth", "normals", "mask", "shadow")),
    )


def _body(corpus: Corpus, index: int, rng: np.random.Generator) -> TargetBody:
    family = corpus.families[index % len(corpus.families)]
    choices = MATERIALS.get(family, ANY_MATERIAL)
    other = choices[rng.integers(len(choices))] if rng.random() < corpus.other_material else "automatic"
    return TargetBody.model_validate(
        {
            "family": family,
            "size_m": _uniform(rng, corpus.size_m),
            "seed": corpus.first_body_seed + index,
            "material": other,
            "texture": corpus.texture,
            "contrast": _logarithmic(rng, corpus.contrast),
        }
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
    return float(distance_m[order][np.searchsorted(share, ENCLOSED_AREA)])


def _motion(corpus: Corpus, rig: Rig, depth_m: float, radius_m: float, rng: np.random.Generator) -> Motion:
    reach_m = depth_m / rig.focal_px * np.array([rig.width_px, rig.height_px]) / 2.0 - radius_m
    offset_m = rng.uniform(-1.0, 1.0, 2) * np.maximum(reach_m, 0.0) * MAX_OFFSET
    turn = _direction(rng) * rng.uniform(0.0, 180.0)
    spin = _direction(rng) * _uniform(rng, corpus.turn_deg) * DEG_S_TO_RPM
    return Motion(
        position_m=(float(offset_m[0]), float(offset_m[1]), depth_m),
        attitude_deg=_three(turn),
        spin_rpm=_three(spin),
    )


def _light(corpus: Corpus, rng: np.random.Generator) -> Light:
    phase_rad = np.deg2rad(_uniform(rng, corpus.sun_phase_deg))
    around_rad = rng.uniform(0.0, 2.0 * np.pi)
    across = np.array([np.cos(around_rad), np.sin(around_rad)]) * np.sin(phase_rad)
    hard = rng.random() < corpus.hard_light
    earth = rng.uniform(0.0, MAX_HARD_EARTH) if hard else _uniform(rng, corpus.earth)
    lamp = rng.uniform(0.02, 0.2) if rng.random() < corpus.lamp else 0.0
    return Light(
        # The camera looks along +z, so directions towards it have z < 0.
        sun_direction_N=(float(across[0]), float(across[1]), -float(np.cos(phase_rad))),
        earth_direction_N=_three(_direction(rng)),
        earth=float(earth),
        lamp=float(lamp),
    )


def _sensor(corpus: Corpus, rng: np.random.Generator) -> Sensor:
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
