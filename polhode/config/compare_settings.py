"""Settings of the comparison of optimizers (``polhode compare``)."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import Section, Seed

Motion = Literal["ts38", "flip", "minor_wobble", "major_wobble", "tumble", "slow_tumble", "fast_tumble"]

MAX_OBSERVATIONS = 20_000_000


def _once(name: str, values: Sequence[object]) -> None:
    twice = next((value for n, value in enumerate(values) if value in values[:n]), None)
    if twice is not None:
        raise ValueError(f"{name}: {twice} is named twice; name it once")


class MonteCarlo(Section):
    """Synthetic measurements with truth: one problem for each motion, number of frames and of landmarks."""

    motions: tuple[Motion, ...] = Field(("ts38",), min_length=1)
    """Bodies and motions, as in the benchmark of accuracy."""
    frames: tuple[Annotated[int, Field(ge=3, le=10_000)], ...] = Field((115,), min_length=1)
    """Stereo pairs."""
    landmarks: tuple[Annotated[int, Field(ge=10, le=1_000_000)], ...] = Field((2430,), min_length=1)
    """Points on the body; nearly all of them are observed at some time."""
    noise_px: float = Field(1.0, ge=1e-6, le=100)
    """Standard deviation of u, v and disparity [px]."""
    outliers: float = Field(0.0, ge=0, lt=0.5)
    """Share of gross errors."""
    loop_closure: bool = True
    """False: a landmark that comes back into view counts as a new one."""
    seed: Seed = 0
    """Seed of the measurements."""

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        for name in ("motions", "frames", "landmarks"):
            _once(name, getattr(self, name))
        return self

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        if max(self.frames) * max(self.landmarks) > MAX_OBSERVATIONS:
            raise ValueError(
                f"{max(self.frames)} frames of {max(self.landmarks)} landmarks are more than "
                f"{MAX_OBSERVATIONS} observations; give fewer frames or landmarks"
            )
        return self


class Compare(Section):
    """The same measurements and the same cost, minimized by many optimizers."""

    solvers: tuple[str, ...] = ()
    """Names of the solvers and of variants of the formulation, in order; none: all solvers
    (docs/compare.md lists them)."""
    limit_s: float = Field(60.0, ge=1e-9, le=1e7)
    """Time limit of one solver and start, with the start of its process [s]."""
    total_s: float = Field(900.0, ge=1e-9, le=1e8)
    """Time limit of the comparison [s]; solvers that have not started by then get a row that states so."""
    process_noise: Literal["given", "estimated"] = "given"
    """Disturbances of the compared cost: those stated in backend.accel_psd and torque_psd, or those
    estimated, which for a nearly undisturbed motion make the cost so stiff that few solvers converge from a
    cold start."""
    cold: bool = True
    """Solve from the cold start."""
    perturbed: int = Field(0, ge=0, le=10_000)
    """Number of starts with random errors added to the cold one, seeds 0, 1, ..."""
    near: int = Field(0, ge=0, le=10_000)
    """Number of starts near the solution."""
    monte_carlo: MonteCarlo = MonteCarlo()
    """Measurements when neither --data nor --run is given."""

    @model_validator(mode="after")
    def _starts_are_asked_for(self) -> Self:
        if not (self.cold or self.perturbed or self.near):
            raise ValueError("no start is selected: set cold to true, or perturbed or near to at least 1")
        return self

    @model_validator(mode="after")
    def _solvers_once(self) -> Self:
        _once("solvers", self.solvers)
        return self
