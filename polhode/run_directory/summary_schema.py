"""summary.json: its content as frozen pydantic models, a part for each topic, and its JSON Schema.

The models are the only definition. ``summary.schema.json``, beside this file, is generated from them
(``python -m polhode.run_directory.summary_schema``) and shipped. Standard deviations and variances
of undetermined quantities are ``null``; there is no NaN or infinity.
"""

import json
import re
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from polhode.files.atomic import write_text
from polhode.records.surface import ErrorCorrelation

SCHEMA_FILE = Path(__file__).with_name("summary.schema.json")


def _plain(value: Any) -> Any:
    """An array as lists."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def _finite_or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


Finite = Annotated[float, Field(allow_inf_nan=False)]
Variance = Annotated[Finite | None, BeforeValidator(_finite_or_none)]
"""null: undetermined; taken from inf or NaN."""
Vector = Annotated[tuple[Finite, Finite, Finite], BeforeValidator(_plain)]
Matrix = Annotated[tuple[Vector, Vector, Vector], BeforeValidator(_plain)]
VarianceRow = Annotated[tuple[Variance, Variance, Variance], BeforeValidator(_plain)]
VarianceMatrix = tuple[VarianceRow, VarianceRow, VarianceRow]
Flags = tuple[bool, bool, bool]
Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
"""SHA-256, hexadecimal."""
Status = Literal["ok", "degraded", "failed"]
ESTIMATE_PARTS = (
    *("inertia", "identifiable", "identifiable_components", "com_G", "cov_com_G", "R_GP", "cov_R_GP"),
    *("solver", "noise"),
)
"""Parts of a summary that an estimate gives: all are there, or none."""


class StrictModel(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, populate_by_name=True
    )


class StageTimes(StrictModel):
    """Wall-clock seconds of each stage; 0 where a stage was not reached."""

    frontend: Finite = 0.0
    initialization: Finite = 0.0
    backend: Finite = 0.0
    depth: Finite = 0.0
    fusion: Finite = 0.0
    checks: Finite = 0.0
    """Of data and answer."""
    report: Finite = 0.0
    total: Finite = 0.0
    ipopt: Finite = 0.0
    """Part of backend: IPOPT's last solve of the whole problem, with the time to build its program."""


class Inertia(StrictModel):
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


class Direction(StrictModel):
    """A direction, whose error is a small turn across it."""

    unit: Vector
    """Of unit length."""
    cov: VarianceMatrix
    """Of the unit vector [rad^2], 0 along it."""
    sigma_deg: Variance
    """Standard deviation along the worse of two axes across it; null: undetermined."""


class Rotation(StrictModel):
    """Angular momentum and spin axis at the last pair; null: undetermined."""

    momentum_N: Direction
    """Direction of the angular momentum about the centre of mass, in N."""
    momentum_rad_s: Finite
    """Its size over the middle moment [rad/s]."""
    sigma_momentum_rad_s: Variance
    momentum_N_m_s: Finite | None
    """Its size from known torques [N m s]; null: none are known."""
    sigma_momentum_N_m_s: Variance
    """null: undetermined, or no torque is known."""
    spin_N: Direction
    """Direction of the angular velocity, in N."""
    spin_P: Direction
    """The same in the principal axes, whose half-turns are a choice of the run."""


class Identifiable(StrictModel):
    """com and axes are true only when every component is determined."""

    k1: bool
    k2: bool
    com: bool
    axes: bool


class IdentifiableComponents(StrictModel):
    """Each component by itself, along (about) the principal axes x, y, z of P."""

    com_P: Flags
    axes_P: Flags


class IpoptSummary(StrictModel):
    """What IPOPT says of the program's solution; its seconds are in timing_s.ipopt."""

    status: str
    """IPOPT's return status."""
    optimality: Variance
    """Largest entry of the gradient of the Lagrangian, of whitened residuals; null: not evaluated."""
    constraint_violation: Variance
    """0: the program has no constraints."""
    iterations: int


SAME_MINIMUM = 1.0
"""Costs of two starts that differ by less are of the same minimum: the starts are not solved to the end."""


class SolverSummary(StrictModel):
    """How the optimisation ended."""

    name: str
    iterations: int
    cost: Finite
    converged: bool
    reduced_chi2: Variance
    message: str = ""
    runner_up: dict[str, Variance] = {}
    """Cost of the other hypotheses, by name, minus that of the chosen one; null: did not converge."""
    constraints: dict[str, bool] = {}
    """Empty; earlier versions could constrain the program."""
    ipopt: IpoptSummary | None = None
    """null: IPOPT had no part in the answer."""


class Noise(StrictModel):
    """Noise that the estimate was made with."""

    pixel_sigma_px: Finite
    disparity_sigma_px: Finite
    accel_psd: Finite
    """[(m/s^2)^2/Hz]"""
    torque_psd: Finite
    """[(rad/s^2)^2/Hz], torque over the middle moment."""
    accel_psd_decades: Variance = None
    """Standard deviation of log10 of accel_psd, which is the mean power; 0: given; null: not stored."""
    torque_psd_decades: Variance = None
    """Likewise of torque_psd."""
    drift_px: Variance = None
    """Standard deviation of what features slide over the surface, with the light and the direction of view,
    while the target turns by more than a radian [px]; null: not measured."""


class SigmaParts(StrictModel):
    """Root of the sum of the variances of the components, by the images and by the calibration."""

    images: Variance
    """null: undetermined."""
    calibration: Finite


class CalibrationError(StrictModel):
    """A combination of errors of the calibration that the data determine, and that was taken off."""

    parameters: dict[str, Finite]
    """Those that mainly belong to it, true minus stated [px, m, rad], by the names of
    ``calibration_covariance.npz``; empty: many, none of them mainly."""
    value: Finite
    """In sigmas of the prior."""
    sigma: Finite
    """Standard deviation that is left, in sigmas of the prior."""


class CalibrationSigmas(StrictModel):
    """What errors of the calibration contribute to the sigmas; states are those of the last frame."""

    source: str
    """Where the standard deviations of the calibration are from."""
    position_m: SigmaParts
    velocity_m_s: SigmaParts
    attitude_rad: SigmaParts
    angular_velocity_rad_s: SigmaParts
    k1: SigmaParts
    k2: SigmaParts
    axes_rad: SigmaParts
    com_m: SigmaParts
    estimated: list[CalibrationError] = Field(default_factory=list)
    """Empty: these data determine nothing better than the prior does, and all errors are considered."""


class UnknownPush(StrictModel):
    """Effect of unknown forces and torques over consecutive steps; pushes.csv has each step."""

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


class Assumed(StrictModel):
    """Mass properties at uniform density; never mixed with the estimates. null: determined by the motion."""

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


class Check(StrictModel):
    """A check of the data or of the answer, which needs no truth."""

    name: str
    """What is compared."""
    value: Finite | None = None
    """null: these data do not allow the check."""
    limit: Finite | None
    """From where on (``at_least``: below which) the answer is doubted; null: information, no doubt."""
    unit: str = ""
    at_least: bool = False
    reason: str = ""
    """Empty: it holds, or was not possible; else what does not hold, a sentence."""


class CheckVerdict(StrictModel):
    """A check as the verdict has it."""

    name: str
    value: Finite | None
    """null: these data do not allow the check."""
    expected: tuple[Finite | None, Finite | None]
    """Lowest and highest value that raises no doubt; null: no bound on this side."""
    holds: bool | None
    """null: not possible with these data, or information only."""


class Verdict(StrictModel):
    """Whether the answer can be trusted."""

    status: Status
    reasons: tuple[str, ...]
    """Why it is not "ok", a sentence each; the first one is the failure, if any."""
    checks: tuple[CheckVerdict, ...]

    def __repr__(self) -> str:
        """Status and reasons, then how many checks hold, with the names of those that do not or cannot."""
        judged = [check for check in self.checks if check.holds is not None]
        failing = [check.name for check in judged if not check.holds]
        impossible = [check.name for check in self.checks if check.value is None]
        lines = [f"{self.status}: {len(judged) - len(failing)} of {len(judged)} checks hold"]
        lines += [f"  reason: {reason}" for reason in self.reasons]
        lines += [f"  does not hold: {name}" for name in failing]
        if impossible:
            lines.append(f"  not possible with these data: {'; '.join(impossible)}")
        return "\n".join(lines)

    __str__ = __repr__


class MeshLevel(StrictModel):
    """A lighter mesh for planners and viewers."""

    file: str
    faces: int
    largest_distance_m: Finite
    """Largest distance between sampled points of either mesh and the other."""
    mean_distance_m: Finite


class Sun(StrictModel):
    """The Sun, from the changes of brightness of the rotating surface."""

    direction_N: Vector
    """Unit vector from the target towards the Sun."""
    sigma_deg: Variance
    """Standard deviation along each of two axes across it; null: the direction was not used."""
    explained: Finite
    """Share of the vertices' changes of brightness that Lambert's law explains."""
    frames_in_light: int
    """Number of the evaluated frames in sunlight."""


class MeshErrorShare(StrictModel):
    """A part of the variance of the vertices' errors that neighbours have in common."""

    share: Finite = Field(ge=0, le=1)
    length_m: Finite | None
    """It correlates by exp(-distance / this) and averages out over larger areas; null: all over the body."""


class MeshErrors(StrictModel):
    """The errors that sigma_m of mesh.ply describes: of distances from the surface along its normal."""

    sigma_median_m: Finite
    noise_scale: Finite = Field(ge=0)
    """Noise over what the depth maps state, by the landmarks' distances from the mesh."""
    landmarks: int = Field(ge=0)
    """Number of landmarks that were compared with it."""
    correlation: tuple[MeshErrorShare, ...]
    """The shares add up to one."""


class Mesh(StrictModel):
    """mesh.ply."""

    vertices: int
    faces: int
    closed: bool
    """Whether it encloses a volume."""
    holes_closed: int
    """Small holes that were closed; their faces are flagged as invented."""
    holes_left_open: int
    """Small holes through which frames saw the background, or that no valid surface closes."""
    invented_faces: int
    invented_share: Finite
    """Of the area."""
    colour: Literal["albedo", "intensity"]
    """albedo: the Sun's shading was divided out; intensity: averages of the images."""
    grey_per_albedo: Finite
    """Grey of a vertex over the grey that it would show facing the Sun; 1 for intensity."""
    sun: Sun | None
    """The direction of light that fits best, used or not; null: undetermined."""
    levels: tuple[MeshLevel, ...]
    frames_doubtful: int = Field(0, ge=0)
    """Frames whose poses are known less accurately by the motion than by their depth."""
    frames_aligned: int = Field(0, ge=0)
    """Of these, those that were aligned to the surface of the other frames."""
    errors: MeshErrors | None = None
    """What sigma_m of mesh.ply stands for; null: nothing was measured."""


def correlation_of(mesh: Mesh) -> tuple[ErrorCorrelation, ...] | None:
    """How the errors of the mesh's vertices correlate; None: not known."""
    if mesh.errors is None:
        return None
    return tuple(
        ErrorCorrelation(each.share, np.inf if each.length_m is None else each.length_m)
        for each in mesh.errors.correlation
    )


class Coverage(StrictModel):
    """How much of the body was seen: shares of the mesh's area, or of its convex hull's where it is open."""

    seen: Finite = Field(ge=0, le=1)
    """Seen in light."""
    seen_unlit: Finite = Field(ge=0, le=1)
    """Seen, but never in light."""
    unseen: Finite = Field(ge=0, le=1)
    of: Literal["mesh", "hull"]
    """What the shares are of."""
    unseen_direction_G: Vector | None
    """Mean direction that the unseen part faces; null: none, or all around."""
    words: str


class Physics(StrictModel):
    """The mesh at uniform density against the motion's mass properties; null: not determined."""

    words: list[str]
    """What agrees and what differs, among what the motion determines."""
    volume_m3: Finite
    com_uniform_G: Vector
    """[m]"""
    com_offset_G: Vector | None
    """Estimate minus uniform density, of the components that are determined [m]."""
    com_offset_sigma_m: Variance
    """Of the estimate, along the offset."""
    R_GP_uniform: Matrix
    axes_angle_deg: Finite | None
    """Smallest rotation between the axes that are determined, up to half-turns."""
    axes_angle_sigma_deg: Variance
    k1_uniform: Finite
    k2_uniform: Finite
    k1_difference: Finite | None
    """Estimate minus uniform density."""
    k2_difference: Finite | None


Interval = Annotated[tuple[Finite, Finite], BeforeValidator(_plain)]
"""Low, high."""


class Intervals(StrictModel):
    """Where what the motion does not determine can lie; null: it is determined, or nothing bounds it."""

    com_G: tuple[Vector, Vector] | None = None
    """Least and largest component along each axis of G [m], of all that is admitted."""
    com_shift_P: tuple[Interval | None, Interval | None, Interval | None] | None = None
    """Along each undetermined principal axis: least and largest shift from com_G [m]."""
    k1: Interval | None = None
    k2: Interval | None = None
    bounds: tuple[str, ...] = ()
    """What the intervals rest on, besides the motion."""


class RecordedImage(StrictModel):
    """An image as it was when the run read it."""

    timestamp_ns: int
    file_sha256: Digest
    pixels_sha256: Digest
    """Of the decoded grey values as stored, row by row, low byte first."""


class Recording(StrictModel):
    """What identifies the recording, wherever it lies and however its images are encoded."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    left_images: tuple[RecordedImage, ...]
    """The first, the middle and the last that the run uses."""


class Hypothesis(StrictModel):
    """A rotation between pairs that the images leave open."""

    rate_rpm: Finite
    """At the last pair."""
    direction: Vector
    """Unit vector of the angular velocity along N at the last pair."""
    odds: Finite = Field(ge=0, le=1)
    """Of all hypotheses they add up to one."""
    reason: str


class Summary(StrictModel):
    """The results of a run. Parts that a failed run did not reach are null."""

    schema_: Literal["polhode-summary/1"] = Field("polhode-summary/1", alias="schema")
    status: Status
    warnings: list[str]
    frames: int = Field(ge=0)
    """Stereo pairs, each a row of trajectory.csv; a frame that was dropped on reading has a warning."""
    frames_used: int = Field(ge=0)
    """Pairs with measurements; the others are bridged by the dynamics."""
    landmarks: int = Field(ge=0)
    observations: int = Field(ge=0)
    duration_s: Finite
    """Of the data."""
    timing_s: StageTimes
    inertia: Inertia | None
    identifiable: Identifiable | None
    identifiable_detail: dict[str, str]
    """Per direction, a description of the reason."""
    identifiable_components: IdentifiableComponents | None
    com_G: Vector | None
    """[m]"""
    cov_com_G: VarianceMatrix | None
    """[m^2]"""
    R_GP: Matrix | None
    cov_R_GP: VarianceMatrix | None
    """Of theta in R_GP Exp(theta) [rad^2]."""
    rotation: Rotation | None = None
    """At the last pair; null: an earlier version wrote none."""
    solver: SolverSummary | None
    noise: Noise | None
    calibration: CalibrationSigmas | None = None
    """null: it is stated as exact, or an earlier version took it so."""
    unknown_pushes: tuple[UnknownPush, ...] = ()
    """Of unknown forces and torques, in time."""
    hypotheses: tuple[Hypothesis, ...] = Field((), max_length=4)
    """Where the images leave more than one rotation, that of trajectory.csv first; else empty."""
    checks: tuple[Check, ...] = ()
    """Of the data and of the answer; each that does not hold is a reason for "degraded"."""
    verdict: Verdict | None = None
    """Status, reasons and checks in brief; null: an earlier version wrote none."""
    assumed: Assumed | None = None
    """From uniform density of the mesh, where the user gave a mass or a density; null: neither."""
    mesh: Mesh | None = None
    """null: there is none."""
    coverage: Coverage | None = None
    """null: there is no mesh."""
    physics: Physics | None = None
    """null: the mesh encloses no volume."""
    intervals: Intervals | None = None
    """Of what the motion does not determine; null: it determines all, or nothing bounds the rest."""
    files: tuple[str, ...] | None = None
    """Files that the run wrote into its folder, which another run may replace; null: not listed."""
    data: Recording | None = None
    """What the run was made from; null: an earlier version did not record it."""
    sha256: dict[str, Digest] | None = None
    """Of its results, which later commands compare; null: an earlier version wrote none."""
    own_sha256: Digest | None = None
    """Of all other entries of the file (``content_digest``), while it is one; null: an earlier version
    wrote none."""

    @model_validator(mode="after")
    def _estimate_is_whole(self) -> Self:
        missing = [name for name in ESTIMATE_PARTS if getattr(self, name) is None]
        if missing and len(missing) < len(ESTIMATE_PARTS):
            raise ValueError(f"{missing[0]} is null, but other parts of the estimate are not")
        return self


@dataclass(frozen=True)
class ShapeFindings:
    """All of these; None where a step failed or had no surface."""

    mesh: Mesh | None = None
    coverage: Coverage | None = None
    physics: Physics | None = None
    assumed: Assumed | None = None
    warnings: tuple[str, ...] = ()


def json_text(model: StrictModel, indent: int = 2) -> str:
    """The content of a file."""
    text = json.dumps(model.model_dump(mode="json", by_alias=True), indent=indent, allow_nan=False)
    # One row of numbers, one line: no JSON string holds a raw line feed, so only arrays are touched.
    return re.sub(r"\[\n\s*([-+.,\w\s]*?)\n\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text) + "\n"


def content_digest(content: dict[str, Any]) -> str:
    """SHA-256, hexadecimal, of the entries of summary.json but own_sha256, keys sorted, without spaces."""
    rest = {key: value for key, value in content.items() if key != "own_sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()


def json_schema(model: type[StrictModel]) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a model's file."""
    schema = model.model_json_schema(by_alias=True, mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


if __name__ == "__main__":
    write_text(SCHEMA_FILE, json.dumps(json_schema(Summary), indent=2) + "\n")
