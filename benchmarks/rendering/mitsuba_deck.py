"""A deck of equipment that two renderers can show alike: plane drawings, even metals, no relief, no noise."""

from collections.abc import Callable

import cv2
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from polhode.lie import Array, exp_so3, make_pose
from polhode.simulation.bodies.parts.part import Chart, Part
from polhode.simulation.surface.materials import Material

TEXEL_M = 1e-3
MATT = Material(0.5, specular=0.0)
PAINT = Material(0.6, specular=0.04, roughness=0.45)
METAL = Material(0.16, specular=0.55, roughness=0.42)
CELLS = Material(0.07, specular=0.06, roughness=0.3)
DARK = Material(0.1, specular=0.0)

Drawing = NDArray[np.float32]
Draw = Callable[[int, int, np.random.Generator], Drawing]


def deck() -> list[Part]:
    """The parts in G; z points away from the deck, whose surface is z = 0."""
    rng = np.random.default_rng(5)
    return [
        _box([0.5, 0.38, 0.02], _pose([0, 0, -0.01]), MATT, _patches, rng),
        _box([0.12, 0.1, 0.08], _pose([-0.13, -0.05, 0.04]), MATT, _patches, rng),
        _box([0.07, 0.09, 0.05], _pose([0.16, 0.1, 0.025]), PAINT, _patches, rng),
        _box([0.2, 0.1, 0.004], _pose([0.05, -0.11, 0.09], [0.45, 0.35, 0.3]), CELLS, _cells, rng),
        _plain(trimesh.creation.icosphere(subdivisions=4, radius=0.05), _pose([0.0, 0.06, 0.05]), METAL),
        _plain(
            trimesh.creation.cylinder(radius=0.03, height=0.1, sections=64),
            _pose([-0.14, 0.11, 0.03], [0.0, np.pi / 2, 0.0]),
            PAINT,
        ),
        _plain(
            trimesh.creation.cylinder(radius=0.004, height=0.16, sections=24),
            _pose([0.17, -0.02, 0.08]),
            DARK,
        ),
        _plain(trimesh.creation.box([0.006, 0.006, 0.09]), _pose([0.05, -0.11, 0.045]), DARK),
    ]


def _pose(p_G: ArrayLike, turn_rad: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    return make_pose(exp_so3(turn_rad), p_G)


def _plain(mesh: trimesh.Trimesh, X_GO: Array, material: Material) -> Part:
    mesh.apply_transform(X_GO)
    return Part(mesh, material)


def _box(extents_m: ArrayLike, X_GO: Array, material: Material, draw: Draw, rng: np.random.Generator) -> Part:
    """A box, centred in its own frame O, with a drawing of its own on each side."""
    mesh = trimesh.creation.box(extents_m)
    half = 0.5 * np.asarray(extents_m)
    charts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal, right, down = sign * np.eye(3)[axis], np.eye(3)[axis - 2], np.eye(3)[axis - 1]
            width, height = (int(np.ceil(2 * half @ side / TEXEL_M)) + 1 for side in (right, down))
            corner = half * (normal - right - down)
            chart = Chart(
                X_GO[:3, :3] @ corner + X_GO[:3, 3],
                X_GO[:3, :3] @ right,
                X_GO[:3, :3] @ down,
                TEXEL_M,
                draw(height, width, rng),
            )
            charts.append((chart, np.flatnonzero(np.asarray(mesh.face_normals) @ normal > 0.5)))
    mesh.apply_transform(X_GO)
    return Part(mesh, material, tuple(charts))


def _patches(height: int, width: int, rng: np.random.Generator) -> Drawing:
    """Plates and discs of random size and reflectance over each other."""
    image = np.full((height, width), rng.uniform(0.4, 0.6), np.float32)
    for _ in range(max(4, height * width // 500)):
        at = rng.uniform((0, 0), (width, height)).astype(int)
        size = rng.uniform(2, 16, 2).astype(int)
        shade = float(rng.uniform(0.05, 0.9))
        if rng.random() < 0.3:
            cv2.circle(image, at.tolist(), int(size[0] // 2 + 1), shade, -1)
        else:
            cv2.rectangle(image, at.tolist(), (at + size).tolist(), shade, -1)
    return cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.float32)


def _cells(height: int, width: int, rng: np.random.Generator) -> Drawing:
    """Dark cells, each of its own shade, in a bright grid."""
    image = np.full((height, width), 0.35, np.float32)
    for top in range(2, height - 2, 20):
        for left in range(2, width - 2, 30):
            image[top : top + 18, left : left + 28] = rng.normal(0.08, 0.015)
    return cv2.GaussianBlur(np.clip(image, 0.02, 0.9), (0, 0), 0.6).astype(np.float32)
