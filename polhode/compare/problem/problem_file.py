"""The frozen problem on disk, as the solvers' processes read it: named arrays of numbers and texts, no code.

A name is the path of a field, such as ``fixed.steps.dt_s``; a field that is None is left out. The same
problem gives the same bytes. The solvers' compiled loops check no index, so reading checks shapes, indices
and that all numbers are finite; what is wrong raises InputError, one line.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polhode.backend.dynamics.propagation import MAX_SERIES
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import N_CAMERA, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import N_WRENCH, Impulses
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.records.truth import Truth
from polhode.run_directory.archives import Archive, load_archive, write_arrays

SUFFIX = ".problem.npz"
FORMAT = "polhode problem 1"
"""Changes when a name or a shape does."""
REMEDY = "run the comparison again into another folder"
_NAMES: dict[tuple[int | str, ...], str] = {
    (2,): "data.camera_sigma data.bias_sigma data.node_sigma fixed.bias_sigma",
    (3,): "fixed.reference.com_G truth.moments truth.com_G",
    (5,): "data.rig fixed.reference.xi",
    (6,): "fixed.gauge_information fixed.camera_information",
    (13,): "fixed.prior",
    (N_WRENCH,): "fixed.reference.wrench",
    (3, 3): "fixed.reference.R_inertia fixed.reference.R_torque truth.R_GP",
    ("observations", 3): "data.uvd_px data.inv_sigma",
    ("landmarks", 3): "fixed.reference.p_G",
    ("frames",): "data.impulses.frame_s",
    ("frames", 3): "data.t_R data.camera_N fixed.reference.p_NG fixed.reference.v_N fixed.reference.w_G "
    "truth.r_N truth.v_N truth.w_P",
    ("frames", N_CAMERA): "fixed.reference.camera",
    ("frames", 3, 3): "data.R_RN fixed.A fixed.reference.R_NG truth.R_NP",
    ("rows",): "data.impulses.row_s",
    ("rows", 6): "data.impulses.rows data.impulses.once data.impulses.twice",
    ("steps",): "data.dt_s data.nodes data.loose fixed.steps.dt_s",
    ("steps", 2, 2): "fixed.steps.W_t",
    ("steps", 6, 6): "fixed.steps.W_r",
    ("steps", 2, 3): "fixed.steps.force_increments",
    ("steps", "series", 2, 3): "fixed.steps.torque_P",
}
SHAPES = {name: shape for shape, names in _NAMES.items() for name in names.split()}
"""Of the arrays; what is not here is a single number."""
POSITIVE = ("data.inv_sigma", "data.dt_s", "data.robust_scale", "fixed.steps.dt_s")
PAIRS = ("data.camera_sigma", "data.bias_sigma", "data.node_sigma", "fixed.bias_sigma")
FLAGS = ("data.nodes", "data.loose")
OPTIONAL = {
    "data.loose": "data.loose",
    "fixed.reference.camera": "fixed.reference.camera",
    "fixed.reference.wrench": "fixed.reference.wrench",
    "fixed.reference.R_torque": "fixed.reference.wrench",
    "fixed.steps.force_increments": "fixed.steps.torque_P",
    "fixed.steps.torque_P": "fixed.steps.torque_P",
    "truth.mass_kg": "truth.mass_kg",
}
"""What may be absent, with the array whose absence says so."""


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
    frames, observations = (
        len(archive.numbers("data.R_RN", None, 3, 3)),
        len(archive.whole("data.frame", None)),
    )
    if frames < 2:
        raise archive.wrong("data.R_RN has fewer than two frames")
    sizes = {"frames": frames, "steps": frames - 1, "observations": observations}
    data = _data(archive, sizes)
    sizes["landmarks"] = data.n_landmarks
    fixed = _fixed(archive, sizes, data)
    truth = None
    if "truth.timestamps_ns" in archive:
        stamps = archive.times("truth.timestamps_ns", frames)
        truth = Truth(**_fields(archive, sizes, Truth, "truth.", timestamps_ns=stamps, mesh=None))
    unknowns = fixed.reference.n_dense + 3 * data.n_landmarks
    cold, solution = (archive.numbers(name, unknowns) for name in ("cold", "solution"))
    prepared_s = archive.number("prepared_s")
    return MeasuredProblem(archive.text("name"), data, fixed, cold, solution, truth, prepared_s)


def _fields(
    archive: Archive, sizes: Mapping[str, int], record: type, prefix: str, **known: Any
) -> dict[str, Any]:
    """The fields of a record: the known ones, and all others as the tables above have them."""
    found = dict(known)
    for each in fields(record):
        name = prefix + each.name
        if each.name in known:
            continue
        if name in OPTIONAL and OPTIONAL[name] not in archive:
            found[each.name] = None
            continue
        shape = [part if isinstance(part, int) else sizes[part] for part in SHAPES.get(name, ())]
        if name in FLAGS:
            found[each.name] = archive.flags(name, *shape)
            continue
        values = archive.numbers(name, *shape)
        if name in POSITIVE and (values <= 0.0).any():
            raise archive.wrong(f"{name} is not positive everywhere")
        if name in PAIRS:
            found[each.name] = (float(values[0]), float(values[1]))
        else:
            found[each.name] = values if name in SHAPES else float(values)
    return found


def _data(archive: Archive, sizes: dict[str, int]) -> MotionData:
    observations = sizes["observations"]
    frame = archive.whole("data.frame", None, below=sizes["frames"])
    start = archive.whole("data.start", None)
    counts = np.diff(start)
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
    impulses = None
    if "data.impulses.frame_s" in archive:
        rows = archive.numbers("data.impulses.row_s", None)
        if not len(rows) or (np.diff(rows) <= 0.0).any():
            raise archive.wrong("data.impulses.row_s does not increase")
        impulses = Impulses(**_fields(archive, {**sizes, "rows": len(rows)}, Impulses, "data.impulses."))
    known = {"frame": frame, "landmark": landmark, "start": start, "order": order, "impulses": impulses}
    return MotionData(**_fields(archive, sizes, MotionData, "data.", form=FORMS[form], **known))


def _fixed(archive: Archive, sizes: dict[str, int], data: MotionData) -> LinearizationPoint:
    at = "fixed.reference."
    if data.camera_is_noisy != (f"{at}camera" in archive):
        raise archive.wrong(f"{at}camera does not agree with data.camera_sigma")
    if f"{at}wrench" in archive and data.impulses is None:
        raise archive.wrong(f"{at}wrench is given without data.impulses")
    series = archive.whole("fixed.steps.series", sizes["steps"])
    if series.min() < 1 or series.max() > MAX_SERIES:
        raise archive.wrong(f"fixed.steps.series is not between 1 and {MAX_SERIES}")
    sizes["series"] = int(series.max())
    steps = Steps(**_fields(archive, sizes, Steps, "fixed.steps.", series=series))
    reference = Iterate(**_fields(archive, sizes, Iterate, at))
    known = {"reference": reference, "steps": steps}
    return LinearizationPoint(**_fields(archive, sizes, LinearizationPoint, "fixed.", **known))
