"""One process at a time in a folder: a lock that ends with the process that holds it."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from polhode.files.output.place import unwritable
from polhode.runtime.errors import InputError


@contextmanager
def at_work(folder: Path, shown: Path) -> Iterator[None]:
    """Lock an existing folder while the block runs. Raises InputError: another process has locked it."""
    with opened(folder) as handle:
        _require_lock(handle, shown)
        yield


@contextmanager
def occupied(folder: Path, shown: Path) -> Iterator[None]:
    """Make a folder with those above it, and lock it while the block runs; those that were missing and hold
    nothing at the end are removed.

    Raises InputError: another process has locked it, or it cannot be made.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        with locked(folder, shown):
            yield
    finally:
        for each in missing:
            with suppress(OSError):
                each.rmdir()


@contextmanager
def locked(path: Path, shown: Path) -> Iterator[None]:
    """Make a folder and lock it, at most until this process ends.

    Raises InputError: another process has locked it, or it cannot be made.
    """
    while True:
        try:
            path.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise unwritable(shown, error) from error
        try:
            _require_lock(handle, shown)
            # The process that held the lock may have moved or removed this folder.
            if path.exists() and os.path.samestat(os.fstat(handle), path.lstat()):
                yield
                return
        finally:
            os.close(handle)


@contextmanager
def opened(folder: Path) -> Iterator[int]:
    """A handle of an existing folder. Raises OSError."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield handle
    finally:
        os.close(handle)


def lock(handle: int, wait: bool = False) -> bool:
    """Lock an open folder, as long as its handle is open; ``wait`` until whoever holds it has ended.

    False: another process holds it. Some network file systems cannot lock folders, and prevent nothing.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def _require_lock(handle: int, shown: Path) -> None:
    if not lock(handle):
        raise InputError(
            f"{shown}: another polhode is at work there; wait until it ends, stop it, or choose another place"
        )
