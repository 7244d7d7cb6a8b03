"""The images of a scene's materials: few formats, a limit of pixels, each decoded once."""

import math
from collections.abc import Mapping

import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from polhode.files.foreign_meshes.structure import Unsound
from polhode.files.images import MAX_PIXELS

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
MAX_SIDE_PX = 4096
"""Images are reduced to at most this many pixels per side."""


class Texture(Image.Image):
    """A decoded RGB image that copies of a mesh share: trimesh would copy its pixels with every piece."""

    def copy(self) -> "Texture":
        """The same image."""
        return self

    def __copy__(self) -> "Texture":
        return self

    def __deepcopy__(self, memo: Mapping[int, object]) -> "Texture":
        return self


def share_textures(scene: trimesh.Scene) -> None:
    """Replace the images of base colours by decoded ones, and remove all others.

    An image that is damaged or of another format is removed. Raises Unsound: too many pixels.
    """
    decoded: dict[int, Texture | None] = {}
    opened: list[Image.Image] = []
    for mesh in scene.geometry.values():
        material = getattr(mesh.visual, "material", None)
        if isinstance(material, SimpleMaterial):
            name = "image"
        elif isinstance(material, PBRMaterial):
            name = "baseColorTexture"
            for other in ("emissiveTexture", "normalTexture", "occlusionTexture", "metallicRoughnessTexture"):
                setattr(material, other, None)
        else:
            continue
        image = getattr(material, name)
        if image is None or isinstance(image, Texture):
            continue
        if id(image) not in decoded:
            # kept, so that no other image gets its id
            opened.append(image)
            if sum(math.prod(each.size) for each in opened) > MAX_PIXELS:
                raise Unsound(f"images of more than {MAX_PIXELS} pixels together: reduce them")
            decoded[id(image)] = _decoded(image)
        setattr(material, name, decoded[id(image)])


def _decoded(image: Image.Image) -> Texture | None:
    # What trimesh supplies where a file names no image has no format.
    if image.format not in (*FORMATS, None):
        return None
    try:
        rgb = image.convert("RGB")
        rgb.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
    except Exception:  # noqa: BLE001  Pillow reports damage by errors of any type
        return None
    texture = Texture()
    texture.__dict__.update(rgb.__dict__)
    return texture
