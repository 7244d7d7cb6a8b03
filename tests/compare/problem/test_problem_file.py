"""The file of a problem gives back every number, executes nothing, and is refused when anything is wrong."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.backend.problem.wrench import N_WRENCH, impulses_of
from polhode.compare.problem.fingerprint import of_problem
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import SUFFIX, read_problem, write_problem
from polhode.compare.problem.sources import SCENES, synthetic_problem
from polhode.config.backend_settings import Backend
from polhode.records.tracks import Wrench
from polhode.run_directory.archives import Arrays, write_arrays
from polhode.runtime.errors import InputError
from tests.trap import Trap, trap


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Every field that is no record itself, by its path."""
    if not is_dataclass(value) or isinstance(value, type):
        return {path: value}
    found: dict[str, Any] = {}
    for each in fields(value):
        found |= leaves(getattr(value, each.name), f"{path}.{each.name}".removeprefix("."))
    return found


def assert_same(found: MeasuredProblem, expected: MeasuredProblem) -> None:
    mine, theirs = leaves(found), leaves(expected)
    assert mine.keys() == theirs.keys()
    for path, value in theirs.items():
        assert type(mine[path]) is type(value), path
        if isinstance(value, np.ndarray):
            assert mine[path].dtype == value.dtype, path
            np.testing.assert_array_equal(mine[path], value, err_msg=path)
        else:
            assert mine[path] == value, path


@pytest.fixture(scope="module")
def with_wrench(small: MeasuredProblem) -> MeasuredProblem:
    """A noisy camera, a known wrench, loose steps: everything that may be absent is there."""
    scene = replace(
        SCENES["flip"], frames=20, landmarks=300, min_inliers=6, sigma_camera_p_m=1e-3,
        sigma_camera_theta_rad=1e-3,
    )  # fmt: skip
    plain = synthetic_problem("wrench", scene, 0, Backend(process_noise="given", inertia="ratios_axes"))
    stamps = (np.concatenate([[0.0], np.cumsum(plain.data.dt_s)]) * 1e9).astype(np.int64)
    known = impulses_of(Wrench(stamps[::4], np.ones((5, 3)), np.full((5, 3), 0.1)), stamps)
    steps, torque = plain.fixed.steps, known.torque(plain.fixed.steps.series)
    steps = replace(steps, force_increments=known.force_increments, torque_P=torque)
    reference = replace(plain.fixed.reference, wrench=np.arange(N_WRENCH, dtype=float), R_torque=np.eye(3))
    longer = np.zeros(len(plain.cold) + N_WRENCH)
    loose = np.zeros(plain.data.n_frames - 1, dtype=bool)
    truth = plain.truth and replace(plain.truth, mass_kg=3.0)
    data = replace(plain.data, impulses=known, loose=loose)
    fixed = replace(plain.fixed, steps=steps, reference=reference)
    return replace(plain, data=data, fixed=fixed, cold=longer, solution=longer, truth=truth)


def test_what_is_read_is_what_was_written(
    small: MeasuredProblem, with_wrench: MeasuredProblem, tmp_path: Path
) -> None:
    assert all(value is not None for path, value in leaves(with_wrench).items() if path != "truth.mesh")
    for problem in (small, with_wrench, replace(small, truth=None)):
        path, again = tmp_path / f"x{SUFFIX}", tmp_path / f"y{SUFFIX}"
        write_problem(problem, path)
        found = read_problem(path)
        assert_same(found, problem)
        assert of_problem(found) == of_problem(problem)
        write_problem(found, again)
        assert path.read_bytes() == again.read_bytes()


def test_nothing_in_the_file_is_executed(small: MeasuredProblem, tmp_path: Path) -> None:
    sprung, path = tmp_path / "sprung", tmp_path / f"x{SUFFIX}"
    path.write_bytes(trap(sprung))
    with pytest.raises(InputError, match="not a readable archive"):
        read_problem(path)
    write_problem(small, path)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    trapped = np.empty((), dtype=object)
    trapped[()] = Trap(sprung)
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=True, **{**arrays, "cold": trapped})
    with pytest.raises(InputError, match="not a readable archive"):
        read_problem(path)
    assert not sprung.exists()


def _set(name: str, at: Any, value: Any) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][at] = value

    return change


WRONG: dict[str, tuple[Callable[[Arrays], Any], str]] = {
    "another format": (lambda a: a.update(format=np.asarray("problem 0")), "the format is not"),
    "a missing array": (lambda a: a.pop("data.uvd_px"), "the array data.uvd_px is missing"),
    "a frame outside": (_set("data.frame", 3, 20), "data.frame points outside"),
    "starts that go back": (_set("data.start", 1, 400), "data.start does not divide"),
    "another landmark": (_set("data.landmark", 0, 1), "data.landmark does not agree"),
    "a negative order": (_set("data.order", 0, -1), "data.order is negative"),
    "another inertia": (lambda a: a.update({"data.form": np.asarray("os.system")}), "'os.system' is none of"),
    "a number as text": (lambda a: a.update({"data.form": np.asarray(1)}), "expected a text"),
    "no step": (_set("data.dt_s", 0, 0.0), "data.dt_s is not positive"),
    "NaN": (_set("cold", 0, np.nan), "cold holds NaN"),
    "infinity": (_set("fixed.A", 0, np.inf), "fixed.A holds NaN or infinity"),
    "no series": (_set("fixed.steps.series", 0, 0), "fixed.steps.series is not between 1 and"),
    "fewer unknowns": (lambda a: a.update(cold=a["cold"][:-1]), "cold is 952, expected 953"),
    "fewer landmarks": (
        lambda a: a.update({"fixed.reference.p_G": a["fixed.reference.p_G"][:-1]}),
        "fixed.reference.p_G is 234 x 3, expected 235 x 3",
    ),
    "times that stand": (_set("truth.timestamps_ns", 1, 0), "truth.timestamps_ns does not increase"),
    "flags as numbers": (lambda a: a.update({"data.nodes": np.zeros(19)}), "expected booleans"),
    "a camera that is exact": (
        lambda a: a.update({"fixed.reference.camera": np.zeros((20, 6))}),
        "does not agree with data.camera_sigma",
    ),
    "a wrench of nothing": (
        lambda a: a.update({"fixed.reference.wrench": np.zeros(N_WRENCH)}),
        "is given without data.impulses",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line_that_names_it(case: str, small: MeasuredProblem, tmp_path: Path) -> None:
    change, expected = WRONG[case]
    path = tmp_path / f"x{SUFFIX}"
    write_problem(small, path)
    with np.load(path) as archive:
        arrays: Arrays = {name: archive[name] for name in archive.files}
    change(arrays)
    write_arrays(path, arrays)
    with pytest.raises(InputError) as caught:
        read_problem(path)
    text = str(caught.value)
    assert expected in text and text.startswith(f"{path}: ") and "\n" not in text
    assert "run the comparison again" in text
