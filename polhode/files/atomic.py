"""Atomic writing of files: written under a temporary name beside the target, then renamed to it.

A file that takes the place of another is on the disk before the other is given up. Where the system refuses
(a full or read-only disk), the error is one line with the file, the reason and a remedy.
"""

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from polhode.runtime.errors import InputError, RunFailure

REFUSALS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO}
"""Errors by which a system refuses to write; others may be of something else that the writer does."""
ANOTHER_PLACE = "choose another place"
"""What to do about a place that refuses, where the command takes another one."""


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a path beside ``path``, with the same suffix; rename it to ``path`` when the block succeeds.

    Raises InputError when ``path`` is a device or a pipe, which a renamed file would replace; RunFailure when
    the file cannot be written.
    """
    partial = partial_of(path)
    try:
        _require_no_device(path)
        yield partial
        _secure(partial, path)
        partial.replace(path)
    except OSError as error:
        if error.errno in REFUSALS:
            raise write_failure(path, error) from error
        raise
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write the whole file or nothing. Raises InputError and RunFailure as ``replaced``."""
    write_all({path: content})


def write_text(path: Path, content: str) -> None:
    """Write the whole file (UTF-8, line feeds as given) or nothing."""
    write_bytes(path, content.encode("utf-8"))


def write_all(files: Mapping[Path, bytes]) -> None:
    """Write all files or none: each is on the disk under a temporary name before the first takes its place.

    They take their places in the order given, one right after the other: a kill between two of these steps
    leaves new files beside old ones. Raises InputError and RunFailure as ``replaced``.
    """
    partials = {path: partial_of(path) for path in files}
    path = next(iter(files), Path())
    try:
        for path, content in files.items():
            _require_no_device(path)
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            partials[path].write_bytes(content)
        for path, partial in partials.items():
            _secure(partial, path)
        for path, partial in partials.items():
            partial.replace(path)
    except OSError as error:
        raise write_failure(path, error) from error
    finally:
        for partial in partials.values():
            with suppress(OSError):
                partial.unlink(missing_ok=True)


def partial_of(path: Path) -> Path:
    """The temporary name under which this process writes a file."""
    return path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}")


def write_failure(path: Path, error: OSError) -> RunFailure:
    """The line about a file that could not be written: where, why, and what to do."""
    return RunFailure(refused(path, "cannot be written", error))


def refused(where: Path, what: str, error: OSError, remedy: str = ANOTHER_PLACE) -> str:
    """One line: where, what was refused, the system's reason, a remedy."""
    reason = error.strerror or str(error) or type(error).__name__
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return f"{where}: {what} ({reason}); {'free some space there, or ' if full else ''}{remedy}"


def sync(path: Path) -> None:
    """Wait until a file or the entries of a folder are on the disk, where the system can tell."""
    with suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _secure(partial: Path, path: Path) -> None:
    """Have the new content on the disk before an old one is given up."""
    if path.exists():
        sync(partial)


def _require_no_device(path: Path) -> None:
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path} is a device or a pipe; give the name of a file")
