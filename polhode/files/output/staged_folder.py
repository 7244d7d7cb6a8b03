"""A folder that is written under a hidden name beside its place, and takes it when it is complete.

The hidden folder ``.NAME.partial`` is locked while its process lives. One that is not locked was left by a
process that was killed: it is named and cleared, or resumed by who can. Nothing in it is removed that is not
ours by name.
"""

import logging
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from polhode.files.atomic import sync
from polhode.files.output import exchange as exchanging
from polhode.files.output.exchange import IsOwn, aside_of, empty, foreign, is_same, move, sync_all
from polhode.files.output.locks import lock, occupied, opened
from polhode.files.output.place import LEFT_BEHIND, require_not_current, require_writable
from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)


@dataclass
class StagedFolder:
    """A folder on its way to its place."""

    path: Path
    """The hidden folder that is written into"""
    place: Path
    is_own: IsOwn
    """By name: what may be removed from hidden folders, and of a folder that is replaced"""
    is_claimed: bool = False
    """What is in the hidden folder is of this process, or is resumed by it"""
    keep: bool = False
    """Leave the hidden folder there at the end, for another command to resume"""

    def claim(self, kept: IsOwn | None = None) -> None:
        """Take the hidden folder, without what a process that ended left in it, except for ``kept`` files.

        Raises InputError when not all of that is ours.
        """
        stays = kept or (lambda name: False)
        if any(self.path.iterdir()):
            left = empty(self.path, lambda name: self.is_own(name) and not stays(name), self.place)
            if others := [name for name in left if not stays(name)]:
                raise InputError(
                    f"{self.path}: contains {others[0]}, which polhode did not write there; move it, or "
                    "choose another -o"
                )
            if kept is None:
                _log.warning(LEFT_BEHIND, self.path)
        self.is_claimed = True
        require_writable(self.path, self.place)

    def resume(self) -> None:
        """Take the hidden folder with what is in it. Raises InputError: it cannot be written."""
        self.is_claimed = self.keep = True
        require_writable(self.path, self.place)
        self.keep = False

    def publish(self, place: Path | None = None, is_own: IsOwn | None = None) -> list[str]:
        """Let the folder take its place (or another one), and return the names of what stays there.

        What is there already is replaced where it is ours, by ``is_own`` if given; anything else goes along
        into the new folder. Raises OSError; the old folder is then as it was.
        """
        place, is_own = place or self.place, is_own or self.is_own
        sync_all(self.path)
        stays: list[str] = []
        if place.is_dir() and any(place.iterdir()):
            with opened(place) as old:
                # whoever writes into the old folder, such as an evaluation, ends first
                lock(old, wait=True)
                stays = foreign(place, is_own)
                exchanging.carry(stays, place, self.path)
                aside = exchanging.exchange(self.path, place)
                self.is_claimed = False
                try:
                    # what came since then is in the old folder alone
                    move(exchanging.remove(aside, is_own, place), aside, place)
                except OSError as error:
                    _log.warning("%s: the old folder, which cannot be removed (%s)", aside, error.strerror)
        else:
            self.path.rename(place)
        self.is_claimed = False
        sync(place.parent)
        return stays


@contextmanager
def staged_folder(
    place: Path, shown: Path, is_own: IsOwn, is_whole: Callable[[Path], bool]
) -> Iterator[StagedFolder]:
    """Make and lock the hidden folder of ``place``; whoever uses it claims it. At the end it is removed,
    unless it was published, is kept, or was never claimed.

    What an earlier command left on its way to the same place is mended first; ``is_whole`` tells a complete
    folder of ours. Raises InputError: another process is writing there, or nothing can be written there.
    """
    if os.path.ismount(place):
        raise InputError(f"{shown}: the root of a file system cannot be replaced; give a folder inside it")
    require_not_current(place, shown)
    staged = StagedFolder(place.with_name(f".{place.name}.partial"), place, is_own)
    with occupied(staged.path, shown):
        try:
            _mend(place, is_own, is_whole)
            yield staged
        finally:
            if staged.is_claimed and not staged.keep:
                shutil.rmtree(staged.path, ignore_errors=True)
            elif not staged.is_claimed:
                with suppress(OSError):
                    staged.path.rmdir()


def _mend(place: Path, is_own: IsOwn, is_whole: Callable[[Path], bool]) -> None:
    """Finish what a killed process left beside the place: an old folder that stepped aside."""
    aside = aside_of(place)
    if aside.is_dir() and not place.exists() and is_whole(aside):
        aside.rename(place)
        _log.warning("%s: its replacement was interrupted; the old one is back", place)
    if aside.is_dir() and not aside.is_symlink():
        with opened(aside) as handle:
            others = [name for name in foreign(aside, is_own) if not is_same(aside / name, place / name)]
            if lock(handle) and not others:
                exchanging.remove(aside, is_own, place)
                _log.warning(LEFT_BEHIND, aside)
