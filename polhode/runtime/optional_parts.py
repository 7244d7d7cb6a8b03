"""What an installation may lack: optional parts, what each is for, and the command that adds it.

In a checkout ``make extras`` adds all of them; elsewhere pip adds one, as an extra of the package.
"""

import os
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from polhode.runtime.errors import InputError

PACKAGE = Path(__file__).resolve().parents[1]
CHECKOUT = PACKAGE.parent / "Makefile"
"""Beside the package only in a checkout"""


@dataclass(frozen=True)
class OptionalPart:
    """Packages that only some commands need."""

    extra: str
    """Name of the extra in pyproject.toml"""
    modules: dict[str, str]
    """Module that is imported -> the name people know it by"""
    purpose: str
    """What it is for, or what happens without it"""

    @property
    def missing(self) -> list[str]:
        """Names of what is not installed."""
        return [name for module, name in self.modules.items() if find_spec(module) is None]

    @property
    def how_to_install(self) -> str:
        """The command that adds it."""
        return "make extras" if CHECKOUT.is_file() else f"pip install 'polhode[{self.extra}]'"


OPTIONAL_PARTS: tuple[OptionalPart, ...] = (
    OptionalPart(
        "solvers", {"pyceres": "Ceres", "gtsam": "GTSAM"},
        "their rows of polhode compare; without them these rows say missing",
    ),
    OptionalPart(
        "export", {"vhacdx": "V-HACD"},
        "convex pieces of the bodies for simulators (urdf, mjcf, sdf); without it they get their convex hull",
    ),
    OptionalPart(
        "import", {"rosbags": "rosbags", "mcap": "mcap", "av": "PyAV"},
        "bags and videos in polhode import and polhode calibrate; folders of images need neither",
    ),
    OptionalPart("view", {"rerun": "Rerun"}, "polhode view, and polhode run --view and --view-save"),
    OptionalPart("train", {"tensorboard": "tensorboard"}, "curves of polhode train, which needs it"),
    OptionalPart(
        "pandas", {"pandas": "pandas"},
        "polhode.load(RUN).to_pandas() and polhode.load_study(DIR) in Python",
    ),
)  # fmt: skip


def part_with(module: str) -> OptionalPart:
    """The part that a module belongs to. Raises KeyError: it belongs to none."""
    return {name: part for part in OPTIONAL_PARTS for name in part.modules}[module]


def require_part(module: str, what: str) -> None:
    """Raise InputError, with the command that installs the module, where it is missing. ``what`` needs it."""
    # Rerun's own messages go to standard error, which holds one line: that of an error of ours.
    os.environ.setdefault("RUST_LOG", "off")
    try:
        import_module(module)
    except ImportError:
        raise InputError(f"{what}: {missing_message(module)}") from None


def missing_part(module: str) -> str | None:
    """What ``missing_message`` says, if the module is missing."""
    return missing_message(module) if find_spec(module) is None else None


def missing_message(module: str) -> str:
    """That a module is not installed, and the command that adds it where an optional part has the module."""
    try:
        part = part_with(module)
    except KeyError:
        return f"{module} is not installed"
    return f"{part.modules[module]} is not installed ({part.how_to_install})"
