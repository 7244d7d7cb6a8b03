"""Folders that take the place of others, so that a kill at any moment loses nothing.

The new folder and the old one change places in one step where the file system can (renameat2 of Linux). What
in the old folder is not ours is linked into the new one before, and is thus never in a hidden folder alone.
The old folder is then removed name by name: only files that are ours by name, and those that went along.
"""

import ctypes
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from polhode.files.atomic import sync

IsOwn = Callable[[str], bool]
"""Whether a file is ours, by its name relative to the folder, with "/"."""


def entries(folder: Path) -> Iterator[tuple[str, bool]]:
    """Every file and folder below ``folder``, without following links: relative name, whether a folder.

    A folder comes after what it contains. Raises OSError for one that cannot be read.
    """

    def fail(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):
            raise error

    for root, folders, files in os.walk(folder, topdown=False, onerror=fail):
        for name in (*files, *folders):
            path = Path(root) / name
            yield path.relative_to(folder).as_posix(), name in folders and not path.is_symlink()


def foreign(folder: Path, is_own: IsOwn) -> list[str]:
    """Names of what is not ours: files, links, devices, and folders that hold nothing at all; sorted.

    A file is ours by its name, if it is a regular one.
    """
    found: list[str] = []
    filled: set[str] = set()
    for name, is_folder in entries(folder):
        if name not in filled if is_folder else not (is_own(name) and is_regular(folder / name)):
            found.append(name)
        filled.update(parent.as_posix() for parent in Path(name).parents)
    return sorted(found)


def carry(names: list[str], source: Path, destination: Path) -> None:
    """Make files and folders of ``source`` appear in ``destination`` as well: as links, or as copies where
    the file system has none. Raises OSError, FileExistsError where there is such a name already."""
    for name in names:
        path, new = source / name, destination / name
        _make_folders(Path(name).parent, source, destination)
        if path.is_dir() and not path.is_symlink():
            new.mkdir(exist_ok=True)
            shutil.copystat(path, new)
            continue
        try:
            os.link(path, new, follow_symlinks=False)
        except OSError as error:
            if isinstance(error, FileExistsError) or not (path.is_symlink() or is_regular(path)):
                raise
            shutil.copy2(path, new, follow_symlinks=False)


def _make_folders(name: Path, source: Path, destination: Path) -> None:
    for part in (*reversed(name.parents), name):
        if not (destination / part).is_dir():
            (destination / part).mkdir()
            shutil.copystat(source / part, destination / part)


def aside_of(place: Path) -> Path:
    """Where the old folder waits between the two steps of ``exchange``."""
    return place.with_name(f".{place.name}.old")


def exchange(new: Path, place: Path) -> Path:
    """Let the folder ``new`` and the one at ``place`` change places; where the old one is now.

    Where they cannot in one step, the old one waits at ``aside_of(place)`` between the two steps.
    """
    if _renameat2(new, place):
        return new
    aside = aside_of(place)
    place.rename(aside)
    try:
        new.rename(place)
    except OSError:
        aside.rename(place)
        raise
    return aside


def _renameat2(one: Path, other: Path) -> bool:
    """Exchange two paths in one step; False: this system or file system cannot."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    at_current, flag_exchange = -100, 2
    return bool(call(at_current, os.fsencode(one), at_current, os.fsencode(other), flag_exchange) == 0)


def empty(folder: Path, is_own: IsOwn, twin: Path | None = None) -> list[str]:
    """Remove what is ours in a folder: files by their names, and those that are also in ``twin``.

    Links are removed, never followed; a folder is removed when it is empty. Returns what is left.
    """
    left: list[str] = []
    for name, is_folder in entries(folder):
        path = folder / name
        with suppress(FileNotFoundError):
            if is_folder:
                with suppress(OSError):
                    path.rmdir()
            elif is_own(name) or (twin is not None and is_same(path, twin / name)):
                path.unlink()
            else:
                left.append(name)
    return sorted(left)


def remove(folder: Path, is_own: IsOwn, twin: Path | None = None) -> list[str]:
    """The same, and the folder itself if nothing is left."""
    left = empty(folder, is_own, twin)
    with suppress(OSError):
        folder.rmdir()
    return left


def move(names: list[str], source: Path, destination: Path) -> None:
    """Move what ``destination`` has no such name of, then remove the folders that are empty."""
    for name in names:
        if not os.path.lexists(destination / name):
            _make_folders(Path(name).parent, source, destination)
            (source / name).rename(destination / name)
    remove(source, lambda name: False)


def sync_all(folder: Path) -> None:
    """Wait until a folder with all its files is on the disk; of many, all that the system holds back."""
    names = [name for name, _ in entries(folder)]
    if len(names) > 200:
        os.sync()
        return
    for path in (*(folder / name for name in names), folder):
        if path.is_dir() or is_regular(path):
            sync(path)


def is_regular(path: Path) -> bool:
    """Whether there is a file itself, no link to one."""
    return stat.S_ISREG(path.lstat().st_mode)


def is_same(path: Path, other: Path) -> bool:
    """Whether both names lead to one file, or to a copy of it that is as old."""
    try:
        one, two = path.lstat(), other.lstat()
    except OSError:
        return False
    if os.path.samestat(one, two):
        return True
    alike = (one.st_mode, one.st_size, one.st_mtime_ns) == (two.st_mode, two.st_size, two.st_mtime_ns)
    return alike and (stat.S_ISLNK(one.st_mode) or path.read_bytes() == other.read_bytes())
