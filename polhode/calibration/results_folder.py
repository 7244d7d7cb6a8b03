"""The folder that ``polhode calibrate`` writes: checked before the work, written whole.

A calibration and a verification may be in the same folder: each replaces its own files.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from polhode.files.output.marked_folder import claim, marked_folder, read_mark, write_files
from polhode.files.output.single_file import make_parent
from polhode.runtime.errors import InputError


@contextmanager
def results_folder(path: Path, command: str, files: Sequence[str]) -> Iterator[Path]:
    """The folder, links followed, locked until the block ends. Raises InputError for one that is not ours.

    ``files``: all names that the command may ever write there, some below folders.
    """
    with marked_folder(path, command, files.__contains__) as place:
        own = (read_mark(place) or {}).get(command, ())
        for name in files:
            target = place / name
            below = target.parent != place
            if below and (target.parent.is_symlink() or (target.exists() and name not in own)):
                raise InputError(
                    f"{path}: {name} was not written by polhode {command}; choose another folder"
                )
        yield place


def write_results(place: Path, command: str, files: Mapping[str, bytes], names: Sequence[str]) -> None:
    """All files, or none. Raises RunFailure."""
    claim(place, command, list(files))
    for name in files:
        make_parent(place / name, place)
    write_files(place, command, files, names.__contains__)
