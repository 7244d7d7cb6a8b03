"""Training of the network that refines disparities."""

from pydantic import Field

from polhode.config.section import Section


class DepthTraining(Section):
    """Crops of stereo pairs with their classical disparity and the true one."""

    cache: str = "runs/depth_samples"
    """Folder of the matched pairs, some 5 MB each; what is missing there is made."""
    every: int = Field(1, ge=1)
    """Use one pair of a scene in so many."""
    batch: int = Field(4, ge=1)
    """Crops a step."""
    crop_px: int = Field(192, ge=32, multiple_of=16)
    """Side of a crop [px]."""
    validation_samples: int = Field(24, ge=1)
    """LinearizationPoint-out pairs that are scored."""
    half_on_cpu: bool = False
    """Compute in bfloat16 on a CPU; several times faster where the CPU has instructions for it (AMX)."""
