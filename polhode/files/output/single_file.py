"""A file that a command writes: a new one, or one that the same command wrote before."""

import logging
import os
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from polhode.files.atomic import partial_of
from polhode.files.output.place import LEFT_BEHIND, file_place, require_writable, unwritable
from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)


def output_file(
    path: Path,
    command: str,
    example: str,
    is_own: Callable[[Path], bool],
    option: str = "-o",
) -> Path:
    """Where the file goes, links followed; checked before any work is done.

    ``is_own`` tells whether the command wrote an existing file; an empty one may be replaced, too.
    ``option`` names the file on the command line. Raises InputError: anything else is there, the name belongs
    to a run or a dataset, or the place cannot be written.
    """
    place = file_place(path, example)
    if place.exists() and place.stat().st_size > 0 and not is_own(place):
        raise InputError(
            f"{path}: exists and was not written by polhode {command}, so it stays; choose another {option}"
        )
    require_writable(place.parent, path)
    try:
        partial_of(place).exists()
    except OSError as error:
        raise unwritable(path, error) from error
    return place


def make_parent(place: Path, shown: Path) -> None:
    """Make the folder of a file, and remove what killed processes left of that file. Raises InputError."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(shown, error) from error
    _remove_dead(place.parent, re.escape(place.stem), re.escape(place.suffix))


def remove_all_partials(folder: Path) -> None:
    """Remove the temporary files of killed processes in a folder of ours; its folders are left alone. It need
    not exist."""
    if folder.is_dir():
        _remove_dead(folder, ".+", r"(?:\.\w+)?")


def _remove_dead(folder: Path, stem: str, suffix: str) -> None:
    name = re.compile(rf"\.{stem}\.partial-(\d+){suffix}")
    for entry in os.scandir(folder):
        found = name.fullmatch(entry.name)
        if found is None or not entry.is_file(follow_symlinks=False):
            continue
        try:
            os.kill(int(found[1]), 0)
        except (ProcessLookupError, OverflowError):
            with suppress(OSError):
                Path(entry.path).unlink()
                _log.warning(LEFT_BEHIND, entry.path)
        except PermissionError:
            pass
