"""The target: shape, surface, mass."""

from typing import Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import NonNegative, Positive, Section, Vector3


class Body(Section):
    """The target's shape and surface, in the geometric frame G."""

    family: Literal["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat", "asteroid", "mesh"] = (
        "free_flyer"
    )
    """Shape: an 18-faced free flyer, a box bus with two panels, an upper stage with its nozzle, a dish
    antenna on a small bus, an open truss with equipment, a cubesat, a small rocky body, or a mesh file."""
    size_m: Positive = 0.22
    """Width across flats (free_flyer), length without panels (bus, cubesat), length (upper_stage, truss),
    diameter of the dish (dish), or of the sphere of the same volume (asteroid) [m]; not for mesh."""
    seed: int | None = None
    """Seed of shape and surface; the config's own seed when absent."""
    path: str | None = None
    """Mesh file (OBJ, STL, PLY, GLB), for family mesh."""
    metres_per_unit: Positive | None = None
    """Length of one unit of the mesh file [m]; mandatory for family mesh, never guessed."""
    material: Literal["automatic", "paint", "solar_cell", "foil", "metal", "regolith"] = "automatic"
    """Surface: as the family or the mesh file has it, or one material for the whole body."""
    texture: Literal["drawn", "collage"] = "drawn"
    """Generator of the texture. Two that share nothing, so that training and testing can be kept apart:
    stickers, lettering and lattice noise; or overlapping shapes of all sizes and noise of random spots."""
    contrast: NonNegative = 1.0
    """Factor on the texture's variation of reflectance; 0: no texture."""

    @model_validator(mode="after")
    def _mesh_needs_path_and_unit(self) -> Self:
        if self.family == "mesh" and self.path is None:
            raise ValueError("family mesh needs 'path', the mesh file")
        if self.family == "mesh" and self.metres_per_unit is None:
            raise ValueError("family mesh needs 'metres_per_unit': the scale is never guessed")
        if self.family != "mesh" and (self.path is not None or self.metres_per_unit is not None):
            raise ValueError("'path' and 'metres_per_unit' belong to family mesh only")
        return self


class Mass(Section):
    """Mass properties: set by hand, or by the density of the parts where absent."""

    com_m: Vector3 | None = None
    """Centre of mass in G [m]; that of the parts' densities when absent."""
    inertia_kg_m2: tuple[Vector3, Vector3, Vector3] | None = None
    """Inertia about the centre of mass, axes of G [kg m^2]; that of the parts' densities when absent."""
    density_kg_m3: Positive = 1000.0
    """Density of parts that ``part_density_kg_m3`` does not name [kg/m^3]."""
    part_density_kg_m3: dict[str, Positive] = Field(default_factory=dict)
    """Density by the part's name [kg/m^3]; an unknown name is refused with the list of parts."""
    mass_kg: Positive | None = None
    """Mass [kg]; scales the inertia of the densities, and turns known forces into accelerations. That of the
    densities when absent."""
