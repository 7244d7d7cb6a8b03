"""A small rocky body: a lumpy, two-lobed or top-shaped rock with craters and boulders, under regolith."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, exp_so3
from polhode.simulation.bodies.part import Part
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import REGOLITH
from polhode.simulation.surface.noise import fractal

SUBDIVISIONS = 6
"""Of an icosahedron: 81,920 faces, 2 mm edges on a body of 0.3 m."""


def asteroid_parts(size_m: float, builder: PartBuilder, subdivisions: int = SUBDIVISIONS) -> list[Part]:
    """One part, as large as a sphere of diameter size_m [m]; G is not aligned with the longest axis.

    Seeds differ in shape (ellipsoid, two lobes, spinning top) and in cover, from smooth and cratered to a
    pile of boulders.
    """
    rng = builder.rng
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    direction = np.ascontiguousarray(sphere.vertices)
    tree = cKDTree(direction)
    rubble = float(rng.uniform(0.15, 1.0))
    height = _shape(direction, rng)
    height += 0.24 * _noise(direction, 0.9, rng) + 0.06 * _noise(direction, 0.35, rng)
    height += _craters(direction, tree, rng, count=int(130 - 70 * rubble))
    height += _boulders(direction, tree, rng, count=int(150 + 750 * rubble))
    height += (0.006 + 0.006 * rubble) * _noise(direction, 0.06, rng)
    points = direction * height[:, None]
    points = points @ exp_so3(rng.normal(0, 1.0, 3)).T + rng.uniform(-0.08, 0.08, 3)
    mesh = trimesh.Trimesh(points, sphere.faces, process=False)
    mesh.apply_scale(size_m * np.cbrt(np.pi / 6 / mesh.volume))
    return [Part(mesh, REGOLITH)]


def _shape(direction: Array, rng: np.random.Generator) -> Array:
    """Distance from the centre (n,) of the large-scale shape in each direction."""
    kind = rng.integers(3)
    axes = np.array([1.25, 0.98, 0.83]) * rng.uniform(0.93, 1.07, 3)
    if kind == 0:
        return np.asarray(1.0 / np.linalg.norm(direction / axes, axis=1))
    if kind == 1:
        # A ridge around the equator and cones towards the poles.
        z = np.abs(direction[:, 2])
        return np.asarray((1.06 - 0.26 * z + 0.1 * z**2) * (1.0 + 0.04 * direction[:, 0]))
    lobes = []
    for x, radius in ((0.62, rng.uniform(0.62, 0.72)), (-0.55, rng.uniform(0.72, 0.85))):
        along = direction[:, 0] * x + direction[:, 2] * rng.uniform(-0.08, 0.08)
        lobes.append(along + np.sqrt(np.maximum(along**2 - x * x + radius**2, 0.05)))
    # A smooth maximum fills the neck slightly.
    return np.asarray(np.log(np.exp(9.0 * lobes[0]) + np.exp(9.0 * lobes[1])) / 9.0)


def _noise(direction: Array, scale: float, rng: np.random.Generator) -> Array:
    n = len(direction)
    return fractal(direction, np.full(n, scale), np.full(n, int(rng.integers(1 << 20))))


def _craters(direction: Array, tree: cKDTree, rng: np.random.Generator, count: int) -> Array:
    """Height (n,) of bowls with raised rims, eroded to different degrees, many small and few large."""
    height = np.zeros(len(direction))
    for _ in range(count):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius = min(0.05 * float(rng.uniform(0.01, 1.0)) ** -0.6, 0.55)
        wear = float(rng.uniform(0.25, 1.0))
        near = np.asarray(tree.query_ball_point(centre, 2.2 * radius), dtype=np.int64)
        if len(near) > 0:
            ragged = 1.0 + 0.12 * _noise(direction[near] / radius, 0.7, rng)
            x = np.arccos(np.clip(direction[near] @ centre, -1, 1)) / (radius * ragged)
            bowl = np.clip(1 - x**2, 0, None) ** 0.8
            rim = np.exp(-(((x - 1.0) / 0.25) ** 2)) + 0.25 * np.exp(-(((x - 1.3) / 0.4) ** 2))
            height[near] += wear * radius * (0.09 * rim - 0.34 * bowl)
    return height


def _boulders(direction: Array, tree: cKDTree, rng: np.random.Generator, count: int) -> Array:
    """Height (n,) of angular blocks; their number falls with the 2.5th power of the size.

    A block is convex: the minimum of a top and steep side planes.
    """
    height = np.zeros(len(direction))
    for _ in range(count):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius = min(0.014 * float(rng.uniform(0.001, 1.0)) ** -0.4, 0.14)
        near = np.asarray(tree.query_ball_point(centre, 1.5 * radius), dtype=np.int64)
        if len(near) == 0:
            continue
        east = np.cross(centre, np.eye(3)[int(np.argmin(np.abs(centre)))])
        east /= np.linalg.norm(east)
        flat = direction[near] @ np.stack([east, np.cross(centre, east)], axis=1) / radius
        lid = rng.uniform(0.3, 0.6) + flat @ rng.normal(0, 0.25, 2)
        sides = int(rng.integers(4, 7))
        angle = 2 * np.pi * (np.arange(sides) + rng.uniform(-0.3, 0.3, sides)) / sides
        steep, reach = rng.uniform(1.2, 2.6, sides), rng.uniform(0.6, 1.0, sides)
        walls = steep * (reach - flat @ np.stack([np.cos(angle), np.sin(angle)]))
        block = np.clip(np.minimum(lid, walls.min(axis=1)), 0.0, None)
        height[near] = np.maximum(height[near], radius * block)
    return height
