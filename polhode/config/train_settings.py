"""Settings of ``polhode train``: the task, the scenes, the schedule."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import Section, Share

Family = Literal["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat", "asteroid"]
_Positive = Annotated[float, Field(ge=1e-3, le=1e6)]
_FromZero = Annotated[float, Field(ge=0, le=1e6)]
Range = tuple[_Positive, _Positive]
RangeFromZero = tuple[_FromZero, _FromZero]


class Corpus(Section):
    """Random scenes. Ranges are (smallest, largest); the values of each scene are drawn by the seed."""

    folder: str = "runs/corpus"
    """Folder of the sequences; missing ones are rendered."""
    seed: int = Field(0, ge=0, le=10**12)
    """Seed of the scenes: the same seed and ranges give the same bytes."""
    scenes: int = Field(100, ge=2, le=100_000)
    """Number of scenes. Scene i does not depend on how many there are."""
    frames: int = Field(10, ge=3, le=10_000)
    """Stereo pairs in a scene."""
    validation_every: int = Field(8, ge=2, le=100_000)
    """One scene in this number is held out for validation: its body is not used in training."""
    families: tuple[Family, ...] = Field(
        ("free_flyer", "bus", "upper_stage", "cubesat", "asteroid"), min_length=1
    )
    """Shapes, taken in turn."""
    texture: Literal["drawn", "collage"] = "drawn"
    """Generator of the textures; the other one is reserved for tests."""
    other_material: Share = 0.35
    """Share of the scenes whose body is covered by one material, drawn at random."""
    contrast: Range = (0.5, 1.3)
    """Factor on the texture's variation of reflectance."""
    size_m: Range = (0.2, 0.6)
    """Size of the body, as ``scene.body.size_m`` [m]."""
    span_px: Range = (170.0, 430.0)
    """Diameter in the image of the sphere around the bulk of the body, without antennas [px]."""
    disparity_px: Range = (25.0, 110.0)
    """Disparity of the body's middle, which sets the baseline [px]."""
    turn_deg: Range = (15.0, 50.0)
    """Rotation between frames, about a random axis [deg]."""
    sun_phase_deg: RangeFromZero = (10.0, 105.0)
    """Angle at the target between the Sun and the camera [deg]."""
    hard_light: Share = 0.5
    """Share of the scenes with almost no light from the Earth: black shadows."""
    earth: RangeFromZero = (0.02, 0.25)
    """Radiance of the Earth in the other scenes, as ``scene.light.earth``."""
    lamp: Share = 0.12
    """Share of the scenes with a lamp beside the camera."""
    white_dn: Range = (320.0, 900.0)
    """Exposure, as ``scene.sensor.white_dn`` [DN]."""
    exposure_ms: RangeFromZero = (0.0, 4.0)
    """Exposure time [ms]; frames are one second apart."""
    electrons_per_dn: Range = (8.0, 60.0)
    """Conversion gain, which sets the shot noise [electrons/DN]."""
    read_noise_dn: RangeFromZero = (0.5, 2.5)
    """Standard deviation of the read noise [DN]."""
    blur_px: RangeFromZero = (0.3, 0.8)
    """Standard deviation of the lens blur [px]."""
    stars: Share = 0.4
    """Share of the scenes with stars."""
    earth_behind: Share = 0.1
    """Share of the scenes with the Earth's disc in the background."""
    scattered: bool = True
    """Scatter the rays of each pixel, as ``scene.render.scattered``: the network should not learn by how much
    the pattern of the rays displaces edges."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, tuple) and isinstance(value[0], float) and value[0] > value[1]:
                raise ValueError(f"{name} is (smallest, largest), got {value[0]:g}, {value[1]:g}")
        return self

    def is_validation(self, scene: int) -> bool:
        """Whether scene ``scene``, counted from 0, is held out."""
        return scene % self.validation_every == self.validation_every - 1


class Schedule(Section):
    """AdamW with a warm-up, then cosine decay to zero."""

    steps: int = Field(5000, ge=1, le=10**9)
    """Number of steps; the learning rate reaches zero there."""
    learning_rate: float = Field(2e-3, ge=1e-9, le=10)
    """Largest learning rate."""
    warmup_steps: int = Field(100, ge=0, le=10**9)
    """Steps over which the learning rate grows from zero."""
    time_limit_s: float | None = Field(None, ge=1e-9, le=1e9)
    """Stop after this time in one call [s], with a checkpoint; the same command continues from it."""
    checkpoint_every: int = Field(250, ge=1, le=10**9)
    """Steps between checkpoints."""
    validate_every: int = Field(500, ge=1, le=10**9)
    """Steps between validations on the held-out bodies."""
    log_every: int = Field(20, ge=1, le=10**9)
    """Steps between points of the curves."""
    device: Literal["automatic", "cpu", "cuda"] = "automatic"
    """Device of the network; automatic: a GPU if there is one."""
    precision: Literal["automatic", "full", "mixed"] = "automatic"
    """Mixed: products in 16 bits, sums in 32. Automatic: mixed on a GPU. On a CPU it is faster if the
    processor multiplies in bfloat16."""
    threads: int = Field(1, ge=1, le=1024)
    """Threads of torch on the CPU. The weights' last bits depend on it."""


class DescriptorTraining(Section):
    """Pairs of patches of one surface point, seen in two frames of a scene."""

    batch: int = Field(256, ge=4, le=100_000)
    """Largest number of pairs of patches in a step: frames with few common points give fewer."""
    frame_pairs: int = Field(4, ge=1, le=10_000)
    """Pairs of frames from which a batch is drawn: points of the same pair are the hard negatives."""
    normal_noise_deg: float = Field(8.0, ge=0, le=90)
    """Error of the surface's normal, rms [deg]."""
    fronto_parallel: Share = 0.05
    """Share of the patches cut as if the surface faced the camera."""
    place_noise_px: float = Field(0.5, ge=0, le=100)
    """Standard deviation of the patch's position in the image [px], each axis."""

    @model_validator(mode="after")
    def _pairs_fit(self) -> Self:
        if self.frame_pairs > self.batch:
            raise ValueError(f"frame_pairs is {self.frame_pairs}, more than the batch of {self.batch}")
        return self


class DepthTraining(Section):
    """Crops of stereo pairs with their classical disparity and the true one."""

    cache: str = "runs/depth_samples"
    """Folder of the matched pairs, about 5 MB each; missing ones are computed."""
    every: int = Field(1, ge=1, le=100_000)
    """Use one in this number of the pairs of a scene."""
    batch: int = Field(4, ge=1, le=4096)
    """Crops in a step."""
    crop_px: int = Field(192, ge=32, le=4096, multiple_of=16)
    """Side of a crop [px]."""
    validation_samples: int = Field(24, ge=1, le=100_000)
    """Number of held-out pairs that are scored."""
    half_on_cpu: bool = False
    """Compute in bfloat16 on a CPU; several times faster where the CPU has instructions for it (AMX)."""


class SurfaceLoss(Section):
    """Weights of the terms of the surface network's loss, beside that of its descriptors."""

    score: float = Field(1.0, ge=0, le=1e6)
    """Of the map of landmarks."""
    place: float = Field(0.5, ge=0, le=1e6)
    """Of the landmarks' places and their standard deviations."""
    light: float = Field(0.2, ge=0, le=1e6)
    """Of the kind of light."""
    motion: float = Field(1.0, ge=0, le=1e6)
    """Factor on the terms of matches and motion."""
    consistency: float = Field(0.3, ge=0, le=1e6)
    """Of the places of one landmark in two images."""


class MoreBodies(Section):
    """Bodies of another corpus."""

    corpus: Corpus
    """What they are drawn from."""
    bodies: int = Field(ge=1, le=100_000)
    """Number of bodies: the first ones of the corpus."""
    weight: int = Field(1, ge=1, le=100)
    """How many times as often as the others these bodies are drawn."""


class SurfaceTraining(Section):
    """Bodies of the corpus from several poses, each under several Suns, for the surface network."""

    bodies: int = Field(500, ge=2, le=100_000)
    """Number of bodies: the first ones of the corpus."""
    more: tuple[MoreBodies, ...] = ()
    """Bodies of other corpora, which are learned from beside those of ``train.corpus``; those held out are
    left out."""
    suns: int = Field(3, ge=2, le=100)
    """Suns, each with an exposure and other lights of its own, under which every pose is rendered."""
    poses: int = Field(3, ge=2, le=100)
    """Poses of a body, ``corpus.turn_deg`` apart."""
    pairs: int = Field(3, ge=1, le=1000)
    """Pairs of images in a step."""
    kinds: tuple[Share, Share, Share] = (0.3, 0.35, 0.35)
    """Shares of the pairs that differ in light alone, in pose alone, in both."""
    wide: Share = 0.0
    """Share of the pairs of different poses that are the first and the last one, the farthest apart."""
    points: int = Field(128, ge=8, le=100_000)
    """Largest number of landmarks of a pair."""
    crop_px: int = Field(208, ge=32, le=4096, multiple_of=8)
    """Largest side of an image; a part of a larger one is used."""
    loss: SurfaceLoss = SurfaceLoss()

    @model_validator(mode="after")
    def _kinds_are_shares(self) -> Self:
        if abs(sum(self.kinds) - 1.0) > 1e-6:
            raise ValueError(f"kinds add up to {sum(self.kinds):g} instead of 1")
        return self


class Train(Section):
    """Training of one network of the front end."""

    task: Literal["descriptor", "depth", "surface"] = "descriptor"
    """Which network: the descriptor of surface patches, the one that refines disparities, or the one that
    finds, judges and describes points of the surface."""
    output: str = "runs/train"
    """Folder of the results: checkpoint, curves, weights, scores. A training that was begun there
    continues."""
    start_from: str | None = None
    """Weights from which the training starts, a safetensors file of the same network; null: random ones."""
    corpus: Corpus = Corpus()
    schedule: Schedule = Schedule()
    descriptor: DescriptorTraining = DescriptorTraining()
    depth: DepthTraining = DepthTraining()
    surface: SurfaceTraining = SurfaceTraining()
