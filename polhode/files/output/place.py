"""Where a path that the user gave leads, and the places that no command writes to."""

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from polhode.files.atomic import ANOTHER_PLACE, refused
from polhode.files.output.run_files import PICTURES, SCHEMA, SUMMARY, is_run_file
from polhode.runtime.errors import InputError

LEFT_BEHIND = "%s: left by a command that was stopped; removed"
"""The warning about what a killed command left."""


def folder_place(path: Path, shown: Path | None = None) -> Path:
    """The folder that ``path`` names, links followed; it need not exist. ``shown``: its name in messages.

    Raises InputError for a file, a device, a circle of links, a name that is not UTF-8, and where nothing may
    be written.
    """
    place, shown = _resolved(path, shown or path), shown or path
    if place.exists() and not place.is_dir():
        raise InputError(f"{shown}: this is a file; choose another folder")
    _require_outside(place, path, shown)
    return place


def file_place(path: Path, example: str) -> Path:
    """The same of a file; ``example``: a name of such a file. Raises InputError also for a folder."""
    place = _resolved(path, path)
    if place.is_dir():
        raise InputError(f"{path} is a folder: -o names a file, such as {example}")
    _require_outside(place, path, path)
    return place


def require_not_current(place: Path, shown: Path) -> None:
    """Raise InputError if the current folder is ``place`` or inside it: whoever stands in a folder that
    another one replaces is left in one that is gone. A folder that is missing is no current one."""
    try:
        current = Path.cwd()
    except FileNotFoundError:
        return
    if current == place:
        raise InputError(f"{shown} is the current folder, which cannot be replaced; give a folder inside it")
    if place in current.parents:
        raise InputError(
            f"{shown} contains the current folder, so it cannot be replaced; start polhode elsewhere"
        )


def require_writable(folder: Path, shown: Path, remedy: str = ANOTHER_PLACE) -> None:
    """Try to write in ``folder``, or where it would be made. Raises InputError, with the remedy, when that is
    refused."""
    while not folder.exists():
        folder = folder.parent
    try:
        handle, name = tempfile.mkstemp(prefix=".polhode-trial-", dir=folder)
        try:
            os.write(handle, bytes(4096))
        finally:
            os.close(handle)
            Path(name).unlink()
    except OSError as error:
        raise unwritable(shown, error, remedy) from error


def beginning_of(path: Path, within_bytes: int = 4096) -> bytes:
    """The first bytes of a regular file, by which a program recognizes its own; of anything else none."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as stream:
            return stream.read(within_bytes)
    except OSError:
        return b""


def begins_with(path: Path, word: str) -> bool:
    """Whether the beginning of a regular file contains the word by which a program names itself."""
    return word.encode() in beginning_of(path)


def printable(name: object) -> str:
    """A name of a file on any terminal: bytes that are no UTF-8, as escapes."""
    return os.fsencode(str(name)).decode("utf-8", "backslashreplace")


def unwritable(shown: Path, error: OSError, remedy: str = ANOTHER_PLACE) -> InputError:
    """The line about a place that cannot be written, before any work was done."""
    return InputError(refused(shown, "cannot write here", error, remedy))


def _resolved(path: Path, shown: Path) -> Path:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        mode = stat.S_IFREG
    except OSError as error:
        what = {errno.ELOOP: "a link that leads back to itself", errno.ENOTDIR: "part of this path is a file"}
        reason = what.get(error.errno or 0, error.strerror)
        raise InputError(f"{shown}: cannot write here ({reason}); choose another place") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{shown} is a device or a pipe; choose another place")
    place = Path(os.path.realpath(path))
    try:
        f"{path.name}{place.name}".encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{shown}: this name is not UTF-8, as results that contain it must be; choose another"
        ) from None
    return place


def _dataset_of(place: Path, path: Path) -> Path | None:
    """The dataset into which ``path`` leads, by a folder ``mav0`` that it goes through, itself or a link.

    The folder to which a link ``mav0`` leads has another name: it is known by the list of images in it.
    """
    for way in _ways(path.absolute()):
        for above in (way, *way.parents):
            if above.name == "mav0" and place.is_relative_to(os.path.realpath(above)):
                return above.parent
    lists = (above for above in (place, *place.parents) if (above / "cam0" / "data.csv").is_file())
    return next(lists, None)


def _ways(path: Path) -> Iterator[Path]:
    """The path, and what it is when its links are followed one after the other."""
    yield path
    for above in (*reversed(path.parents), path):
        if above.is_symlink():
            yield from _ways(above.parent / above.readlink() / path.relative_to(above))
            return


def _require_outside(place: Path, path: Path, shown: Path) -> None:
    if (dataset := _dataset_of(place, path)) is not None:
        raise InputError(
            f"{shown}: inside the dataset {dataset}, where nothing is written; choose another place"
        )
    for folder in place.parents:
        name = place.relative_to(folder).as_posix()
        is_of_run = is_run_file(name) or name.split("/")[0] == PICTURES
        if is_of_run and begins_with(folder / SUMMARY, SCHEMA):
            raise InputError(
                f"{shown}: this name belongs to the results of the run {folder}; choose another place"
            )
