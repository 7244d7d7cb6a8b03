"""The surface of whole bodies: layers of drawings, one material for all, contrast."""

from functools import cache

import numpy as np
import pytest
import trimesh

from polhode.config import scene as config
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.parts.part import SLOPE_STEP, Chart, Part, assemble
from polhode.simulation.rendering.skin import Skin
from polhode.simulation.surface.materials import FOIL_SILVER, GLASS, PAINT_GREY, REGOLITH, SOLAR_CELL, Surface


def _on_all_faces(body: Body, description: config.Body) -> Surface:
    face = np.arange(len(body.mesh.faces))
    weights = np.full((len(face), 3), 1 / 3)
    centres, normals = np.asarray(body.mesh.triangles_center), np.asarray(body.mesh.face_normals)
    return Skin(body, description, 0).evaluate(face, weights, centres, normals)


def test_a_layer_of_a_drawing_brings_its_own_material_and_slope() -> None:
    mesh = trimesh.creation.box([1.0, 1.0, 1.0])
    top = np.flatnonzero(mesh.face_normals[:, 2] > 0.9)
    image, layer = np.full((11, 11), 0.5, np.float32), np.zeros((11, 11), np.uint8)
    layer[:, 6:] = 1
    slope = np.full((11, 11, 2), 10, np.int8)
    corner, right, down = np.array([-0.5, 0.5, 0.5]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    chart = Chart(corner, right, down, 0.1, image, slope, layer, (GLASS,))
    body = assemble([Part(mesh, PAINT_GREY, ((chart, top),))])
    points = np.array([[-0.3, 0.0, 0.5], [0.3, 0.0, 0.5]])
    up = np.tile([0.0, 0.0, 1.0], (2, 1))
    surface = Skin(body, config.Body(contrast=0.0), 0).evaluate(
        top[[0, 0]], np.full((2, 3), 1 / 3), points, up
    )
    np.testing.assert_allclose(surface.specular, [PAINT_GREY.specular, GLASS.specular])
    # Without contrast there is the part's own reflectance everywhere.
    np.testing.assert_allclose(surface.albedo, PAINT_GREY.albedo)
    bent = np.array([-10 * SLOPE_STEP, 10 * SLOPE_STEP, 1.0])
    np.testing.assert_allclose(surface.normal_G[0], bent / np.linalg.norm(bent), atol=1e-9)


@cache
def _bus(material: str) -> tuple[Body, config.Body]:
    description = config.Body.model_validate({"family": "bus", "material": material, "seed": 4})
    return build_body(description, 0), description


def test_a_bus_all_in_foil_keeps_its_cells() -> None:
    body, description = _bus("foil")
    own = {body.materials[m] for m in np.unique(body.face_material)}
    assert own <= {FOIL_SILVER, SOLAR_CELL, GLASS} and FOIL_SILVER in own and SOLAR_CELL in own
    shiny = _on_all_faces(body, description).specular == FOIL_SILVER.specular
    assert body.mesh.area_faces[shiny].sum() > 0.2 * body.mesh.area


def test_regolith_covers_everything() -> None:
    body, _ = _bus("regolith")
    assert body.materials == (REGOLITH,) and body.charts == ()


@pytest.mark.parametrize("material", ["paint", "metal", "solar_cell"])
def test_other_materials_are_taken_too(material: str) -> None:
    body, description = _bus(material)
    surface = _on_all_faces(body, description)
    assert np.isfinite(surface.albedo).all() and len(body.charts) > 6


def test_the_two_generators_give_other_surfaces_on_one_shape() -> None:
    """Foil is where the noise differs most: the normals of half of its faces differ."""
    body, description = _bus("foil")
    other = description.model_copy(update={"texture": "collage"})
    one, two = (_on_all_faces(body, d) for d in (description, other))
    differ = np.abs(one.normal_G - two.normal_G).max(axis=1) > 1e-6
    assert differ.mean() > 0.5
