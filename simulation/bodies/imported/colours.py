"""Colours and gloss in a mesh file: images, base colours, colours of vertices and faces.

Reflectance is linear grey: sRGB is decoded (IEC 61966-2-1) and weighted as in Rec. ITU-R BT.709. Factors and
vertex colours of GLB are linear as its specification says; those of the other formats are taken as sRGB.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from polhode.lie import Array
from polhode.simulation.bodies.imported.reading import FilePiece
from polhode.simulation.bodies.parts.file_colours import FileColours

REC_709 = np.array([0.2126, 0.7152, 0.0722])
MAX_IMAGE_PX = 4096
"""Images are reduced to at most this many pixels per side."""


@dataclass(frozen=True)
class FileAppearance:
    """What a file says of a piece's surface; None: nothing."""

    colours: FileColours | None = None
    """Colours that differ over the piece"""
    reflectance: float | None = None
    """One colour for all of it"""
    metallic: float | None = None
    roughness: float | None = None


def linear_grey(rgb: Array, encoded: bool = True) -> Array:
    """Colours (..., 3) in [0, 1], sRGB when ``encoded`` -> reflectance (...,)."""
    colour = np.clip(np.asarray(rgb, dtype=np.float64), 0.0, 1.0)
    if encoded:
        colour = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return np.asarray(colour @ REC_709)


def file_appearance(piece: FilePiece, glb: bool) -> FileAppearance:
    """What the file says of a piece; ``glb``: colours beside images are linear."""
    visual = piece.source.visual
    if isinstance(visual, TextureVisuals):
        return _of_texture(piece, visual, glb)
    if isinstance(visual, ColorVisuals) and visual.kind is not None:
        if visual.kind == "face":
            values = np.repeat(_grey(visual.face_colors, not glb)[piece.faces, None], 3, axis=1)
        else:
            values = _grey(visual.vertex_colors, not glb)[piece.corners]
        return _varying(values)
    return FileAppearance()


def _varying(corners: Array) -> FileAppearance:
    if np.ptp(corners) < 1e-3:
        return FileAppearance(reflectance=float(corners.mean()))
    absent = FileColours.absent(len(corners))
    return FileAppearance(colours=FileColours(corners, absent.face_image, absent.corner_uv))


def _grey(colours: ArrayLike, encoded: bool) -> Array:
    """Colours (n, 3 or 4), bytes or numbers in [0, 1] -> reflectance (n,)."""
    values = np.asarray(colours)
    scale = 255.0 if values.dtype == np.uint8 else 65535.0 if values.dtype == np.uint16 else 1.0
    return linear_grey(np.atleast_2d(values)[:, :3] / scale, encoded)


def _of_texture(piece: FilePiece, visual: TextureVisuals, glb: bool) -> FileAppearance:
    material = visual.material
    if isinstance(material, PBRMaterial):
        image, factor = material.baseColorTexture, material.baseColorFactor
        base = None if factor is None else float(_grey(factor, not glb)[0])
        metallic, roughness = material.metallicFactor, material.roughnessFactor
    elif isinstance(material, SimpleMaterial):
        image, metallic = material.image, None
        given = "kd" in material.kwargs
        base = float(_grey(material.diffuse, True)[0]) if given else None
        roughness = _roughness_of_phong(material.kwargs.get("ns"))
    else:
        return FileAppearance()
    if image is not None and max(image.size) <= 2 and isinstance(material, SimpleMaterial):
        # trimesh supplies a tiny grey image if the file names none.
        image = None
    uv = None if visual.uv is None else np.asarray(visual.uv, dtype=np.float64)
    if image is None or uv is None or len(uv) != len(piece.source.vertices) or not np.isfinite(uv).all():
        vertex = visual.vertex_attributes.get("color") if hasattr(visual, "vertex_attributes") else None
        if vertex is not None and len(vertex) == len(piece.source.vertices):
            return _varying(_grey(vertex, not glb)[piece.corners])
        return FileAppearance(None, base, metallic, roughness)
    # A Kd that is zero or absent beside an image is an artefact of exporters, not a black surface.
    factor_on_image = base if glb and base is not None else 1.0
    count = len(piece.faces)
    colours = FileColours(
        np.full((count, 3), factor_on_image),
        np.zeros(count, dtype=np.int64),
        uv[piece.corners],
        (_reflectance_of_image(image),),
    )
    return FileAppearance(colours, None, metallic, roughness)


def _reflectance_of_image(image: Image.Image) -> NDArray[np.float32]:
    reduced = image.convert("RGB")
    reduced.thumbnail((MAX_IMAGE_PX, MAX_IMAGE_PX))
    table = linear_grey(np.repeat(np.arange(256)[:, None] / 255.0, 3, axis=1))
    # Decoding a byte is a appearance-up; the weights add up to 1.
    decoded = table[np.asarray(reduced)]
    return np.asarray(decoded @ REC_709, dtype=np.float32)


def _roughness_of_phong(exponent: object) -> float | None:
    """GGX roughness of a Phong exponent: alpha^2 = 2 / (n + 2) (Walter et al. 2007), alpha = roughness^2."""
    if not isinstance(exponent, int | float) or exponent <= 0:
        return None
    return float((2.0 / (exponent + 2.0)) ** 0.25)
