"""The file of a problem gives back every number."""

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.backend.problem.wrench import N_WRENCH, impulses_of
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import read_problem, write_problem
from polhode.compare.problem.sources import SCENES, synthetic_problem
from polhode.config.backend_settings import Backend
from polhode.records.tracks import Wrench


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Every field that is no record itself, by its path."""
    if not is_dataclass(value) or isinstance(value, type):
        return {path: value}
    found: dict[str, Any] = {}
    for each in fields(value):
        found |= leaves(getattr(value, each.name), f"{path}.{each.name}")
    return found


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
    assert all(value is not None for path, value in leaves(with_wrench).items() if path != ".truth.mesh")
    for problem in (small, with_wrench, replace(small, truth=None)):
        write_problem(problem, tmp_path / "x.npz")
        mine, theirs = leaves(read_problem(tmp_path / "x.npz")), leaves(problem)
        assert mine.keys() == theirs.keys()
        for path, value in theirs.items():
            assert type(mine[path]) is type(value), path
            if isinstance(value, np.ndarray):
                assert mine[path].dtype == value.dtype, path
                np.testing.assert_array_equal(mine[path], value, err_msg=path)
            else:
                assert mine[path] == value, path
