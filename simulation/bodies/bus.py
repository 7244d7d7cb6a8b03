"""A box bus wrapped in foil and radiators, with two thin solar panels, a dish and a nozzle."""

from dataclasses import replace

import numpy as np
import trimesh

from polhode.lie import Array
from simulation.bodies.drawing import chart_of_facet, draw_equipment_panel, draw_plain, draw_solar_cells
from simulation.bodies.facets import flat_facets
from simulation.bodies.part import Chart, Part
from simulation.materials import BRUSHED_METAL, FOIL_GOLD, PAINT_BLACK, PAINT_GREY, PAINT_WHITE, SOLAR_CELL


def bus_parts(size_m: float, rng: np.random.Generator) -> list[Part]:
    """Parts of a bus size_m [m] long (x); panels along +-y; G near the middle of the box."""
    box_m = size_m * np.array([1.0, rng.uniform(0.7, 0.85), rng.uniform(0.75, 0.95)])
    texel_m = 0.0022 * size_m
    parts = [_box(box_m, texel_m, rng)]
    parts += _panels(box_m, size_m, texel_m, rng)
    parts += _equipment(box_m, size_m, texel_m, rng)
    return parts


def _box(box_m: Array, texel_m: float, rng: np.random.Generator) -> Part:
    """Foil on two faces (no chart), a plain radiator on one, equipment on three."""
    mesh = trimesh.creation.box(box_m)
    facets = flat_facets(mesh)
    kinds = rng.permutation(["foil", "foil", "radiator", "equipment", "equipment", "equipment"])
    charts = []
    for faces, kind in zip(facets, kinds, strict=True):
        if kind == "radiator":
            charts.append(chart_of_facet(mesh, faces, texel_m, draw_plain(0.65), rng))
        elif kind == "equipment":
            charts.append(chart_of_facet(mesh, faces, texel_m, draw_equipment_panel(0.35, 1100.0), rng))
    return Part(mesh, FOIL_GOLD, tuple(charts), density_factor=1.5, name="box")


def _panels(box_m: Array, size_m: float, texel_m: float, rng: np.random.Generator) -> list[Part]:
    parts = []
    tilt = rng.uniform(-0.5, 0.5)
    for side in (-1.0, 1.0):
        length, chord, thickness = 1.1 * size_m, 0.7 * size_m, 0.012 * size_m
        mesh = trimesh.creation.box([chord, length, thickness])
        gap = 0.14 * size_m
        X = trimesh.transformations.rotation_matrix(tilt, [0, 1, 0])
        X[:3, 3] = [0.05 * size_m, side * (0.5 * box_m[1] + gap + 0.5 * length), 0.02 * size_m]
        charts = []
        for faces in flat_facets(mesh):
            if mesh.area_faces[faces].sum() > 0.5 * chord * length:
                front = mesh.face_normals[faces[0], 2] > 0
                draw = draw_solar_cells(0.085 * size_m) if front else draw_equipment_panel(0.3, 350.0)
                charts.append(chart_of_facet(mesh, faces, texel_m, draw, rng))
        moved = tuple((_moved(chart, X), faces) for chart, faces in charts)
        mesh.apply_transform(X)
        parts.append(Part(mesh, SOLAR_CELL, moved, density_factor=0.6, name="panel"))
        arm = trimesh.creation.cylinder(0.018 * size_m, gap + 0.02 * size_m, sections=16)
        arm.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
        arm.apply_translation([0.05 * size_m, side * (0.5 * box_m[1] + 0.5 * gap), 0.02 * size_m])
        parts.append(Part(arm, BRUSHED_METAL, name="arm"))
    return parts


def _equipment(box_m: Array, size_m: float, texel_m: float, rng: np.random.Generator) -> list[Part]:
    """A dish on top, a nozzle at the rear, two electronics boxes."""
    dish_profile = np.array([[0.0, 0.0], [0.1, 0.012], [0.2, 0.05], [0.2, 0.056], [0.1, 0.02], [0.0, 0.008]])
    dish = trimesh.creation.revolve(dish_profile * size_m, sections=48)
    dish.apply_transform(trimesh.transformations.rotation_matrix(0.5, [0.3, 1, 0]))
    dish.apply_translation([0.15 * size_m, 0.0, 0.5 * box_m[2] + 0.1 * size_m])
    mast = trimesh.creation.cylinder(0.02 * size_m, 0.16 * size_m, sections=16)
    mast.apply_translation([0.15 * size_m, 0.0, 0.5 * box_m[2] + 0.04 * size_m])
    bell_profile = np.array([[0.0, 0.0], [0.045, 0.0], [0.1, 0.14], [0.094, 0.14], [0.03, 0.01], [0.0, 0.01]])
    bell = trimesh.creation.revolve(bell_profile * size_m, sections=40)
    bell.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 1, 0]))
    bell.apply_translation([-0.5 * box_m[0] + 0.005 * size_m, 0.0, 0.0])
    parts = [
        Part(dish, PAINT_WHITE, name="dish"),
        Part(mast, BRUSHED_METAL, name="mast"),
        Part(bell, PAINT_BLACK, name="nozzle"),
    ]
    for face in (np.array([1.0, 0, 0]), np.array([0, 0, -1.0])):
        size = size_m * rng.uniform((0.15, 0.18, 0.06), (0.28, 0.3, 0.1))
        mesh = trimesh.creation.box(size[[2, 0, 1]] if face[0] else size)
        place = 0.5 * box_m * face + rng.uniform(-0.15, 0.15, 3) * size_m * (1 - np.abs(face))
        mesh.apply_translation(place)
        draw = draw_equipment_panel(float(rng.uniform(0.2, 0.5)), 1500.0)
        charts = tuple(chart_of_facet(mesh, f, texel_m, draw, rng) for f in flat_facets(mesh))
        parts.append(Part(mesh, PAINT_GREY, charts, name="equipment"))
    return parts


def _moved(chart: Chart, X: Array) -> Chart:
    """The chart after the rigid transform (4, 4) of its part."""
    R = X[:3, :3]
    return replace(
        chart, origin_G=R @ chart.origin_G + X[:3, 3], right_G=R @ chart.right_G, down_G=R @ chart.down_G
    )
