"""The JSON export: states, mass properties and prediction with their covariances, in SI units.

The models below are the only definition; ``export.schema.json``, beside this file, is generated from them
(``python -m polhode.planning.exports.json_document``). A variance of what is not determined is
``null``, and so are the covariances with it; there is no NaN or infinity.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from polhode.files.atomic import write_text
from polhode.geometry.lie import continuous_wxyz, wxyz_from_matrix
from polhode.planning.exports import ccsds
from polhode.planning.exports.job import ExportJob
from polhode.planning.predict import MAX_ROWS, prediction_instants
from polhode.run_directory.archives import STATE_ORDER
from polhode.run_directory.summary import nullable
from polhode.run_directory.summary_schema import (
    Finite,
    Intervals,
    Matrix,
    Status,
    StrictModel,
    VarianceMatrix,
    VarianceRow,
    Vector,
    json_schema,
    json_text,
)
from polhode.runtime.errors import InputError

SCHEMA_FILE = Path(__file__).with_name("export.schema.json")
FRAME_N = (
    "N, inertial: the left camera at the first frame (x right, y down, z forward), or the frame of the "
    "inspector's poses where those were given"
)

Row4 = tuple[Finite, Finite, Finite, Finite]
CovarianceRows = Annotated[
    list[Annotated[list[Finite | None], Field(min_length=12, max_length=12)]],
    Field(min_length=12, max_length=12),
]


class FrameOut(StrictModel):
    """The frame F that was asked for, in the body."""

    name: Literal["G", "P"]
    words: str
    X_FG: tuple[Row4, Row4, Row4, Row4]
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
    q_NP_wxyz: Row4
    """Hamilton, scalar first; rotates coordinates in P into those in N"""
    w_P: Vector
    """[rad/s]"""
    p_NF: Vector
    """Origin of F in N [m]"""
    q_NF_wxyz: Row4
    covariance: CovarianceRows
    """Of the centre of mass and the principal axes; null: undetermined"""
    covariance_of_marks: CovarianceRows
    """Of the body: the estimated centre of mass and axes are marks on it"""


class MassPropertiesOut(StrictModel):
    """As the run's summary has them, and what simulators are given."""

    moments: Vector | None
    """Middle one 1"""
    sigma_moments: VarianceRow | None
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
    """Per direction, a description of the reason"""
    intervals: Intervals | None = None
    """Where what the motion does not determine can lie; null: it determines all, or nothing bounds it"""


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
    """Statistics of the mesh; the other formats contain the mesh itself."""

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
    run_status: Status
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


def json_document(job: ExportJob) -> str:
    """The file."""
    options, summary = job.options, job.summary
    states: list[dict[str, Any]] = []
    undetermined: tuple[str, ...] = ()
    if job.no_motion:
        job.leave_out(f"states and prediction are left out: {job.no_motion}")
    else:
        states, undetermined = _states(job)
    shape, statistics = job.shape(), None
    if shape is None:
        job.leave_out("the shape is left out: this run has no mesh")
    else:
        measured = shape.sigma_m[np.isfinite(shape.sigma_m)]
        statistics = {
            "vertices": len(shape.vertices),
            "faces": len(shape.faces),
            "box_F": (shape.vertices.min(axis=0), shape.vertices.max(axis=0)),
            "sigma_median_m": float(np.median(measured)) if len(measured) else None,
            "sigma_95_m": float(np.quantile(measured, 0.95)) if len(measured) else None,
            "measured_share": len(measured) / len(shape.vertices),
        }
    inertial, found = job.inertial(), summary.model_dump()
    inertia = found["inertia"] or {}
    # the summary's fields, and those of its inertia
    properties = inertia | {"cov_k": inertia.get("cov")} | found
    document = Document.model_validate(
        {
            "run_status": summary.status,
            "run_warnings": summary.warnings,
            "left_out": job.left_out,
            "epoch_utc": str(options.epoch_utc.astype("datetime64[s]")),
            "frame_N": FRAME_N,
            "frame": {"name": options.frame_name, "words": job.frame, "X_FG": job.X_FG.tolist()},
            "last": states[0] if states else None,
            "prediction": states[1:],
            "undetermined": list(undetermined),
            "mass_properties": {name: properties.get(name) for name in MassPropertiesOut.model_fields},
            "inertial": inertial
            and {
                name: getattr(inertial, "notes" if name == "words" else name)
                for name in InertialOut.model_fields
            },
            "shape": statistics,
        }
    )
    return json_text(document, indent=1)


def _states(job: ExportJob) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    """The content of ``StateOut`` for each instant; what the motion does not determine."""
    options = job.options
    time_s, _ = prediction_instants(job.folder, options.horizon, options.step_s, from_last=True)
    # these take 0.7 GB while they are written, and a file of 60 MB
    if len(time_s) > 10_000:
        raise InputError(
            f"--horizon {options.horizon:g}: {len(time_s)} states, each with two covariances; json takes up "
            f"to 10000: give a larger --step-s, or use polhode predict, which takes {MAX_ROWS}"
        )
    motion = job.motion(options.step_s)
    job.check_epoch(int(motion.timestamps_ns[0]))
    X_NF = job.poses(motion)
    columns = {
        "timestamp_ns": motion.timestamps_ns.tolist(),
        "time_s": motion.time_s,
        "utc": ccsds.utc(motion.timestamps_ns, job.options.epoch_utc),
        "r_N": motion.r_N,
        "v_N": motion.v_N,
        "q_NP_wxyz": continuous_wxyz(wxyz_from_matrix(motion.R_NP)).tolist(),
        "w_P": motion.w_P,
        "p_NF": X_NF[:, :3, 3],
        "q_NF_wxyz": continuous_wxyz(wxyz_from_matrix(X_NF[:, :3, :3])).tolist(),
        "covariance": [nullable(each) for each in motion.covariance],
        "covariance_of_marks": [nullable(each) for each in motion.covariance_of_marks],
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return rows, motion.undetermined


if __name__ == "__main__":
    write_text(SCHEMA_FILE, json.dumps(json_schema(Document), indent=2) + "\n")
