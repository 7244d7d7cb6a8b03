"""Training of the descriptor of surface patches."""

from typing import Self

from pydantic import Field, model_validator

from polhode.config.scene.values import NonNegative, Positive, Share
from polhode.config.section import Section


class DescriptorTraining(Section):
    """Pairs of patches of one surface point, seen in two frames of a scene."""

    batch: int = Field(256, ge=4)
    """Pairs of patches a step, at most: frames with few common points give fewer."""
    frame_pairs: int = Field(4, ge=1)
    """Pairs of frames that a batch is drawn from: points of the same pair are the hard negatives."""
    strays: Share = 0.25
    """Key points that are no surface feature, over the number of pairs."""
    most_turn_deg: Positive = 70.0
    """Largest angle between the two views of a point [deg]."""
    half_px: tuple[Positive, Positive] = (10.0, 15.0)
    """Half the side of a patch at the scene's middle depth, least and most [px]; both patches of a pair have
    the same on the surface."""
    normal_noise_deg: NonNegative = 8.0
    """Error of the surface's normal, rms [deg]."""
    fronto_parallel: Share = 0.05
    """Share of the patches cut as if the surface faced the camera."""
    place_noise_px: NonNegative = 0.5
    """Standard deviation of the patch's place in the image [px], each axis."""
    scale_noise: NonNegative = 0.1
    """Standard deviation of the logarithm of the patch's scale."""
    reliability_weight: NonNegative = 0.3
    """Weight of the reliability's loss beside the descriptor's."""
    direction_weight: NonNegative = 0.3
    """Weight of the loss of the patches' directions."""
    matching_weight: NonNegative = 0.1
    """Weight of the loss of the soft matches."""
    motion_weight: NonNegative = 0.5
    """Weight of the loss of the motion that the soft matches tell."""
    late_from: Share = 0.6
    """Share of the steps after which matches and motion are learned from: before, too few are right."""

    @model_validator(mode="after")
    def _pairs_fit(self) -> Self:
        if self.frame_pairs > self.batch:
            raise ValueError(f"frame_pairs is {self.frame_pairs}, more than the batch of {self.batch}")
        if self.half_px[0] > self.half_px[1]:
            raise ValueError("half_px is (least, most)")
        return self
