"""PLY, STL and OBJ. Comments are lines of ASCII; lengths are multiplied by ``per_m`` (1000: millimetres)."""

from collections.abc import Sequence

import numpy as np

from polhode.files.ply import surface_ply
from polhode.planning.exports.records import ExportShape


def ply(shape: ExportShape, comments: Sequence[str], per_m: float, unit: str) -> bytes:
    """Binary PLY: position, normal, colour, sigma, views, coverage; triangles with ``invented``.

    The property of sigma is ``sigma_m`` or ``sigma_mm``: its unit is in its name.
    """
    return surface_ply(
        vertices=per_m * shape.vertices,
        normals=shape.normals,
        rgba=shape.rgba,
        sigma=per_m * shape.sigma_m,
        views=shape.views,
        coverage=shape.coverage,
        faces=shape.faces,
        invented=shape.invented,
        comments=[ascii_line(text) for text in comments],
        unit=unit,
    )


def stl(shape: ExportShape, comment: str, per_m: float) -> bytes:
    """Binary STL: triangles alone; the header holds the first 80 bytes of the comment."""
    corners = (per_m * shape.vertices)[shape.faces].astype("<f4")
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
    facets["normal"] = normal / np.where(length > 0.0, length, 1.0)
    facets["corner"] = corners
    # a binary file that begins with "solid" would be taken for a text one
    header = f"binary STL; {ascii_line(comment)}".encode("ascii")[:80].ljust(80)
    return header + np.uint32(len(facets)).tobytes() + facets.tobytes()


def obj(shape: ExportShape, comments: Sequence[str], per_m: float) -> bytes:
    """Wavefront OBJ with normals; vertex lines end with red, green, blue in 0..1, as is common."""
    lines = [f"# {ascii_line(text)}" for text in comments]
    positions = (per_m * shape.vertices).tolist()
    colours = np.round(shape.rgba[:, :3] / 255.0, 4).tolist()
    lines += [
        f"v {x:.9g} {y:.9g} {z:.9g} {r:g} {g:g} {b:g}"
        for (x, y, z), (r, g, b) in zip(positions, colours, strict=True)
    ]
    if len(shape.faces):
        lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in shape.normals.tolist()]
        for name, chosen in (("surface", ~shape.invented), ("invented", shape.invented)):
            if chosen.any():
                lines.append(f"g {name}")
            lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (shape.faces[chosen] + 1).tolist()]
    else:
        lines += [f"p {k + 1}" for k in range(len(positions))]
    return ("\n".join(lines) + "\n").encode("ascii")


def ascii_line(text: str) -> str:
    """One line of ASCII; other characters become question marks."""
    return " ".join(text.split()).encode("ascii", "replace").decode("ascii")
