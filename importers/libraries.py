"""Libraries that only some sources need, an extra of the installation."""

from importlib import import_module
from typing import Any

from polhode.errors import InputError
from polhode.optional_parts import part_with


def required(module: str, distribution: str, what: str) -> Any:
    """Import a module. Raises InputError, with the command that installs it, where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{what} need the library {distribution}, which is not installed: "
            f"{part_with(module.partition('.')[0]).how_to_install}"
        ) from None
