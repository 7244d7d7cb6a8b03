"""Parts of summary.json: the numbers of a run by topic, each a frozen model of its own."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Variance = Finite | None
"""null: undetermined."""
Vector = tuple[Finite, Finite, Finite]
Matrix = tuple[Vector, Vector, Vector]
VarianceRow = tuple[Variance, Variance, Variance]
VarianceMatrix = tuple[VarianceRow, VarianceRow, VarianceRow]
Flags = tuple[bool, bool, bool]
Status = Literal["ok", "degraded", "failed"]


class Part(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, populate_by_name=True
    )


class Timing(Part):
    """Wall-clock seconds of each stage; 0 where a stage was not reached."""

    frontend: Finite = 0.0
    initialization: Finite = 0.0
    backend: Finite = 0.0
    depth: Finite = 0.0
    fusion: Finite = 0.0
    report: Finite = 0.0
    total: Finite = 0.0


class Inertia(Part):
    """Mass distribution up to scale; moments sorted Jxx >= Jyy >= Jzz, the middle one 1."""

    k1: Finite
    """ln(Jxx / Jyy)"""
    k2: Finite
    """ln(Jyy / Jzz)"""
    cov: tuple[tuple[Variance, Variance], tuple[Variance, Variance]]
    """Covariance of (k1, k2)."""
    J_G: Matrix
    """About the centre of mass, axes of G."""
    cov_J: tuple[tuple[Variance, Variance, Variance, Variance, Variance], ...] = Field(
        min_length=5, max_length=5
    )
    """In the solver's five parameters."""
    moments: Vector
    sigma_moments: VarianceRow = (None, 0.0, None)
    """null: undetermined; the middle one is the unit."""
    mass_kg: Finite | None = None
    """From known forces; null: none are known."""
    sigma_mass_kg: Variance = None
    """null: undetermined, or no force is known."""
    scale_kg_m2: Finite | None = None
    """From known torques, the middle moment: times J_G it is the inertia in kg m^2; null: none are known."""
    sigma_scale_kg_m2: Variance = None
    """null: undetermined, or no torque is known."""


class Identifiable(Part):
    """com and axes are true only when every component is determined."""

    k1: bool
    k2: bool
    com: bool
    axes: bool


class IdentifiableComponents(Part):
    """Each component by itself, along (about) the principal axes x, y, z of P."""

    com_P: Flags
    axes_P: Flags


class Solver(Part):
    """How the optimisation ended."""

    name: str
    iterations: int
    cost: Finite
    converged: bool
    reduced_chi2: Finite | None
    message: str = ""
    runner_up: dict[str, Variance] = {}
    """Cost of the other hypotheses, by name, minus that of the one chosen; null: did not end."""


class Noise(Part):
    """Noise that the estimate was made with."""

    pixel_sigma_px: Finite
    disparity_sigma_px: Finite
    accel_psd: Finite
    """[(m/s^2)^2/Hz]"""
    torque_psd: Finite
    """[(rad/s^2)^2/Hz], torque over the middle moment."""


class UnknownPush(Part):
    """What unknown forces and torques did over steps that follow each other; pushes.csv has each step."""

    start_s: Finite
    """Seconds since the first pair."""
    end_s: Finite
    delta_v_N: Vector
    """Change of velocity [m/s]."""
    sigma_delta_v_N: VarianceRow
    delta_w_P: Vector
    """Changes of angular velocity, added up along the principal axes [rad/s]."""
    sigma_delta_w_P: VarianceRow
    """null: the axes are undetermined."""


class Assumed(Part):
    """What uniform density says; never mixed with the estimates. null: determined by the motion."""

    words: list[str]
    """What was assumed, and where each number comes from."""
    volume_m3: Finite
    density_kg_m3: Finite
    mass_kg: Finite
    inertia_kg_m2: Matrix
    """About the centre of mass, axes of G."""
    com_G: Vector | None
    """[m]; the components that the motion determines are its own."""
    k1: Finite | None
    k2: Finite | None
    R_GP: Matrix | None
