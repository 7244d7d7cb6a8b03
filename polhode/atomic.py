"""Atomic writing of files: written under a temporary name beside the target, then renamed to it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polhode.errors import InputError


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a path beside ``path``, with the same suffix; rename it to ``path`` when the block succeeds.

    Raises InputError when ``path`` is a device or a pipe, which a renamed file would replace.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path} is a device or a pipe; give the name of a file")
    partial = path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write the whole file or nothing."""
    with replaced(path) as partial:
        partial.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write the whole file (UTF-8, line feeds as given) or nothing."""
    write_bytes(path, content.encode("utf-8"))
