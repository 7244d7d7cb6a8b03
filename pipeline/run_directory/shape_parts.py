"""Parts of summary.json about the dense model: the mesh, what of the body was seen, mass against volume."""

from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from polhode.pipeline.run_directory.summary_parts import Assumed, Finite, Matrix, Part, Variance, Vector


class MeshLevel(Part):
    """A lighter mesh for planners and viewers."""

    file: str
    faces: int
    largest_distance_m: Finite
    """Largest distance between points of either mesh and the other, of those looked at."""
    mean_distance_m: Finite


class Sun(Part):
    """The Sun, from how the turning surface brightens and darkens."""

    direction_N: Vector
    """Unit vector from the target towards the Sun."""
    sigma_deg: Variance
    """Standard deviation along each of two axes across it; null: the direction was not used."""
    explained: Finite
    """Share of the vertices' changes of brightness that Lambert's law explains."""
    frames_in_light: int
    """Of the frames looked at, those in which the Sun shone."""


class Mesh(Part):
    """mesh.ply."""

    vertices: int
    faces: int
    closed: bool
    """Whether it encloses a volume."""
    holes_closed: int
    """Small holes that were closed; their faces are flagged as invented."""
    holes_left_open: int
    """Small holes that frames looked through, or that no sound surface closes."""
    invented_faces: int
    invented_share: Finite
    """Of the area."""
    colour: Literal["albedo", "intensity"]
    """albedo: the Sun's shading was divided out; intensity: averages of the images."""
    grey_per_albedo: Finite
    """Grey of a vertex over the grey that it would show facing the Sun; 1 for intensity."""
    sun: Sun | None
    """The light that fits best, used or not; null: nothing can be told."""
    levels: tuple[MeshLevel, ...]
    frames_doubtful: int = Field(0, ge=0)
    """Frames whose poses the motion knows poorly against what their depth tells."""
    frames_aligned: int = Field(0, ge=0)
    """Of these, those that were aligned to the surface of the other frames."""


class Coverage(Part):
    """How much of the body was seen: shares of the mesh's area, or of its convex hull's where it is open."""

    seen: Finite = Field(ge=0, le=1)
    """Seen in light."""
    seen_unlit: Finite = Field(ge=0, le=1)
    """Seen, but never in light."""
    unseen: Finite = Field(ge=0, le=1)
    of: Literal["mesh", "hull"]
    """What the shares are of."""
    unseen_direction_G: Vector | None
    """Unit vector around which the unseen part faces; null: none, or all around."""
    words: str


class Physics(Part):
    """The mesh at uniform density against the motion's mass properties; null: not determined."""

    words: list[str]
    """What agrees and what differs; nothing is said about what the motion does not determine."""
    volume_m3: Finite
    com_uniform_G: Vector
    """[m]"""
    com_offset_G: Vector | None
    """Estimate minus uniform density, of the components that are determined [m]."""
    com_offset_sigma_m: Variance
    """Of the estimate, along the offset."""
    R_GP_uniform: Matrix
    axes_angle_deg: Finite | None
    """Smallest rotation between the axes that are determined; half-turns are none."""
    axes_angle_sigma_deg: Variance
    k1_uniform: Finite
    k2_uniform: Finite
    k1_difference: Finite | None
    """Estimate minus uniform density."""
    k2_difference: Finite | None


@dataclass(frozen=True)
class ShapeFindings:
    """All of these; None where a step failed or had no surface."""

    mesh: Mesh | None = None
    coverage: Coverage | None = None
    physics: Physics | None = None
    assumed: Assumed | None = None
    warnings: tuple[str, ...] = ()
