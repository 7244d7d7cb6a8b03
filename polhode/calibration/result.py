"""calibration.json: its content as pydantic models, and its JSON Schema.

``calibration.schema.json``, beside this file, is generated from the models
(``python -m polhode.calibration.result``) and shipped.
"""

import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from polhode.calibration.adjustment import epipolar_errors
from polhode.calibration.boards import Pattern
from polhode.calibration.calibrate import CalibratedRig, rms_px
from polhode.calibration.detection import Kind
from polhode.calibration.lenses import Model
from polhode.files.atomic import write_text
from polhode.geometry.lie import Array, log_so3, right_jacobian_so3
from polhode.run_directory.summary_schema import Finite, StrictModel, json_schema

SCHEMA_FILE = Path(__file__).with_name("calibration.schema.json")
Sigma = Annotated[float, Field(allow_inf_nan=False, ge=0.0)]


class Parameter(StrictModel):
    """A value with its standard deviation."""

    value: Finite
    sigma: Sigma
    unit: str


class BoardOfResult(StrictModel):
    """The board, as the command line states it."""

    pattern: Pattern
    columns: int
    rows: int
    square_mm: Finite
    """Side of a square, or of a tag"""
    marker_mm: Finite | None
    spacing: Finite | None
    dictionary: str | None


class CameraOfResult(StrictModel):
    """One camera."""

    model: Model
    width_px: int
    height_px: int
    images_used: int
    corners_used: int
    corner_sigma_px: Finite
    """Median over the images of the standard deviation of a coordinate of a corner"""


class PerCamera(StrictModel):
    """A number for each camera."""

    cam0: Finite
    cam1: Finite


class RmsOfResult(PerCamera):
    """Root mean square length of the residuals [px], as OpenCV states it."""

    stereo: Finite
    """Of both cameras in the common adjustment; cam0 and cam1: of each camera adjusted alone"""


class RejectedImage(StrictModel):
    """An image that was left out."""

    file: str
    kind: Kind
    reason: str


class Covariance(StrictModel):
    """Of all parameters together."""

    names: tuple[str, ...]
    matrix: tuple[tuple[Finite, ...], ...]


class CalibrationResult(StrictModel):
    """The content of calibration.json."""

    schema_: Literal["polhode-calibration/1"] = Field("polhode-calibration/1", alias="schema")
    board: BoardOfResult
    cameras: tuple[CameraOfResult, CameraOfResult]
    pairs: int
    """Pairs whose both images are used"""
    rms_px: RmsOfResult
    joint_rms_px: PerCamera
    """Of each camera in the common adjustment"""
    epipolar_rms_px: Finite
    used: tuple[str, ...]
    """Images"""
    rejected: tuple[RejectedImage, ...]
    corners_left_out: int
    """Single corners, of used images, more than six standard deviations off"""
    parameters: dict[str, dict[str, Parameter]]
    """cam0, cam1: intrinsics and distortion; cam1_from_cam0: p_1 = R p_0 + t, R as a rotation vector; rig:
    baseline"""
    covariance: Covariance
    """Of the parameters of cam0, cam1 and cam1_from_cam0"""
    warnings: tuple[str, ...]


def result_of(rig: CalibratedRig) -> CalibrationResult:
    """The content of the file."""
    state, views = rig.state, rig.views
    residuals = rig.adjusted.residuals
    names, values, covariance, units = _parameters(rig)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters: dict[str, dict[str, Parameter]] = {}
    for name, value, s, unit in zip(names, values.tolist(), sigma.tolist(), units, strict=True):
        group, _, own = name.partition(".")
        parameters.setdefault(group, {})[own] = Parameter(value=value, sigma=s, unit=unit)
    t = state.X_10[:3, 3]
    along = t / np.linalg.norm(t)
    baseline_sigma = float(np.sqrt(along @ covariance[-3:, -3:] @ along))
    baseline = Parameter(value=float(np.linalg.norm(t)), sigma=baseline_sigma, unit="m")
    parameters["rig"] = {"baseline": baseline}
    board = views.board
    cameras = [
        CameraOfResult(
            model=state.lenses[camera].model,
            width_px=views.size_px(camera)[0],
            height_px=views.size_px(camera)[1],
            images_used=len(views.found[camera]),
            corners_used=len(rig.data[camera].view),
            corner_sigma_px=float(np.nanmedian(rig.adjusted.sigma_px[camera])),
        )
        for camera in (0, 1)
    ]
    return CalibrationResult(
        board=BoardOfResult(
            pattern=board.pattern,
            columns=board.columns,
            rows=board.rows,
            square_mm=1e3 * board.square_m,
            marker_mm=1e3 * board.marker_m if board.pattern == "charuco" else None,
            spacing=board.spacing if board.pattern == "aprilgrid" else None,
            dictionary=None if board.pattern == "chessboard" else board.dictionary,
        ),
        cameras=(cameras[0], cameras[1]),
        pairs=len(views.found[0].keys() & views.found[1].keys()),
        rms_px=RmsOfResult(
            cam0=rig.alone_px[0], cam1=rig.alone_px[1], stereo=rms_px(np.concatenate(residuals))
        ),
        joint_rms_px=PerCamera(cam0=rms_px(residuals[0]), cam1=rms_px(residuals[1])),
        epipolar_rms_px=float(np.sqrt(np.nanmean(epipolar_errors(state, rig.data)[1] ** 2))),
        used=tuple(
            views.pairs.names[camera][pair] or ""
            for pair in range(views.count)
            for camera in (0, 1)
            if pair in views.found[camera]
        ),
        rejected=tuple(
            RejectedImage(file=each.file, kind=each.kind, reason=each.reason) for each in views.rejections()
        ),
        corners_left_out=rig.left_out,
        parameters=parameters,
        covariance=Covariance(names=tuple(names), matrix=tuple(map(tuple, covariance.tolist()))),
        warnings=tuple(_warnings(rig)),
    )


def _parameters(rig: CalibratedRig) -> tuple[list[str], Array, Array, list[str]]:
    """Names, values, covariance and units of lenses and pose, the rotation as a vector."""
    state = rig.state
    names, units = [], []
    for camera, lens in enumerate(state.lenses):
        names += [f"cam{camera}.{name}" for name in lens.names]
        units += ["px"] * 4 + [""] * len(lens.coefficients)
    names += [
        f"cam1_from_cam0.{name}" for name in ("rotation_x", "rotation_y", "rotation_z", "t_x", "t_y", "t_z")
    ]
    units += ["rad"] * 3 + ["m"] * 3
    rotation = log_so3(state.X_10[:3, :3])
    values = np.concatenate([*(lens.values for lens in state.lenses), rotation, state.X_10[:3, 3]])
    # the adjustment's step is R Exp(theta); the rotation vector changes by the inverse right Jacobian
    J = np.eye(len(values))
    J[-6:-3, -6:-3] = np.linalg.inv(right_jacobian_so3(rotation))
    return names, values, J @ rig.adjusted.covariance @ J.T, units


def _warnings(rig: CalibratedRig) -> list[str]:
    """What is doubtful, each a sentence with what to do."""
    out = []
    state = rig.state
    sigma = np.sqrt(np.maximum(np.diag(rig.adjusted.covariance), 0.0))
    if state.X_10[0, 3] > abs(state.X_10[1, 3]):
        out.append("the right camera is on the left of the left one: if that is not so, exchange the images")
    at = 0
    for camera, lens in enumerate(state.lenses):
        share = float((sigma[at : at + 2] / lens.values[:2]).max())
        at += len(lens.values)
        name = ("left", "right")[camera]
        if share > 0.01:
            out.append(
                f"the focal length of the {name} camera is known to {100 * share:.1f} % only: add views of "
                "boards that are tilted by 30 to 45 degrees"
            )
        spread = np.ptp(rig.data[camera].uv_px, axis=0) / np.array(rig.views.size_px(camera))
        if (spread < 0.55).any():
            out.append(
                f"the boards cover {100 * spread[0]:.0f} % of the width and {100 * spread[1]:.0f} % of the "
                f"height of the {name} images: the distortion beyond is extrapolated; add views near the "
                "corners"
            )
    return out


if __name__ == "__main__":
    write_text(SCHEMA_FILE, json.dumps(json_schema(CalibrationResult), indent=2) + "\n")
