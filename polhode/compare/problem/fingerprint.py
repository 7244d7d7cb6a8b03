"""Digests of all that determines a row: a stored row whose digests differ is measured again.

The problem: measurements, fixed part of the cost (references, whitening, prior, gauge), all starts, truth.
The solver: its entry, the versions of its packages, our code that it runs. The machine: rows contain times.
"""

import hashlib
import platform
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem

BASE = ("polhode", "numpy", "scipy", "numba", "casadi")
"""Distributions that every row depends on; IPOPT with its linear algebra and OSQP come with CasADi."""
SHOWN = ("casadi", "scipy", "gtsam", "pyceres")
"""Those whose versions are shown."""
CODE = (
    "polhode.backend", "polhode.config.backend_settings", "polhode.geometry.lie", "polhode.runtime.threads",
    *(f"polhode.compare.{name}" for name in (
        "problem.assessment", "problem.blocks", "problem.measured_problem", "solver", "solver_process",
        "solvers")),
)  # fmt: skip
"""Our modules, and packages with all their modules, that a row depends on."""
UNIMPORTANT: dict[type, tuple[str, ...]] = {MeasuredProblem: ("name", "prepared_s")}
"""Fields that do not affect the solution."""


class _Digest(Protocol):
    def update(self, content: bytes, /) -> None: ...


def of_problem(problem: MeasuredProblem) -> str:
    """Digest of measurements, cost, starts and truth."""
    digest = hashlib.sha256()
    _add(digest, problem)
    return digest.hexdigest()[:16]


def versions(distributions: Iterable[str] = SHOWN) -> dict[str, str]:
    """Versions of those distributions that are installed."""
    found = {}
    for name in distributions:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def machine() -> str:
    """Processor, system and Python."""
    return f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}"


@cache
def code_of(names: tuple[str, ...] = CODE) -> str:
    """Digest of the source of modules, and of packages with all their modules."""
    digest = hashlib.sha256()
    for name in names:
        spec = find_spec(name)
        assert spec is not None and spec.origin is not None
        origin = Path(spec.origin)
        for file in sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]:
            digest.update(file.name.encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _add(digest: _Digest, value: Any) -> None:
    """Add a value with its type, so that different values differ. Raises TypeError for an unknown type."""
    digest.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        for each in fields(value):
            if each.name not in UNIMPORTANT.get(type(value), ()):
                digest.update(each.name.encode())
                _add(digest, getattr(value, each.name))
    elif isinstance(value, tuple | list):
        for item in value:
            _add(digest, item)
    elif value is None or isinstance(value, bool | int | float | str | np.generic):
        digest.update(repr(value).encode())
    elif hasattr(value, "name") and hasattr(value, "second_moments"):
        # a form of the inertia has no values of its own
        digest.update(str(value.name).encode())
    else:
        raise TypeError(f"no fingerprint of {type(value).__name__}")
