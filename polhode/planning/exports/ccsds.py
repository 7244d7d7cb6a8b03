"""Predicted motion as CCSDS navigation messages in key = value notation, and as a TUM trajectory.

OEM 2.0: CCSDS 502.0-B-2, orbit data messages: km, km/s, covariance as lower triangles. AEM 2.0: CCSDS
504.0-B-2, attitude data messages: QUATERNION/ANGVEL, deg/s. TUM: the format of the TUM RGB-D benchmark,
``timestamp tx ty tz qx qy qz qw`` in seconds and metres.

The quaternion of an AEM rotates coordinates in REF_FRAME_A into those in REF_FRAME_B (ADM, annex on
conventions): with A = N and B = F its four numbers are those of our Hamilton q_NF, scalar last.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Ints, continuous_wxyz, wxyz_from_matrix
from polhode.planning.prediction import PredictedMotion

KM_PER_M = 1e-3
FRAME, CENTER = "LOCAL_INERTIAL_N", "INSPECTOR_START"
"""Names of N and of its origin"""
BODY_FRAME = "SC_BODY_1"
"""Name of F: of the frames of a body those of the standard's annex, which readers insist on (Orekit)"""


@dataclass(frozen=True)
class MessageHeader:
    """What the data do not contain."""

    object_name: str
    object_id: str
    epoch: np.datetime64
    """UTC at timestamp 0, in nanoseconds"""
    created: str
    """UTC, ISO 8601"""
    comments: tuple[str, ...]


def oem(motion: PredictedMotion, header: MessageHeader) -> str:
    """Centre of mass in N with its covariance at every instant.

    Where the run does not determine the centre of mass, the covariance is that of the estimated one as a mark
    on the body, and a comment says so.
    """
    covariance, note = motion.covariance[:, :6, :6], "covariance: of the centre of mass, along N"
    if not np.isfinite(covariance).all():
        covariance = motion.covariance_of_marks[:, :6, :6]
        note = (
            "covariance: of the estimated centre of mass as a mark on the body, along N; the run does not "
            "determine the centre of mass itself in every direction"
        )
    times = utc(motion.timestamps_ns, header.epoch)
    frame = [f"REF_FRAME = {FRAME}"]
    interpolation = ["INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 3"]
    lines = [*_metadata("OEM", header, [note], frame, times, interpolation), ""]
    states = KM_PER_M * np.hstack([motion.r_N, motion.v_N])
    lines += [f"{time} {_numbers(row)}" for time, row in zip(times, states, strict=True)]
    lines += ["", "COVARIANCE_START"]
    for time, matrix in zip(times, KM_PER_M**2 * covariance, strict=True):
        lines += [f"EPOCH = {time}", f"COV_REF_FRAME = {FRAME}"]
        lines += [_numbers(matrix[k, : k + 1]) for k in range(6)]
    return "\n".join([*lines, "COVARIANCE_STOP"]) + "\n"


def aem(
    timestamps_ns: Ints,
    R_NF: Array,
    w_F: Array,
    header: MessageHeader,
    comments: Sequence[str],
) -> str:
    """Attitude of F in N and its angular velocity along F, given in rad/s and written in deg/s."""
    times = utc(timestamps_ns, header.epoch)
    frames = [f"REF_FRAME_A = {FRAME}", f"REF_FRAME_B = {BODY_FRAME}"]
    attitude = ["ATTITUDE_TYPE = QUATERNION/ANGVEL", f"ANGVEL_FRAME = {BODY_FRAME}"]
    lines = [*_metadata("AEM", header, comments, frames, times, attitude), "", "DATA_START"]
    wxyz = continuous_wxyz(wxyz_from_matrix(R_NF))
    rows = np.hstack([wxyz[:, [1, 2, 3, 0]], np.rad2deg(w_F)])
    lines += [f"{time} {_numbers(row)}" for time, row in zip(times, rows, strict=True)]
    return "\n".join([*lines, "DATA_STOP"]) + "\n"


def tum(timestamps_ns: Ints, X_NF: Array, comments: Sequence[str]) -> str:
    """One pose a line; the time is the timestamp in seconds, exact to the nanosecond."""
    wxyz = continuous_wxyz(wxyz_from_matrix(X_NF[:, :3, :3]))
    rows = np.hstack([X_NF[:, :3, 3], wxyz[:, [1, 2, 3, 0]]])
    lines = [f"# {text}" for text in comments]
    lines.append("# timestamp tx ty tz qx qy qz qw")
    for stamp, row in zip(timestamps_ns.tolist(), rows, strict=True):
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {_numbers(row)}")
    return "\n".join(lines) + "\n"


def utc(timestamps_ns: Ints, epoch: np.datetime64) -> list[str]:
    """ISO 8601 to the nanosecond."""
    return [
        str(epoch.astype("datetime64[ns]") + np.timedelta64(stamp, "ns")) for stamp in timestamps_ns.tolist()
    ]


def _metadata(
    kind: str,
    header: MessageHeader,
    comments: Sequence[str],
    frames: list[str],
    times: list[str],
    more: list[str],
) -> list[str]:
    """Header and metadata section of a message."""

    def commented(*texts: str) -> list[str]:
        return [f"COMMENT {line}" for text in texts for line in textwrap.wrap(text, 120)]

    return [
        *(f"CCSDS_{kind}_VERS = 2.0", *commented(*header.comments)),
        *(f"CREATION_DATE = {header.created}", "ORIGINATOR = POLHODE", "", "META_START"),
        *commented(
            f"{FRAME} is a local inertial frame, by agreement: the left camera at the first frame "
            "(x right, y down, z forward), or the frame of the inspector's poses where those were given",
            f"{CENTER} is its origin",
            *comments,
        ),
        *(f"OBJECT_NAME = {header.object_name}", f"OBJECT_ID = {header.object_id}"),
        *(f"CENTER_NAME = {CENTER}", *frames),
        *("TIME_SYSTEM = UTC", f"START_TIME = {times[0]}", f"STOP_TIME = {times[-1]}"),
        *more,
        "META_STOP",
    ]


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12e}" for value in values.tolist())
