"""Training of the descriptor of surface patches."""

from pydantic import Field

from polhode.config.scene.values import NonNegative, Positive, Share
from polhode.config.section import Section


class DescriptorTraining(Section):
    """Pairs of patches of one surface point, seen in two frames of a scene."""

    batch: int = Field(256, ge=4)
    """Pairs of patches a step."""
    scenes_a_batch: int = Field(8, ge=1)
    """Frame pairs that a batch is drawn from: points of the same pair are the hard negatives."""
    most_turn_deg: Positive = 75.0
    """Largest angle between the two views of a point [deg]."""
    normal_noise_deg: NonNegative = 10.0
    """Standard deviation of the error of the surface's normal [deg]."""
    fronto_parallel: Share = 0.1
    """Share of the patches cut as if the surface faced the camera."""
    place_noise_px: NonNegative = 0.5
    """Standard deviation of the patch's place in the image [px], each axis."""
    scale_noise: NonNegative = 0.08
    """Standard deviation of the logarithm of the patch's scale."""
    angle_noise_deg: NonNegative = 6.0
    """Standard deviation of the error of the patch's orientation, beyond that of finding it [deg]."""
