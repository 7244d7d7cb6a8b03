"""Materials for the pieces of a mesh file: by their names, by what the file says of gloss, by chance."""

import re
from dataclasses import replace

import numpy as np

from polhode.simulation.bodies.imported.mesh_colours import Look
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    DARK_METAL,
    FOIL_BLACK,
    FOIL_GOLD,
    FOIL_SILVER,
    GLASS,
    PAINT_BLACK,
    PAINT_GREY,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
    WORN_PANEL,
    Material,
)

NAMES: tuple[tuple[str, Material], ...] = (
    (r"radiator|osr", PAINT_WHITE),
    (r"asteroid|comet|rock|regolith|terrain|lunar|moon|eros|itokawa|bennu|ryugu|67p", REGOLITH),
    (r"nozzle|engine|thruster|thr_|bell", DARK_METAL),
    (r"silver.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*silver", FOIL_SILVER),
    (r"black.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*black", FOIL_BLACK),
    (r"mli|foil|kapton|gold|blanket|insulat", FOIL_GOLD),
    (r"white|dish|antenna|reflector", PAINT_WHITE),
    (r"solar|cell|panel|array", SOLAR_CELL),
    (r"glass|lens|optic|camera|window", GLASS),
    (r"black", PAINT_BLACK),
    (r"gr[ae]y|paint", PAINT_GREY),
    (r"metal|alumin|steel|titan|strut|truss|boom|mast|hinge|rail|bolt", BRUSHED_METAL),
)
"""The first pattern that is found in a piece's name, in any case of letters, decides."""
CHOICES = (WORN_PANEL, WORN_PANEL, PAINT_WHITE, PAINT_GREY, BRUSHED_METAL)
"""Materials of separate pieces without a telling name; the largest is a worn panel, which has texture."""


def material_by_name(name: str) -> Material | None:
    """The material that a name tells of, or none."""
    for pattern, material in NAMES:
        if re.search(pattern, name, re.IGNORECASE):
            return material
    return None


def material_by_chance(largest: bool, rng: np.random.Generator) -> Material:
    """One of ``CHOICES``."""
    return WORN_PANEL if largest else CHOICES[int(rng.integers(len(CHOICES)))]


def material_with_look(material: Material, look: Look) -> Material:
    """The material with the file's own colour, metalness and roughness where it gives them.

    Metals reflect their colour at normal incidence and have little diffuse reflectance, as in glTF's model.
    """
    if look.roughness is not None:
        material = replace(material, roughness=float(np.clip(look.roughness, 0.1, 1.0)))
    if look.metallic is not None:
        metal = float(np.clip(look.metallic, 0.0, 1.0))
        colour = 0.5 if look.reflectance is None else look.reflectance
        specular = 0.04 * (1.0 - metal) + colour * metal
        return replace(material, specular=specular, albedo=max(colour * (1.0 - metal), 0.01), patch=0.0)
    if look.reflectance is None:
        return material
    if material.specular > 0.2:
        # A shiny material by its name: the colour is that of its reflection.
        return replace(material, specular=float(np.clip(look.reflectance, 0.2, 0.9)))
    return replace(material, albedo=float(np.clip(look.reflectance, 0.01, 0.95)), patch=0.0)
