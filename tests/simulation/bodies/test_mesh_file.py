"""Mesh files: names, colours, gloss, drawings, and one line for each kind of bad file."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import Body, build_body, describe
from polhode.simulation.bodies.mesh_file import linear_grey, material_by_name
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.raycast import Hits
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    DARK_METAL,
    FOIL_GOLD,
    FOIL_SILVER,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
    Surface,
)


def _description(path: Path, **more: object) -> config.TargetBody:
    return config.TargetBody.model_validate(
        {"family": "mesh", "path": str(path), "metres_per_unit": 1.0, **more}
    )


def _body(path: Path, **more: object) -> Body:
    return build_body(_description(path, **more), 0)


def _surface(path: Path, face: Ints, weights: Array, **more: object) -> Surface:
    body = _body(path, **more)
    points = np.einsum("nc,nck->nk", weights, body.mesh.triangles[face])
    normals = np.asarray(body.mesh.face_normals)[face]
    n = len(face)
    hits = Hits(np.arange(n), np.asarray(face), weights, np.zeros(n), points, normals, normals)
    return SurfaceAppearance(body, _description(path, **more), 0).at(hits)


def _box() -> trimesh.Trimesh:
    box: trimesh.Trimesh = trimesh.creation.box([0.2, 0.3, 0.4])
    return box


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb"])
def test_every_format_gives_the_same_shape_with_drawings_on_its_sides(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"plain.{kind}"
    _box().export(path)
    body = _body(path)
    np.testing.assert_allclose(body.mesh.extents, [0.2, 0.3, 0.4], rtol=1e-6)
    assert body.volume_m3 == pytest.approx(0.024, rel=1e-5)
    assert len(body.charts) == 6 and body.colours is None


@pytest.mark.parametrize(
    ("name", "material"),
    [
        ("Solar Array -Y_SOLAR_CELL_BLUE", SOLAR_CELL),
        ("KeplerGoldFoil", FOIL_GOLD),
        ("mli_silver_side", FOIL_SILVER),
        ("Main Engine Nozzle", DARK_METAL),
        ("FLAT_WHITE", PAINT_WHITE),
        ("radiator_panel", PAINT_WHITE),
        ("KeplerBodyMetal", BRUSHED_METAL),
        ("ASTEROID_MATL", REGOLITH),
        ("Cube1", None),
    ],
)
def test_telling_names_choose_the_material(name: str, material: object) -> None:
    assert material_by_name(name) == material


def test_names_are_read_from_scene_graphs(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    far = trimesh.transformations.translation_matrix([2.0, 0, 0])
    scene.add_geometry(_box(), node_name="solar_wing", transform=far)
    scene.add_geometry(_box(), node_name="nozzle")
    path = tmp_path / "scene.glb"
    scene.export(path)
    body = _body(path)
    np.testing.assert_allclose(body.mesh.extents, [2.2, 0.3, 0.4], rtol=1e-6)
    assert {SOLAR_CELL, DARK_METAL} <= set(body.materials)


@pytest.mark.parametrize("kind", ["glb", "obj"])
@pytest.mark.parametrize("axis", [0, 1])
def test_an_image_is_looked_up_by_its_coordinates(tmp_path: Path, kind: str, axis: int) -> None:
    """u runs to the right, v upwards."""
    grey = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (64, 1))
    grey = grey if axis == 0 else grey.T[::-1]
    uv = np.random.default_rng(0).random((8, 2))
    box = _box()
    box.visual = TextureVisuals(uv=uv, material=PBRMaterial(
        baseColorTexture=Image.fromarray(grey).convert("RGB"), metallicFactor=0.0, roughnessFactor=0.7,
    ))  # fmt: skip
    path = tmp_path / f"textured.{kind}"
    box.export(path)
    rng = np.random.default_rng(1)
    face, weights = rng.integers(12, size=200), rng.dirichlet([1.0, 1, 1], 200)
    surface = _surface(path, face, weights)
    u = np.einsum("nc,nc->n", weights, uv[box.faces[face]][..., axis])
    expected = linear_grey(np.repeat(u[:, None], 3, axis=1))
    np.testing.assert_allclose(surface.albedo, np.clip(expected, 0.01, 0.95), atol=0.012)
    np.testing.assert_allclose(surface.specular, 0.04)
    if kind == "glb":
        np.testing.assert_allclose(surface.roughness, 0.7, atol=1e-6)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_colours_of_vertices_are_decoded_and_interpolated(tmp_path: Path, kind: str) -> None:
    box = _box()
    code = np.linspace(20, 240, 8).astype(np.uint8)
    colours = np.column_stack([code, code, code, np.full(8, 255)])
    box.visual = ColorVisuals(box, vertex_colors=colours)
    path = tmp_path / f"vertices.{kind}"
    box.export(path)
    rng = np.random.default_rng(1)
    face, weights = rng.integers(12, size=50), rng.dirichlet([1.0, 1, 1], 50)
    linear = linear_grey(np.repeat(code[:, None] / 255.0, 3, axis=1))
    expected = np.einsum("nc,nc->n", weights, linear[box.faces[face]])
    np.testing.assert_allclose(_surface(path, face, weights).albedo, expected, atol=0.004)


def test_colours_of_faces_stay_on_their_faces_in_linear_grey(tmp_path: Path) -> None:
    box = _box()
    code = np.linspace(30, 245, 12).astype(np.uint8)
    colours = np.column_stack([code, code, code, np.full(12, 255)])
    box.visual = ColorVisuals(box, face_colors=colours)
    path = tmp_path / "faces.ply"
    box.export(path)
    albedo = _surface(path, np.arange(12), np.tile([0.2, 0.3, 0.5], (12, 1))).albedo
    np.testing.assert_allclose(albedo, linear_grey(np.repeat(code[:, None] / 255.0, 3, axis=1)), atol=1e-6)
    np.testing.assert_allclose(linear_grey(np.eye(3)), [0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(linear_grey(np.full(3, 0.5)), 0.21404, atol=1e-5)
    np.testing.assert_allclose(linear_grey(np.full(3, 0.5), encoded=False), 0.5)


def test_a_base_colour_and_metalness_become_reflectances(tmp_path: Path) -> None:
    box = _box()
    box.visual = TextureVisuals(uv=np.zeros((8, 2)), material=PBRMaterial(
        baseColorFactor=[0.5, 0.5, 0.5, 1.0], metallicFactor=0.8, roughnessFactor=0.3,
    ))  # fmt: skip
    path = tmp_path / "metal.glb"
    box.export(path)
    surface = _surface(path, np.arange(12), np.full((12, 3), 1 / 3), contrast=0.0)
    np.testing.assert_allclose(surface.albedo, 0.5 * 0.2, atol=0.005)
    body = _body(path)
    assert body.materials[0].specular == pytest.approx(0.04 * 0.2 + 0.5 * 0.8, abs=0.005)
    assert body.materials[0].roughness == pytest.approx(0.3)


def test_texture_fits_the_body_at_any_scale_and_words_tell_its_size(tmp_path: Path) -> None:
    _box().export(tmp_path / "box.stl")
    small, large = (_body(tmp_path / "box.stl", metres_per_unit=unit) for unit in (0.1, 10.0))
    assert large.texture_scale == pytest.approx(100.0 * small.texture_scale)
    for a, b in zip(small.charts, large.charts, strict=True):
        assert a.image.shape == b.image.shape
    _box().export(tmp_path / "box.stl")
    words = describe(_body(tmp_path / "box.stl", metres_per_unit=0.01))
    assert "0.002 x 0.003 x 0.004 m" in words and "12 faces" in words and "\n" not in words


@pytest.mark.parametrize(
    ("name", "content", "unit", "message"),
    [
        ("absent.obj", None, 1.0, "no such mesh file"),
        ("empty.stl", b"", 1.0, "cannot be read|no faces"),
        ("garbage.glb", b"glTF\x02\x00\x00\x00nonsense", 1.0, "cannot be read as a mesh"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", 1.0, "has no faces"),
        ("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 1.0, "not finite"),
        ("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", 1.0, "cannot be read as a mesh"),
        ("thread.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", 1.0, "no area"),
        (
            "small.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            1e-4,
            "0.0001 x 0.0001.*metres_per_unit",
        ),
        (
            "large.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            1e4,
            r"1e\+04 x 1e\+04.*metres_per_unit",
        ),
        ("letter.docx", b"hello", 1.0, "cannot be read as a mesh"),
    ],
)
def test_a_bad_file_gives_one_line(
    tmp_path: Path, name: str, content: bytes | None, unit: float, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        _body(path, metres_per_unit=unit)
    assert "\n" not in str(caught.value) and name in str(caught.value)
