"""Rerun is an extra of the installation: whether it is there, and how to get it."""

import os
from importlib import import_module

from polhode.errors import InputError
from polhode.optional_parts import missing_message


def require_rerun(what: str) -> None:
    """Raise InputError, with the command that installs it, where Rerun is missing. ``what`` needs it."""
    # Its own messages go to standard error, which holds one line: that of an error of ours.
    os.environ.setdefault("RUST_LOG", "off")
    try:
        import_module("rerun")
    except ImportError:
        raise InputError(f"{what}: {missing_message('rerun')}") from None
