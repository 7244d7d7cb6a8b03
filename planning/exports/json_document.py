"""The JSON export: states, mass properties and prediction with their covariances, in SI units.

The models below are the only definition; ``planning/exports/export.schema.json`` is generated from them
(``python -m polhode.planning.exports.json_document``). A variance of what is not determined is ``null``, and
so are the covariances with it; there is no NaN or infinity.
"""

import json
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from polhode.atomic import write_text
from polhode.lie import Array, continuous_wxyz, wxyz_from_matrix
from polhode.planning.exports.records import ExportShape, Inertial, Placement, PredictedMotion

SCHEMA_FILE = Path(__file__).with_name("export.schema.json")
STATE_ORDER = tuple(f"{name}_{axis}" for name in ("r_N", "v_N", "theta_P", "w_P") for axis in "xyz")

Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Matrix = tuple[Vector, Vector, Vector]
Quaternion = tuple[Finite, Finite, Finite, Finite]
Covariance = Annotated[
    list[Annotated[list[Finite | None], Field(min_length=12, max_length=12)]],
    Field(min_length=12, max_length=12),
]
VarianceMatrix = tuple[
    tuple[Finite | None, Finite | None, Finite | None],
    tuple[Finite | None, Finite | None, Finite | None],
    tuple[Finite | None, Finite | None, Finite | None],
]


class StrictModel(BaseModel):
    """Refuses keys that it does not know."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, populate_by_name=True
    )


class FrameOut(StrictModel):
    """The frame F that was asked for, in the body."""

    name: Literal["G", "P", "cad"]
    words: str
    X_FG: tuple[Quaternion, Quaternion, Quaternion, Quaternion]
    """Row-major, p_F = X_FG p_G [m]"""


class StateOut(StrictModel):
    """A state, and its covariance in the order of ``state_order``."""

    timestamp_ns: int
    time_s: Finite
    """Since the last state of the run"""
    utc: str
    r_N: Vector
    """Centre of mass [m]"""
    v_N: Vector
    """[m/s]"""
    q_NP_wxyz: Quaternion
    """Hamilton, scalar first; turns coordinates in P into those in N"""
    w_P: Vector
    """[rad/s]"""
    p_NF: Vector
    """Origin of F in N [m]"""
    q_NF_wxyz: Quaternion
    covariance: Covariance
    """Of the centre of mass and the principal axes; null: undetermined"""
    covariance_of_marks: Covariance
    """Of the body: the estimated centre of mass and axes are marks on it"""


class MassPropertiesOut(StrictModel):
    """As the run's summary has them, and what simulators are given."""

    moments: Vector | None
    """Middle one 1"""
    sigma_moments: tuple[Finite | None, Finite | None, Finite | None] | None
    k1: Finite | None
    """ln(Jxx / Jyy)"""
    k2: Finite | None
    """ln(Jyy / Jzz)"""
    cov_k: tuple[tuple[Finite | None, Finite | None], tuple[Finite | None, Finite | None]] | None
    com_G: Vector | None
    """[m]"""
    cov_com_G: VarianceMatrix | None
    """[m^2]"""
    R_GP: Matrix | None
    cov_R_GP: VarianceMatrix | None
    """Of theta in R_GP Exp(theta) [rad^2]"""
    identifiable: dict[str, bool] | None
    """k1, k2, com, axes"""
    identifiable_detail: dict[str, str]
    """Per direction, the reason in words"""


class InertialOut(StrictModel):
    """What URDF, MJCF and SDF have as inertial tags."""

    mass_kg: Finite
    mass_is: Literal["given", "determined", "assumed", "relative"]
    com_F: Vector
    R_FP: Matrix
    moments_kg_m2: Vector
    scale_is: Literal["determined", "given", "assumed", "relative"]
    words: list[str]


class ShapeOut(StrictModel):
    """Numbers of the mesh; the other formats hold the mesh itself."""

    vertices: int
    faces: int
    box_F: tuple[Vector, Vector]
    """Least and largest coordinates [m]"""
    sigma_median_m: Finite | None
    """Of the measured vertices"""
    sigma_95_m: Finite | None
    """95 % of the measured vertices have less"""
    measured_share: Finite
    """Of the vertices"""


class Document(StrictModel):
    """One run as far as it got. What is missing is null, and named in ``left_out``."""

    schema_: Literal["polhode-export/1"] = Field("polhode-export/1", alias="schema")
    run_status: Literal["ok", "degraded", "failed"]
    run_warnings: list[str]
    left_out: list[str]
    """What is not here, and why"""
    units: Literal["m, kg, s, rad"] = "m, kg, s, rad"
    epoch_utc: str
    """UTC that is taken as timestamp 0"""
    frame_N: str
    frame: FrameOut
    state_order: tuple[str, ...] = STATE_ORDER
    last: StateOut | None
    prediction: list[StateOut]
    undetermined: list[str]
    """Directions that the motion of the run does not determine"""
    mass_properties: MassPropertiesOut
    inertial: InertialOut | None
    shape: ShapeOut | None


def states_out(motion: PredictedMotion, X_NF: Array, utc: list[str]) -> list[StateOut]:
    """One for each instant; X_NF (T, 4, 4)."""
    q_NP = continuous_wxyz(wxyz_from_matrix(motion.R_NP)).tolist()
    q_NF = continuous_wxyz(wxyz_from_matrix(X_NF[:, :3, :3])).tolist()
    return [
        StateOut(
            timestamp_ns=int(motion.timestamps_ns[k]),
            time_s=float(motion.time_s[k]),
            utc=utc[k],
            r_N=vector(motion.r_N[k]),
            v_N=vector(motion.v_N[k]),
            q_NP_wxyz=q_NP[k],
            w_P=vector(motion.w_P[k]),
            p_NF=vector(X_NF[k, :3, 3]),
            q_NF_wxyz=q_NF[k],
            covariance=nullable(motion.covariance[k]),
            covariance_of_marks=nullable(motion.covariance_of_marks[k]),
        )
        for k in range(len(motion.timestamps_ns))
    ]


def inertial_out(inertial: Inertial) -> InertialOut:
    """The same numbers as in the robot formats."""
    return InertialOut.model_validate(
        {
            "mass_kg": inertial.mass_kg,
            "mass_is": inertial.mass_is,
            "com_F": vector(inertial.com_F),
            "R_FP": inertial.R_FP.tolist(),
            "moments_kg_m2": vector(inertial.moments_kg_m2),
            "scale_is": inertial.scale_is,
            "words": list(inertial.words),
        }
    )


def shape_out(shape: ExportShape) -> ShapeOut:
    """Numbers of a surface, or of a cloud of points."""
    measured = shape.sigma_m[np.isfinite(shape.sigma_m)]
    known = len(measured) > 0
    return ShapeOut(
        vertices=len(shape.vertices),
        faces=len(shape.faces),
        box_F=(vector(shape.vertices.min(axis=0)), vector(shape.vertices.max(axis=0))),
        sigma_median_m=float(np.median(measured)) if known else None,
        sigma_95_m=float(np.quantile(measured, 0.95)) if known else None,
        measured_share=len(measured) / len(shape.vertices),
    )


def frame_out(at: Placement) -> FrameOut:
    """F in the body."""
    return FrameOut.model_validate({"name": at.name, "words": at.words, "X_FG": at.X_FG.tolist()})


def vector(values: Array) -> Vector:
    """(3,)"""
    a, b, c = (float(value) for value in values)
    return a, b, c


def nullable(covariance: Array) -> list[list[float | None]]:
    """Rows and columns of an undetermined component are null as a whole: their covariances mean nothing."""
    unknown = ~np.isfinite(np.diagonal(covariance))
    return [
        [None if unknown[i] or unknown[j] else float(covariance[i, j]) for j in range(len(covariance))]
        for i in range(len(covariance))
    ]


def text_of(document: Document) -> str:
    """The file."""
    text = json.dumps(document.model_dump(mode="json", by_alias=True), indent=1, allow_nan=False)
    # one row of numbers, one line
    return re.sub(r"\[\n\s*([-+.,\w\s]*?)\n\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text) + "\n"


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12)."""
    content = Document.model_json_schema(by_alias=True, mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **content}


if __name__ == "__main__":
    write_text(SCHEMA_FILE, json.dumps(schema(), indent=2) + "\n")
