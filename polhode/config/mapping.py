"""Settings of the dense model."""

from polhode.config.section import Section


class Mapping(Section):
    """Depth and motion to a mesh."""

    voxel_mm: float | None = None
    """Edge of a voxel [mm]; chosen from the data when absent."""
