"""Settings of dense stereo."""

from typing import Literal

from pydantic import Field

from polhode.config.section import Section


class Depth(Section):
    """A rectified pair to a depth map of the target."""

    method: Literal["sgbm", "network"] = "network"
    """How the first, semi-global disparities are refined: by least squares, planes and facets, or by the
    network trained here."""
    weights: str | None = None
    """Weights of the network, a safetensors file; null: the shipped ones."""
    min_visible: float = Field(0.1, ge=0, le=1)
    """For method network: pixels that both cameras see with a smaller probability have no depth."""
    block_px: int = Field(3, ge=1)
    """Side of the window of the first, integer disparities [px], odd."""
    max_disparity_share: float = Field(0.4, gt=0, le=1)
    """Largest disparity that is searched when the range is not known, as a share of the image's width."""
    consistency_px: float = Field(1.0, gt=0)
    """Largest difference between the left and the right image's disparity [px]."""
    speckle_px: int = Field(60, ge=0)
    """Smaller patches of disparity are removed [px]."""
    window_px: int = Field(7, ge=3)
    """Side of the window of the sub-pixel refinement [px], odd."""
    refinements: int = Field(3, ge=0)
    """Rounds of sub-pixel refinement and smoothing."""
    plane_radius_px: int = Field(6, ge=1)
    """Half side of the windows in which the disparity is taken as a plane [px]."""
    facets: bool = True
    """Carry planes across even, textureless patches from what surrounds them."""
    min_intensity: float = Field(6.0, ge=0)
    """Darker pixels (over the sky's level) are unlit: no depth there."""
    max_sigma_px: float | None = Field(None, gt=0)
    """Disparities that are less certain are dropped [px]; null: 0.5 for sgbm, 0.7 for network, whose sigmas
    at edges and in holes are larger and true."""
    rim_px: int | None = Field(None, ge=0)
    """Width that is removed along the silhouette and along jumps of depth [px]; null: 2 for sgbm, 1 for
    network."""
    jump_px: float = Field(1.5, gt=0)
    """A difference of disparity between neighbours that counts as a jump [px]."""

    @property
    def largest_sigma_px(self) -> float:
        """``max_sigma_px``, or the method's own."""
        if self.max_sigma_px is not None:
            return self.max_sigma_px
        return 0.7 if self.method == "network" else 0.5

    @property
    def rim_width_px(self) -> int:
        """``rim_px``, or the method's own."""
        if self.rim_px is not None:
            return self.rim_px
        return 1 if self.method == "network" else 2
