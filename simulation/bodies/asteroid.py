"""A small rocky body: a lumpy ellipsoid with craters and boulders, under regolith."""

import numpy as np
import trimesh

from polhode.lie import Array, exp_so3
from simulation.bodies.part import Part
from simulation.materials import REGOLITH
from simulation.noise import fractal

SUBDIVISIONS = 6
"""Of an icosahedron: 81,920 faces, 1.5 mm edges on a body of 0.3 m."""


def asteroid_parts(size_m: float, rng: np.random.Generator, subdivisions: int = SUBDIVISIONS) -> list[Part]:
    """One part, as large as a sphere of diameter size_m [m]; G is not aligned with the ellipsoid."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    direction = np.asarray(sphere.vertices)
    height = 1.0 + 0.22 * _noise(direction, 0.9, rng) + 0.05 * _noise(direction, 0.25, rng)
    height -= _craters(direction, rng)
    height += _boulders(direction, rng)
    axes = np.array([1.22, 0.98, 0.83]) * rng.uniform(0.95, 1.05, 3)
    points = direction * height[:, None] * axes
    points = points @ exp_so3(rng.normal(0, 1.0, 3)).T + rng.uniform(-0.08, 0.08, 3)
    mesh = trimesh.Trimesh(points, sphere.faces, process=False)
    mesh.apply_scale(size_m * np.cbrt(np.pi / 6 / mesh.volume))
    return [Part(mesh, REGOLITH)]


def _noise(direction: Array, scale: float, rng: np.random.Generator) -> Array:
    n = len(direction)
    return fractal(direction, np.full(n, scale), np.full(n, int(rng.integers(1 << 20))))


def _craters(direction: Array, rng: np.random.Generator) -> Array:
    """Depth of bowls with raised rims, many small and few large."""
    depth = np.zeros(len(direction))
    for _ in range(60):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius = 0.05 * rng.uniform(0.04, 1.0) ** -0.6
        x = np.arccos(np.clip(direction @ centre, -1, 1)) / radius
        bowl = np.where(x < 1, 1 - x**2, 0.0)
        rim = np.exp(-(((x - 1.05) / 0.22) ** 2))
        depth += radius * (0.28 * bowl - 0.09 * rim)
    return depth


def _boulders(direction: Array, rng: np.random.Generator) -> Array:
    height = np.zeros(len(direction))
    for _ in range(160):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius = 0.02 * rng.uniform(0.1, 1.0) ** -0.5
        x = np.arccos(np.clip(direction @ centre, -1, 1)) / radius
        height = np.maximum(height, radius * 0.7 * np.sqrt(np.clip(1 - x**2, 0, None)))
    return height
