"""Settings of the dense model."""

from typing import Annotated

from pydantic import Field

from polhode.config.section import Section


class Mapping(Section):
    """Depth and motion to a mesh."""

    voxel_mm: float | None = Field(None, ge=1e-3, le=1e6)
    """Edge of a voxel [mm]; by default the footprint of a pixel on the target."""
    min_views: int = Field(3, ge=1, le=100_000)
    """A surface seen in fewer frames is omitted (fewer if the sequence is shorter), unless two agree."""
    agreeing_voxels: float = Field(0.7, ge=0, le=1e3)
    """Two frames are enough where their distances to the surface scatter by less [voxels]."""
    scatter_voxels: float = Field(1.6, ge=1e-3, le=1e6)
    """Where frames scatter by more [voxels], and by more than twice the usual scatter, the field is
    unknown."""
    carved_share: float = Field(0.3, ge=0, le=1)
    """A surface is left out where frames that look through it have a larger share of the weight."""
    align: bool = True
    """Align frames with uncertain poses to the surface that the others show."""
    hole_share: float = Field(0.04, ge=0, le=0.3)
    """Holes up to this diameter, as a share of the diagonal of the body's bounding box, are closed, and their
    faces flagged as invented; larger ones remain open. 0: none is closed."""
    divide_shading: bool = True
    """Divide the Sun's shading out of the colours, where the images determine the Sun's direction."""
    levels: tuple[Annotated[float, Field(ge=1e-6, lt=1)], ...] = Field((0.25, 0.0625), max_length=10)
    """Shares of the faces that the lighter meshes keep: mesh_lod1.glb, mesh_lod2.glb, ...; (): none."""
    shared_sigma: float = Field(0.45, ge=0, le=10)
    """Share of a frame's sigma that is common to frames that look from the same direction, and does not
    average out over them."""
    relief_sigma: float = Field(1.8, ge=0, le=1e3)
    """Sigma of the relief that matching in windows smooths away, relative to the remaining roughness."""
    border_sigma: float = Field(0.31, ge=0, le=1e3)
    """Sigma of vertices at the border of the surface, which lies beside the body's edge [voxels]."""
    memory_mib: float = Field(1024.0, ge=0.1, le=1e7)
    """Largest memory of the field [MiB]; a larger field gets larger voxels. What still does not fit is
    omitted, with a warning."""

    @property
    def for_fusion(self) -> "Mapping":
        """The settings that the fused surface depends on; those of its finishing at their defaults."""
        chosen = ("hole_share", "divide_shading", "levels")
        return self.model_copy(update={name: getattr(Mapping(), name) for name in chosen})
