"""A function of the user that measures a point: the step ``measure`` of a study.

A study's file names no code, so that whoever opens one of somebody else executes nothing: the command line
names the function.
"""

import hashlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from polhode.config import Config
from polhode.runtime.errors import InputError, one_line

MEASURE, CASE = "measure", "case"
"""The step; the section of settings that are for it alone"""


@dataclass(frozen=True)
class MeasuredPoint:
    """What the function is given."""

    case: dict[str, Any]
    """The point's settings that begin with "case.", without that"""
    config: Config
    """The point's configuration"""
    sequence: Path | None
    """The stereo sequence that it simulated or read"""
    run: Path | None
    """Folder of its run"""
    folder: Path
    """Where files can be written, which are kept as the study asks (``keep: whole``)"""


@dataclass(frozen=True)
class Measurement:
    """A function, and what its code adds to the addresses of the points."""

    function: Callable[[MeasuredPoint], Mapping[str, Any]]
    """Must be known to pickle"""
    digest: str = ""
    """Of its code"""
    file: Path | None = None
    """That workers must see"""


@dataclass(frozen=True)
class _FunctionOfFile:
    """A function of a file, which each process loads when it first needs it."""

    file: Path
    name: str

    def __call__(self, point: MeasuredPoint) -> Mapping[str, Any]:
        found: Mapping[str, Any] = getattr(_module(self.file), self.name)(point)
        return found


def measurement_of(words: str) -> Measurement:
    """The function that ``FILE.py:FUNCTION`` names.

    Raises InputError: there is no such file or function, or the file cannot be loaded.
    """
    path, colon, name = words.rpartition(":")
    file = Path(path).resolve()
    if not colon or not name.isidentifier() or file.suffix != ".py":
        raise InputError(f"--measure {words}: give a file and a function in it, such as measure.py:errors")
    if not file.is_file():
        raise InputError(f"--measure {words}: {path} is missing; give an existing file")
    try:
        module = _module(file)
    except Exception as error:
        said = one_line(f"{type(error).__name__}: {error}")
        raise InputError(f"--measure {words}: {path} cannot be loaded ({said})") from error
    if not callable(getattr(module, name, None)):
        raise InputError(f"--measure {words}: {path} has no function '{name}'")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return Measurement(_FunctionOfFile(file, name), f"{digest}:{name}", file)


def _module(file: Path) -> ModuleType:
    """A file as a module, loaded once in each process; its neighbours can be imported by it."""
    name = f"polhode_measurement_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    found = importlib.util.spec_from_file_location(name, file)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    sys.modules[name] = module
    try:
        found.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
