"""Meshes of others: what they state is checked first, and they make the program open no other file."""

import json
import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from polhode.files.foreign_meshes import open_mesh
from polhode.mapping.mesh_files import read_mesh
from polhode.runtime.errors import InputError
from polhode.simulation.bodies.mesh_file import read_pieces

Read = Callable[[Path], Any]
READERS: dict[str, Read] = {
    "CAD model": lambda path: read_mesh(path, 1.0),
    "simulated body": lambda path: read_pieces(path, 1.0),
}
BOX = trimesh.creation.box([0.2, 0.3, 0.4])


def _ply(*lines: str, body: bytes = b"", form: str = "binary_little_endian") -> bytes:
    return "\n".join(["ply", f"format {form} 1.0", *lines, "end_header", ""]).encode() + body


def _vertices(count: int) -> list[str]:
    return [f"element vertex {count}", "property float x", "property float y", "property float z"]


def _faces(count: int, sizes: str = "uchar") -> list[str]:
    return [f"element face {count}", f"property list {sizes} int vertex_indices"]


def _glb(document: object, binary: bytes = b"", length: int | None = None) -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary) if length is None else length
    head = struct.pack("<5I", 0x46546C67, 2, total, len(text), 0x4E4F534A)
    return head + text + struct.pack("<2I", len(binary), 0x4E4942) + binary


def _gltf(**changes: Any) -> dict[str, Any]:
    """A triangle, with parts of its description replaced."""
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 48}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
            {"bufferView": 1, "componentType": 5125, "type": "SCALAR", "count": 3},
        ],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    } | changes


TRIANGLE = np.eye(3, dtype="<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
POSITION = {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}
HUGE = 10**12
HOSTILE: dict[str, tuple[str, bytes, str]] = {
    "ply count": ("a.ply", _ply(*_vertices(HUGE), body=bytes(36)), "rows"),
    "ply faces": ("a.ply", _ply(*_vertices(3), *_faces(HUGE), body=bytes(36)), "rows"),
    "ply count within the limit": ("a.ply", _ply(*_vertices(10**6), body=bytes(36)), "rows stated"),
    "ply text count": ("a.ply", _ply(*_vertices(300_000), form="ascii", body=b"0 0 0\n"), "lines there"),
    "ply empty lines": ("a.ply", _ply(*_vertices(3), form="ascii", body=b"\n" * 10**6), "lines there"),
    "ply no properties": ("a.ply", _ply(f"element vertex {HUGE}"), "rows"),
    "ply negative": ("a.ply", _ply("element vertex -5"), "a header with the line"),
    "ply type": ("a.ply", _ply("element vertex 1", "property quad x"), "a header with the line"),
    "ply list of floats": ("a.ply", _ply("element face 1", "property list float int v"), "a header with"),
    "ply long comment": ("a.ply", _ply("comment " + "x" * 10**6), "no header of a PLY"),
    "ply no end": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "no header of a PLY"),
    "ply two elements": ("a.ply", _ply(*_vertices(0), *_vertices(0)), "two of one name"),
    "ply list count": (
        "a.ply",
        _ply(*_vertices(0), *_faces(1, "uint"), body=b"\xff\xff\xff\x7f" + bytes(12)),
        "cannot be read",
    ),
    "ply lists": (
        "a.ply",
        _ply(
            *_vertices(3), *_faces(2),
            body=bytes(12) + np.eye(3, dtype="<f4").tobytes()[:24] + b"\3" + bytes(12) + b"\4" + bytes(12),
        ),
        "lists of several lengths",
    ),
    "stl count": ("a.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "as many triangles"),
    "stl solids": ("a.stl", b"solid a\nendsolid a\n" * 3000, "3000 pieces"),
    "obj groups": ("a.obj", b"".join(b"usemtl m%d\nf 1 2 3\n" % i for i in range(3000)), "3000 pieces"),
    "obj long line": ("a.obj", b"v 0 0 0\nf " + b"1 " * 10**5, "a line of more than"),
    "obj many numbers": ("a.obj", b"f 1 2 3\n" * 500_000, "1500000 numbers"),
    "obj index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n", "cannot be read"),
    "glb length": ("a.glb", _glb(_gltf(), TRIANGLE, length=2**31), "bytes stated"),
    "glb deep": ("a.glb", _glb(b"[" * 200_000), "cannot be read"),
    "glb list": ("a.glb", _glb([1, 2]), "no document"),
    "glb view": (
        "a.glb", _glb(_gltf(bufferViews=[{"buffer": 0, "byteLength": HUGE}] * 2), TRIANGLE), "not within",
    ),
    "glb views of all": (
        "a.glb", _glb(_gltf(bufferViews=[{"buffer": 0, "byteLength": 2**22}] * 99), bytes(2**22)), "together",
    ),
    "glb count": ("a.glb", _glb(_gltf(accessors=[POSITION | {"count": HUGE}] * 2), TRIANGLE), "that needs"),
    "glb negative": ("a.glb", _glb(_gltf(accessors=[POSITION | {"count": -1}] * 2), TRIANGLE), "a count"),
    "glb sparse": (
        "a.glb", _glb(_gltf(accessors=[POSITION | {"sparse": {"count": HUGE}}] * 2), TRIANGLE), "sparse",
    ),
    "glb zeros": (
        "a.glb",
        _glb(_gltf(accessors=[{"componentType": 5126, "type": "VEC3", "count": HUGE}] * 2), TRIANGLE),
        "without values",
    ),
    "glb draco": (
        "a.glb", _glb(_gltf(extensionsRequired=["KHR_draco_mesh_compression"]), TRIANGLE), "compression",
    ),
    "glb file": ("a.glb", _glb(_gltf(buffers=[{"uri": "/etc/passwd", "byteLength": 48}]), TRIANGLE), "embed"),
    "glb address": ("a.glb", _glb(_gltf(images=[{"uri": "http://a.test/x.png"}]), TRIANGLE), "embed"),
    "glb cycle": (
        "a.glb",
        _glb(_gltf(nodes=[{"children": [1]}, {"children": [2]}, {"mesh": 0, "children": [1]}]), TRIANGLE),
        "two parents",
    ),
    "glb own child": ("a.glb", _glb(_gltf(nodes=[{"mesh": 0, "children": [0]}]), TRIANGLE), "own ancestors"),
    "glb instances": ("a.glb", _glb(_gltf(nodes=[{"mesh": 0}] * 5000), TRIANGLE), "5000 pieces"),
    "glb index": ("a.glb", _glb(_gltf(nodes=[{"mesh": 7}]), TRIANGLE), "cannot be read"),
    "glb faces": (
        "a.glb", _glb(_gltf(), TRIANGLE[:36] + np.array([0, 1, 9], "<u4").tobytes()), "do not exist",
    ),
    "step": ("a.step", b"ISO-10303-21;", "its name ends with none of"),
    "gltf": ("a.gltf", b"{}", "its name ends with none of"),
    "nothing": ("a.ply", b"", "no header"),
}  # fmt: skip


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_mesh_is_one_line_and_costs_little(tmp_path: Path, case: str, reader: str) -> None:
    name, content, message = HOSTILE[case]
    path = tmp_path / name
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message) as error:
            READERS[reader](path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(error.value).startswith(str(path)) and str(error.value).isprintable()
    assert peak < 40 * max(len(content), 10**6)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "glb"])
def test_coordinates_that_no_body_has_pipes_and_meshes_without_area_are_refused(
    tmp_path: Path, kind: str, reader: str
) -> None:
    path = tmp_path / f"a.{kind}"
    for value in (np.nan, np.inf, 1e30):
        mesh = BOX.copy()
        mesh.vertices[3, 1] = value
        with np.errstate(all="ignore"):
            mesh.export(path)
        with pytest.raises(InputError, match=r"finite|m large|a coordinate of") as error:
            READERS[reader](path)
        assert "\n" not in str(error.value)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InputError, match="is a pipe"):
        READERS[reader](path)
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="no area"):
        READERS[reader](tmp_path / "flat.obj")


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "glb"])
@pytest.mark.parametrize("form", ["text", "binary"])
def test_what_trimesh_writes_is_read(tmp_path: Path, kind: str, form: str) -> None:
    path = tmp_path / f"a.{kind}"
    options = {"encoding": "ascii"} if (kind, form) == ("ply", "text") else {}
    BOX.export(path, file_type="stl_ascii" if (kind, form) == ("stl", "text") else kind, **options)
    mesh = read_mesh(path, 0.5)
    np.testing.assert_allclose(mesh.extents, [0.1, 0.15, 0.2], rtol=1e-6)
    assert len(mesh.vertices) == 8 and len(mesh.faces) == 12
    assert len(read_pieces(path, 0.5)) == 1


def test_polygons_and_names_that_are_not_ascii_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("# größe\no körper\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\nf 1 2 5\n")
    assert len(read_mesh(path, 1.0).faces) == 3


def _textured(folder: Path, texture: str) -> Path:
    (folder / "a.mtl").write_text(f"newmtl m\nKd 1 1 1\nmap_Kd {texture}\n")
    path = folder / "a.obj"
    corners = "vt 0 0\nvt 1 0\nvt 0 1\n"
    path.write_text(f"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n{corners}usemtl m\nf 1/1 2/2 3/3\n")
    return path


def _texture_of(path: Path, piece: int = 0) -> Any:
    visual: Any = read_pieces(path, 1.0)[piece].source.visual
    return visual.material.image


def test_a_texture_beside_the_mesh_is_used_whatever_its_path(tmp_path: Path) -> None:
    Image.new("RGB", (30, 20), (90, 90, 90)).save(tmp_path / "skin.png")
    for name in ("skin.png", "./skin.png", "/home/someone/skin.png", "C:\\models\\skin.png"):
        assert _texture_of(_textured(tmp_path, name)).size == (30, 20)


def test_no_file_outside_the_folder_of_the_mesh_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    Image.new("RGB", (30, 20)).save(tmp_path / "secret.png")
    (tmp_path / "secret.mtl").write_text("newmtl m\nKd 0.1 0.1 0.1\n")
    (inside / "link.png").symlink_to(tmp_path / "secret.png")
    os.mkfifo(inside / "pipe.png")
    opened: list[str] = []
    original = os.open

    def watched(path: Any, *arguments: Any, **options: Any) -> int:
        opened.append(str(path))
        return original(path, *arguments, **options)

    monkeypatch.setattr(os, "open", watched)
    for name in ("../secret.png", str(tmp_path / "secret.png"), "link.png", "pipe.png", "/dev/zero"):
        image = _texture_of(_textured(inside, name))
        assert image is None or image.size != (30, 20)
    path = _textured(inside, "x.png")
    path.write_text(path.read_text().replace("mtllib a.mtl", "mtllib ../secret.mtl"))
    read_pieces(path, 1.0)
    assert {Path(each).parent for each in opened if "inside" in each or "secret" in each} == {inside}


def test_textures_are_decoded_once_and_limited(tmp_path: Path) -> None:
    path = _textured(tmp_path, "skin.png")
    Image.new("1", (9000, 9000)).save(tmp_path / "skin.png")
    with pytest.raises(InputError, match="images of more than 64000000 pixels"):
        read_pieces(path, 1.0)
    Image.new("RGB", (5000, 10)).save(tmp_path / "skin.png")
    text = path.read_text()
    path.write_text(text + "".join(f"o part{i}\nusemtl m\nf 1/1 2/2 3/3\n" for i in range(5)))
    pieces = read_pieces(path, 1.0)
    visuals: list[Any] = [each.source.visual for each in pieces]
    assert len(visuals) > 3 and len({id(each.material.image) for each in visuals}) == 1
    assert visuals[0].material.image.size == (4096, 8)


def test_an_image_of_another_format_and_an_address_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "skin.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9000 9000\n")
    for name in ("skin.png", "https://example.test/skin.png", "//example.test/skin.png"):
        image = _texture_of(_textured(tmp_path, name))
        assert image is None or max(image.size) <= 2


def test_the_limit_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"")
    os.truncate(tmp_path / "a.ply", 2**30)
    with pytest.raises(InputError, match=r"more than the 67\.1 MB that a mesh may have"):
        open_mesh(tmp_path / "a.ply")
    (tmp_path / "a.obj").write_bytes(b"# " + b"x" * 17_000_000)
    with pytest.raises(InputError, match="a text of 17 MB"):
        open_mesh(tmp_path / "a.obj")
