"""Settings of the dense model."""

from typing import Literal

from pydantic import Field

from polhode.config.section import Section


class Mapping(Section):
    """Depth and motion to a mesh."""

    voxel_mm: float | None = Field(None, gt=0)
    """Edge of a voxel [mm]; chosen from the depth's footprint when absent."""
    voxel_per_footprint: float = Field(1.0, gt=0)
    """Edge of a voxel over the footprint of a pixel on the target, when ``voxel_mm`` is absent."""
    truncation_voxels: float = Field(4.0, ge=2)
    """Distance at which the field is cut off in front of the surface [voxels]."""
    truncation_behind_voxels: float = Field(3.0, ge=1)
    """The same behind the surface [voxels]; short, so that the two sides of a thin panel do not mix."""
    free_space_weight: float = Field(0.15, ge=0, le=1)
    """Weight of "this is empty" far in front of a surface, over that of the surface itself."""
    min_views: int = Field(3, ge=1)
    """A surface seen in fewer frames is left out (fewer where the sequence is shorter)."""
    min_component_area: float = Field(0.004, ge=0, lt=1)
    """Pieces of a smaller share of the whole area are removed."""
    memory_mib: float = Field(1024.0, gt=0)
    """Most memory of the field [MiB]; a larger field gets larger voxels."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the field lives; auto: a GPU when there is one."""
