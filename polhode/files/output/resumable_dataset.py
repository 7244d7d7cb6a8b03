"""A dataset is complete or absent: it is made in a hidden folder beside its place, which the same command
resumes after an interruption."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from polhode.files.atomic import REFUSALS, write_failure
from polhode.files.output.place import folder_place, require_not_current, require_writable, unwritable
from polhode.files.output.staged_folder import staged_folder
from polhode.runtime.errors import InputError, RunFailure


@dataclass(frozen=True)
class DatasetMaker:
    """A command that makes datasets, and how it knows its own."""

    command: str
    is_own: Callable[[str], bool]
    """Whether it writes a file of this name, relative to the hidden folder, with "/" """
    why_not_ours: Callable[[Path], str]
    """What speaks against a folder being a dataset of it and nothing else; empty: nothing does"""
    note: str
    """File of the hidden folder that holds the fingerprint"""

    def require_free(self, folder: Path, overwrite: bool) -> None:
        """Raise InputError unless ``folder`` can be written and is absent, empty, or a dataset of this
        command that may be overwritten."""
        place = folder_place(folder)
        require_not_current(place, folder)
        require_writable(place.parent, folder)
        if not (place.is_dir() and any(place.iterdir())):
            return
        reason = self.why_not_ours(place)
        if reason:
            raise InputError(
                f"{folder} exists and is no dataset that polhode {self.command} made ({reason}); choose "
                "another folder"
            )
        if not overwrite:
            raise InputError(f"{folder} exists: choose another folder or pass --overwrite")

    @contextmanager
    def staged(
        self, folder: Path, overwrite: bool, fingerprint: str, kept: Callable[[Path], str]
    ) -> Iterator[Path]:
        """A new or resumed hidden folder that takes the place of ``folder`` if the block succeeds.

        ``fingerprint`` identifies what makes the dataset: a hidden folder with another one is cleared. If the
        block fails, the hidden folder stays when ``kept`` tells what it holds ("3 images"; empty: nothing),
        but never after an InputError. Raises InputError: the folder exists, cannot be written, or another
        process is writing it; RunFailure: a file cannot be written; KeyboardInterrupt with a message.
        """
        place = folder_place(folder)
        with staged_folder(place, folder, self.is_own, lambda whole: not self.why_not_ours(whole)) as staged:
            self.require_free(folder, overwrite)
            note = staged.path / self.note
            if note.is_file() and note.read_text(encoding="utf-8", errors="replace") == fingerprint:
                staged.resume()
            else:
                staged.claim()
                try:
                    note.write_text(fingerprint, encoding="utf-8")
                except OSError as error:
                    raise unwritable(staged.place, error) from error
            try:
                yield staged.path
                note.unlink()
                self.require_free(folder, overwrite)
                staged.publish(is_own=self.is_own)
            except InputError:
                raise
            except BaseException as error:
                there = kept(staged.path)
                staged.keep = bool(there)
                there = there and f"; {there} are kept, the same command goes on from there"
                if isinstance(error, OSError) and error.errno in REFUSALS:
                    error = write_failure(Path(error.filename or folder), error)
                if isinstance(error, RunFailure) and there:
                    raise RunFailure(f"{error}{there}") from error
                if isinstance(error, KeyboardInterrupt):
                    raise KeyboardInterrupt(f"interrupted{there}") from None
                raise error
