"""Settings of the front end."""

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import Section
from polhode.files.foreign_files import GIB, sha256_of

MAX_WEIGHTS_BYTES = 4 * GIB
"""Of a file of weights"""


class Features(Section):
    """Key points and descriptors."""

    method: Literal["rootsift", "polhode"] = "rootsift"
    """Detector and descriptor: RootSIFT, or the network trained here."""
    second: Literal["rootsift", "polhode"] | None = "polhode"
    """A second method, used where the first one leaves frames with too few observations or finds no motion:
    the observations of both are solved together, and kept unless the fit is worse. null, or the same as the
    first: none."""
    second_below: int = Field(100, ge=0, le=10**9)
    """The second method is used when the median frame has fewer observations, or one frame in twenty is lost;
    a large number: always."""
    surface_descriptor: Literal["surface", "network"] = "network"
    """How points of the surface are found and described (method polhode). network: blobs, and
    descriptors of their patches; surface: landmarks and descriptors of the surface network, in half the
    time."""
    patch_half_m: float | None = Field(None, ge=1e-6, le=1e4)
    """Half the side of a surface patch [m] (method polhode); null: 12 px at the target's median distance."""
    max_features: int = Field(1500, ge=50, le=100_000)
    """Number of strongest key points that are kept in one image."""
    contrast_threshold: float = Field(0.012, ge=1e-6, le=1)
    """SIFT's contrast threshold, on intensities stretched to the target's own range."""
    upsample: float = Field(2.0, ge=1.0, le=8.0)
    """Enlargement of the target's crop before detection."""
    max_crop_px: int = Field(900, ge=64, le=8192)
    """Longest side of the enlarged crop [px]; larger targets are enlarged less."""


class PairMatching(Section):
    """Frame to frame, without a prediction: descriptors, then RANSAC on absolute orientation (thesis 2.7,
    6.3)."""

    method: Literal["polhode", "nearest"] | None = None
    """Ours, or mutual nearest neighbours; null: ours for our features, nearest neighbours for RootSIFT."""
    ratio: float = Field(0.92, ge=0.01, le=1)
    """Distance ratio of mutual nearest neighbours; for method nearest."""
    min_confidence: float = Field(0.1, ge=0, le=1)
    """Smallest confidence of a match; for all methods except nearest, and not for features of method polhode,
    where all matches that agree on the motion count."""
    exhaustive_frames: int = Field(130, ge=3, le=10_000)
    """Sequences of up to this number of frames are matched all against all; longer ones as follows."""
    neighbours: int = Field(20, ge=1, le=10_000)
    """Number of frames before and after each frame that it is matched with, in long sequences."""
    retrieved: int = Field(30, ge=0, le=10_000)
    """Number of most similar frames elsewhere with which it is also matched, to close loops."""
    motions: int = Field(6, ge=1, le=12)
    """Number of motions of two frames that are kept until the whole sequence decides (method polhode, and
    nearest for RootSIFT), where frames that show the same side match hardly better than others: light that
    stands still hides the motion of the body, or parts are alike. 1: only the motion with most support."""


class GuidedMatching(Section):
    """Association with the predicted motion, to recover frames that matching without a prediction lost."""

    rounds: int = Field(2, ge=1, le=100)
    """Largest number of times that lost frames are searched for and the motion is solved."""
    max_view_angle_deg: float = Field(45.0, ge=0.01, le=90)
    """Largest change of viewing direction between descriptors that are compared [deg]."""
    max_distance: float = Field(0.65, ge=1e-3, le=10)
    """Largest descriptor distance of an accepted association, for features without a known surface."""


class Tracks(Section):
    """Landmarks for the back end: the longest tracks, until every frame has enough."""

    enough_per_frame: int = Field(200, ge=10, le=1_000_000)
    """Observations in a frame beyond which only landmarks that other frames need are added."""


class Weights(Section):
    """Files with the weights of networks; null: the shipped ones."""

    descriptor: str | None = None
    """Our descriptor; null: the shipped one."""
    surface: str | None = None
    """Our surface network; null: the shipped one."""


class Depth(Section):
    """A rectified pair to a depth map of the target."""

    method: Literal["sgbm", "network"] = "network"
    """Refinement of the initial, semi-global disparities: by least squares, planes and facets, or by the
    network trained here."""
    weights: str | None = None
    """Weights of the network, a safetensors file; null: the shipped ones."""
    min_visible: float = Field(0.1, ge=0, le=1)
    """For method network: smallest probability that both cameras see a pixel that has depth."""
    block_px: int = Field(3, ge=1, le=51)
    """Side of the window of the initial, integer disparities [px], odd."""
    max_sigma_px: float | None = Field(None, ge=1e-3, le=1e3)
    """Largest standard deviation of a disparity that is kept [px]; null: 0.5 for sgbm, 0.7 for network, whose
    sigmas at edges and in holes are larger and consistent."""

    @model_validator(mode="after")
    def _window_has_a_middle(self) -> Self:
        if self.block_px % 2 == 0:
            raise ValueError(f"block_px {self.block_px}: give an odd number, so that the window has a middle")
        return self

    @property
    def largest_sigma_px(self) -> float:
        """``max_sigma_px``, or the method's own."""
        if self.max_sigma_px is not None:
            return self.max_sigma_px
        return 0.7 if self.method == "network" else 0.5


class Frontend(Section):
    """Images to stereo measurements, tracks and depth."""

    features: Features = Features()
    pairs: PairMatching = PairMatching()
    guided: GuidedMatching = GuidedMatching()
    tracks: Tracks = Tracks()
    depth: Depth = Depth()
    weights: Weights = Weights()

    @property
    def matcher(self) -> str:
        """Name of the method that matches frames."""
        own = "polhode" if self.features.method == "polhode" else "nearest"
        return self.pairs.method or own

    @property
    def with_digests(self) -> tuple["Frontend", tuple[str, ...]]:
        """The settings, and the digests of the files of weights that they name."""
        named = [*self.weights.model_dump().values(), self.depth.weights]
        files = [Path(name) for name in named if name is not None]
        return self, tuple(sha256_of(file, MAX_WEIGHTS_BYTES, "weights") for file in files)

    @property
    def for_features(self) -> "Frontend":
        """The settings that the features of a pair depend on; the others at their defaults."""
        features = self.features.model_copy(update={"second": None, "second_below": 0})
        depth = self.depth if self.features.method == "polhode" else Depth()
        pairs = PairMatching(method=self.pairs.method)
        return Frontend(features=features, pairs=pairs, depth=depth, weights=self.weights)

    @property
    def for_matching(self) -> "Frontend":
        """The settings that the matches of two frames depend on; the others at their defaults."""
        features = self.features.model_copy(update={"second": None, "second_below": 0})
        chosen = ("exhaustive_frames", "neighbours", "retrieved", "motions")
        pairs = self.pairs.model_copy(update={name: getattr(PairMatching(), name) for name in chosen})
        return Frontend(features=features, pairs=pairs, weights=self.weights)

    @property
    def second_method(self) -> "Frontend | None":
        """The settings for the second method, with its own matcher."""
        second = self.features.second
        if second is None or second == self.features.method:
            return None
        features = self.features.model_copy(update={"method": second, "second": None})
        pairs = self.pairs.model_copy(update={"method": None})
        return self.model_copy(update={"features": features, "pairs": pairs})
