"""A small Monte Carlo problem, frozen."""

from dataclasses import replace
from pathlib import Path

import pytest

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import write_problem
from polhode.compare.problem.sources import SCENES, synthetic_problem
from polhode.config.backend_settings import Backend


@pytest.fixture(scope="session")
def small() -> MeasuredProblem:
    """A flip, 20 frames, 1 px."""
    scene = replace(SCENES["flip"], frames=20, landmarks=300, min_inliers=6)
    return synthetic_problem("small", scene, 0, Backend(process_noise="given"))


@pytest.fixture(scope="session")
def small_file(small: MeasuredProblem, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, as a solver's process reads it."""
    path = tmp_path_factory.mktemp("problem") / "small.npz"
    write_problem(small, path)
    return path
