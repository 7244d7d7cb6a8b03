"""The frozen problem on disk, as the solvers' processes read it: named arrays of numbers and texts, no code.

A name is the path of a field, such as ``fixed.steps.dt_s``; a field that is None is left out. The same
problem gives the same bytes. The solvers' compiled loops check no index, so reading checks shapes, indices
and that all numbers are finite; what is wrong raises InputError, one line.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polhode.backend.dynamics.propagation import MAX_SERIES
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import FORMS, N_INERTIA
from polhode.backend.problem.iterate import N_CAMERA, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import N_WRENCH, Impulses
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.lie import Array
from polhode.pipeline.run_directory.archives import Archive, load_archive, write_arrays
from polhode.records import Ints, Truth

SUFFIX = ".problem.npz"
FORMAT = "polhode problem 1"
"""Changes when a name or a shape does."""
REMEDY = "run the comparison again into another folder"


def write_problem(problem: MeasuredProblem, path: Path) -> None:
    """Write the file. Raises ValueError for a truth with a surface, which no solver needs."""
    if problem.truth is not None and problem.truth.mesh is not None:
        raise ValueError("the truth of a problem has no surface")
    arrays = {name: np.asarray(value, order="C") for name, value in _named("", problem)}
    write_arrays(path, {"format": np.asarray(FORMAT), **arrays})


def _named(prefix: str, record: Any) -> Iterator[tuple[str, Any]]:
    for each in fields(record):
        name, value = prefix + each.name, getattr(record, each.name)
        if name == "data.form":
            value = value.name
        if is_dataclass(value):
            yield from _named(f"{name}.", value)
        elif value is not None:
            yield name, value


def read_problem(path: Path) -> MeasuredProblem:
    """Read a file of ``write_problem``. Raises InputError, one line."""
    archive = load_archive(path, path.name, REMEDY)
    if archive.text("format") != FORMAT:
        raise archive.wrong(f"the format is not '{FORMAT}'")
    data = _data(archive)
    fixed = _fixed(archive, data)
    unknowns = fixed.reference.n_dense + 3 * data.n_landmarks
    return MeasuredProblem(
        name=archive.text("name"),
        data=data,
        fixed=fixed,
        cold=archive.numbers("cold", unknowns),
        solution=archive.numbers("solution", unknowns),
        truth=_truth(archive, data.n_frames) if "truth.timestamps_ns" in archive else None,
        prepared_s=archive.number("prepared_s"),
    )


def _data(archive: Archive) -> MotionData:
    R_RN = archive.numbers("data.R_RN", None, 3, 3)
    frames = len(R_RN)
    if frames < 2:
        raise archive.wrong("data.R_RN has fewer than two frames")
    frame = archive.whole("data.frame", None, below=frames)
    start = archive.whole("data.start", None)
    counts, observations = np.diff(start), len(frame)
    if len(start) < 2 or start[0] != 0 or start[-1] != observations or counts.min() < 0:
        raise archive.wrong("data.start does not divide the observations among the landmarks")
    landmark = archive.whole("data.landmark", observations, below=len(counts))
    if not np.array_equal(landmark, np.repeat(np.arange(len(counts)), counts)):
        raise archive.wrong("data.landmark does not agree with data.start")
    form = archive.text("data.form")
    if form not in FORMS:
        raise archive.wrong(f"data.form '{form}' is none of {', '.join(FORMS)}")
    order = archive.whole("data.order", observations)
    if observations and order.min() < 0:
        raise archive.wrong("data.order is negative")
    return MotionData(
        frame=frame,
        landmark=landmark,
        start=start,
        uvd_px=archive.numbers("data.uvd_px", observations, 3),
        inv_sigma=_positive(archive, "data.inv_sigma", observations, 3),
        rig=archive.numbers("data.rig", 5),
        R_RN=R_RN,
        t_R=archive.numbers("data.t_R", frames, 3),
        camera_N=archive.numbers("data.camera_N", frames, 3),
        dt_s=_positive(archive, "data.dt_s", frames - 1),
        camera_sigma=_pair(archive, "data.camera_sigma"),
        accel_psd=archive.number("data.accel_psd"),
        torque_psd=archive.number("data.torque_psd"),
        robust_scale=float(_positive(archive, "data.robust_scale")),
        form=FORMS[form],
        impulses=_impulses(archive, frames) if "data.impulses.frame_s" in archive else None,
        bias_sigma=_pair(archive, "data.bias_sigma"),
        order=order,
        nodes=archive.flags("data.nodes", frames - 1),
        node_sigma=_pair(archive, "data.node_sigma"),
        loose=archive.flags("data.loose", frames - 1) if "data.loose" in archive else None,
    )


def _impulses(archive: Archive, frames: int) -> Impulses:
    row_s = archive.numbers("data.impulses.row_s", None)
    rows = len(row_s)
    if not rows or (np.diff(row_s) <= 0.0).any():
        raise archive.wrong("data.impulses.row_s does not increase")
    return Impulses(
        frame_s=archive.numbers("data.impulses.frame_s", frames),
        row_s=row_s,
        rows=archive.numbers("data.impulses.rows", rows, 6),
        once=archive.numbers("data.impulses.once", rows, 6),
        twice=archive.numbers("data.impulses.twice", rows, 6),
    )


def _fixed(archive: Archive, data: MotionData) -> LinearizationPoint:
    return LinearizationPoint(
        reference=_reference(archive, data),
        A=archive.numbers("fixed.A", data.n_frames, 3, 3),
        steps=_steps(archive, data.n_frames - 1),
        prior=archive.numbers("fixed.prior", 13),
        gauge_information=archive.numbers("fixed.gauge_information", 6),
        camera_information=archive.numbers("fixed.camera_information", 6),
        bias_sigma=_pair(archive, "fixed.bias_sigma"),
        half_log_det=archive.number("fixed.half_log_det"),
    )


def _reference(archive: Archive, data: MotionData) -> Iterate:
    frames, at = data.n_frames, "fixed.reference."
    camera = archive.numbers(f"{at}camera", frames, N_CAMERA) if f"{at}camera" in archive else None
    if data.camera_is_noisy != (camera is not None):
        raise archive.wrong(f"{at}camera does not agree with data.camera_sigma")
    wrench = R_torque = None
    if f"{at}wrench" in archive:
        if data.impulses is None:
            raise archive.wrong(f"{at}wrench is given without data.impulses")
        wrench = archive.numbers(f"{at}wrench", N_WRENCH)
        R_torque = archive.numbers(f"{at}R_torque", 3, 3)
    return Iterate(
        p_NG=archive.numbers(f"{at}p_NG", frames, 3),
        R_NG=archive.numbers(f"{at}R_NG", frames, 3, 3),
        v_N=archive.numbers(f"{at}v_N", frames, 3),
        w_G=archive.numbers(f"{at}w_G", frames, 3),
        com_G=archive.numbers(f"{at}com_G", 3),
        xi=archive.numbers(f"{at}xi", N_INERTIA),
        R_inertia=archive.numbers(f"{at}R_inertia", 3, 3),
        p_G=archive.numbers(f"{at}p_G", data.n_landmarks, 3),
        camera=camera,
        wrench=wrench,
        R_torque=R_torque,
    )


def _steps(archive: Archive, count: int) -> Steps:
    series = _series(archive, count)
    force = torque = None
    if "fixed.steps.torque_P" in archive:
        torque = archive.numbers("fixed.steps.torque_P", count, int(series.max()), 2, 3)
        force = archive.numbers("fixed.steps.force_increments", count, 2, 3)
    return Steps(
        dt_s=_positive(archive, "fixed.steps.dt_s", count),
        series=series,
        W_t=archive.numbers("fixed.steps.W_t", count, 2, 2),
        W_r=archive.numbers("fixed.steps.W_r", count, 6, 6),
        force_increments=force,
        torque_P=torque,
    )


def _series(archive: Archive, count: int) -> Ints:
    series = archive.whole("fixed.steps.series", count)
    if series.min() < 1 or series.max() > MAX_SERIES:
        raise archive.wrong(f"fixed.steps.series is not between 1 and {MAX_SERIES}")
    return series


def _truth(archive: Archive, frames: int) -> Truth:
    return Truth(
        timestamps_ns=archive.times("truth.timestamps_ns", frames),
        r_N=archive.numbers("truth.r_N", frames, 3),
        R_NP=archive.numbers("truth.R_NP", frames, 3, 3),
        v_N=archive.numbers("truth.v_N", frames, 3),
        w_P=archive.numbers("truth.w_P", frames, 3),
        moments=archive.numbers("truth.moments", 3),
        k1=archive.number("truth.k1"),
        k2=archive.number("truth.k2"),
        com_G=archive.numbers("truth.com_G", 3),
        R_GP=archive.numbers("truth.R_GP", 3, 3),
        mesh=None,
        mass_kg=archive.number("truth.mass_kg") if "truth.mass_kg" in archive else None,
    )


def _positive(archive: Archive, name: str, *shape: int | None) -> Array:
    values = archive.numbers(name, *shape)
    if (values <= 0.0).any():
        raise archive.wrong(f"{name} is not positive everywhere")
    return values


def _pair(archive: Archive, name: str) -> tuple[float, float]:
    first, second = (float(value) for value in archive.numbers(name, 2))
    return first, second
