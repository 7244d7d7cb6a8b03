"""A stored row is used again only when everything that determines it is the same."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from polhode.compare import comparison
from polhode.compare.comparison import stamp
from polhode.compare.problem import fingerprint
from polhode.compare.problem.fingerprint import code_of, of_problem
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.registry import entries


def numbers(value: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Where arrays and floats lie in a problem."""
    if is_dataclass(value) and not isinstance(value, type):
        return [
            found
            for each in fields(value)
            for found in numbers(getattr(value, each.name), (*path, each.name))
        ]
    if isinstance(value, float) or (isinstance(value, np.ndarray) and value.size > 0):
        return [path]
    return []


def with_another(value: Any, path: tuple[str, ...]) -> Any:
    """The same with the number at ``path`` changed a little."""
    if path:
        return replace(value, **{path[0]: with_another(getattr(value, path[0]), path[1:])})
    if isinstance(value, float):
        return value + 1.0
    changed = value.copy()
    changed.flat[-1] = not changed.flat[-1] if changed.dtype == bool else changed.flat[-1] + 1
    return changed


def test_every_number_of_a_problem_is_in_its_fingerprint(small: MeasuredProblem) -> None:
    known, found = of_problem(small), {path: path for path in numbers(small)}
    fixed = {path[1] for path in found if path[0] == "fixed" and len(path) == 2}
    assert {"prior", "gauge_information", "A"} <= fixed
    assert ("fixed", "steps", "W_t") in found and ("fixed", "steps", "W_r") in found
    assert ("truth", "r_N") in found and ("truth", "k1") in found and ("solution",) in found
    for path in found:
        same = of_problem(with_another(small, path)) == known
        assert same == (path == ("prepared_s",)), path


def test_what_has_no_fingerprint_is_not_passed_over(small: MeasuredProblem) -> None:
    assert of_problem(replace(small, truth=None)) != of_problem(small)
    with pytest.raises(TypeError, match="no fingerprint of object"):
        of_problem(replace(small, truth=object()))  # type: ignore[arg-type]


def test_a_stamp_holds_solver_limit_versions_code_and_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    (ceres, gtsam) = entries(("ceres", "gtsam_lm"))
    known = stamp("p", ceres, 60.0)
    assert known == stamp("p", ceres, 60.0)
    assert known["versions"].keys() >= {"casadi", "numpy", "scipy", "pyceres"}
    assert "gtsam" in stamp("p", gtsam, 60.0)["versions"]
    others = [stamp("q", ceres, 60.0), stamp("p", gtsam, 60.0), stamp("p", ceres, 61.0)]
    others.append(stamp("p", replace(ceres, options={"a": "b"}), 60.0))
    monkeypatch.setattr(fingerprint, "version", lambda name: "another" if name == "pyceres" else "0")
    others.append(stamp("p", ceres, 60.0))
    monkeypatch.setattr(comparison, "code_of", lambda: "another")
    others.append(stamp("p", ceres, 60.0))
    monkeypatch.setattr(comparison, "machine", lambda: "another")
    others.append(stamp("p", ceres, 60.0))
    for n, other in enumerate(others):
        assert other != known and other not in others[:n]


def test_the_code_of_a_package_is_that_of_all_its_modules() -> None:
    assert code_of(("polhode.compare.solvers",)) != code_of(("polhode.compare.solvers.ours",))
    assert code_of(("backend",)) == code_of(("backend",)) != code_of(("polhode",))
