"""A folder that commands write their results into: it has a mark, which lists what each of them wrote there.

A new or empty folder gets the mark. In a folder with the mark, a command replaces and removes the files that
the mark lists for it, and nothing else; a folder with other files and without the mark is refused. From the
check to the end the folder is locked, so that one process at a time works there.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from polhode.files.atomic import write_all, write_text
from polhode.files.output.exchange import is_regular
from polhode.files.output.locks import occupied
from polhode.files.output.place import folder_place, require_writable
from polhode.files.output.single_file import make_parent, remove_all_partials
from polhode.runtime.errors import InputError, RunFailure

MARK = ".polhode-output"
SCHEMA = "polhode-output/1"

IsName = Callable[[str], bool]
"""Whether the command writes a file of this name; all that it may ever replace or remove."""


def marked_place(path: Path, command: str, is_name: IsName, shown: Path | None = None) -> Path:
    """The folder that ``path`` names, links followed, checked before any work is done; it need not exist.

    Raises InputError: it holds files and no mark, or a file of the command's names that it did not write.
    """
    shown = shown or path
    place = folder_place(path, shown)
    _require_ours(place, command, is_name, shown)
    require_writable(place, shown)
    return place


@contextmanager
def marked_folder(path: Path, command: str, is_name: IsName, shown: Path | None = None) -> Iterator[Path]:
    """The same place, which no other process of ours writes into while the block runs.

    It is made where it is missing, and removed again if nothing is in it at the end. Raises InputError as
    ``marked_place``, and when another process is at work there.
    """
    shown = shown or path
    place = marked_place(path, command, is_name, shown)
    with occupied(place, shown):
        # another process may have ended its work there meanwhile
        _require_ours(place, command, is_name, shown)
        yield place


def _require_ours(place: Path, command: str, is_name: IsName, shown: Path) -> None:
    there = sorted(place.iterdir()) if place.is_dir() else []
    listed = read_mark(place)
    if there and listed is None:
        name = there[0].name
        raise InputError(
            f"{shown}: contains {name}, which polhode {command} did not write; choose a new or empty folder"
        )
    own = {MARK, *(listed or {}).get(command, ())}
    for each in there:
        if is_name(each.name) and not (each.name in own and is_regular(each)):
            raise InputError(
                f"{shown}: {each.name} was not written by polhode {command}, so it stays; choose another "
                "folder"
            )


def claim(place: Path, command: str, names: Sequence[str]) -> None:
    """Make the folder, clear it of what killed processes left, and list ``names`` in its mark as files of the
    command. Raises RunFailure."""
    make_parent(place / MARK, place)
    remove_all_partials(place)
    known = read_mark(place) or {}
    files = {**known, command: sorted({*known.get(command, ()), *names})}
    if files != known:
        write_mark(place, files)


@contextmanager
def withdrawn_if_refused(
    place: Path, command: str, names: Sequence[str], parts: Sequence[str] = ()
) -> Iterator[None]:
    """Take back a ``claim`` of the block when the block raises InputError before it has written anything.

    ``names``: the command's files; ``parts``: its folders. If one of the files is there, or a folder has
    something in it, or the command wrote here before, all stays.
    """
    is_new = command not in (read_mark(place) or {})
    try:
        yield
    except InputError:
        folders = [place / part for part in parts if (place / part).is_dir()]
        is_used = any((place / name).exists() for name in names) or any(
            any(each.iterdir()) for each in folders
        )
        others = read_mark(place)
        if is_new and not is_used and others is not None and others.pop(command, None) is not None:
            with suppress(OSError, RunFailure):
                for folder in folders:
                    folder.rmdir()
                write_mark(place, others) if others else (place / MARK).unlink()
        raise


def write_files(place: Path, command: str, files: Mapping[str, bytes], is_name: IsName) -> None:
    """Write the command's files, all or none, and remove those of an earlier call that are not among them.

    Raises RunFailure.
    """
    claim(place, command, list(files))
    write_all({place / name: content for name, content in files.items()})
    forget_others(place, command, files, is_name)


def forget_others(place: Path, command: str, names: Mapping[str, object], is_name: IsName) -> None:
    """Remove the command's files of earlier calls; the mark then lists ``names`` alone. Raises RunFailure."""
    known = read_mark(place) or {}
    for name in known.get(command, ()):
        old = place / name
        if name not in names and is_name(name) and old.is_file() and not old.is_symlink():
            try:
                old.unlink()
            except OSError as error:
                raise RunFailure(f"{old}: cannot be removed ({error.strerror}); remove it") from error
    write_mark(place, {**known, command: sorted(names)})


def read_mark(folder: Path) -> dict[str, list[str]] | None:
    """Files by command; None: the folder has no mark of ours."""
    mark = folder / MARK
    try:
        if not mark.is_file() or mark.stat().st_size > 2**20:
            return None
        content = json.loads(mark.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            return None
        return {str(command): list(map(str, names)) for command, names in content["files"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def write_mark(folder: Path, files: Mapping[str, Sequence[str]]) -> None:
    """Mark the folder as ours."""
    words = "polhode wrote these files, by command, and may replace them; others stay as they are"
    content = {"schema": SCHEMA, "words": words, "files": files}
    write_text(folder / MARK, json.dumps(content, indent=1) + "\n")
