"""Datasets are rendered into a staging folder, which replaces the destination when it is complete.

The staging folder ``.SEQ.partial`` survives an interruption; the same command renders the missing frames.
The files of a frame are written to a temporary folder and then moved: a frame is complete or absent.
"""

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from polhode.files.atomic import REFUSALS, write_failure
from polhode.files.output.place import folder_place, require_not_current, require_writable, unwritable
from polhode.files.output.staged_folder import StagedFolder, staged_folder
from polhode.runtime.errors import InputError, RunFailure
from polhode.simulation.dataset.own_files import (
    FINGERPRINT,
    FRAMES,
    is_dataset_file,
    is_staged_file,
    is_whole,
    why_not_ours,
)


@dataclass(frozen=True)
class StagedDataset:
    """A dataset in its staging folder. Several processes may write to it, each frame from one of them."""

    path: Path

    @property
    def mav0(self) -> Path:
        """Folder of the dataset's files."""
        return self.path / "mav0"

    def missing(self, frames: Iterable[int]) -> list[int]:
        """The frames that are not complete yet."""
        return [k for k in frames if not self._has(k)]

    @contextmanager
    def frame(self, k: int) -> Iterator[Path]:
        """A temporary folder for frame k, laid out as mav0; its files move there if the block succeeds."""
        aside = self.path / FRAMES / str(k)
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir(parents=True)
        yield aside
        files = sorted(path.relative_to(aside) for path in aside.rglob("*") if path.is_file())
        note = "".join(f"{(aside / name).stat().st_size} {name.as_posix()}\n" for name in files)
        for name in files:
            (self.mav0 / name).parent.mkdir(parents=True, exist_ok=True)
            (aside / name).replace(self.mav0 / name)
        shutil.rmtree(aside)
        written = self._note(k).with_suffix(".partial")
        written.write_text(note, encoding="utf-8")
        written.replace(self._note(k))

    def _note(self, k: int) -> Path:
        return self.path / FRAMES / f"{k}.done"

    def _has(self, k: int) -> bool:
        """Whether the frame's record exists, and every file that it lists has the recorded length."""
        try:
            lines = self._note(k).read_text(encoding="utf-8").splitlines()
            sizes = (line.split(" ", 1) for line in lines)
            return all((self.mav0 / name).stat().st_size == int(size) for size, name in sizes)
        except OSError:
            return False


def require_free(folder: Path, overwrite: bool) -> None:
    """Raise InputError unless ``folder`` can be written and is absent, empty, or one of ``simulate`` that may
    be overwritten."""
    place = folder_place(folder)
    require_not_current(place, folder)
    require_writable(place.parent, folder)
    if not (place.is_dir() and any(place.iterdir())):
        return
    reason = why_not_ours(place)
    if reason:
        raise InputError(
            f"{folder} exists and is no dataset that polhode simulate made ({reason}); choose another folder"
        )
    if not overwrite:
        raise InputError(f"{folder} exists: choose another folder or pass --overwrite")


@contextmanager
def staged_dataset(folder: Path, overwrite: bool, fingerprint: str) -> Iterator[StagedDataset]:
    """A new or resumed staged dataset that replaces ``folder`` if the block succeeds.

    ``fingerprint`` is a text that identifies what makes the dataset: a staging folder with another one is
    cleared. If the block fails, the staging folder is kept when it holds a frame, but never after an
    InputError. Raises InputError: the folder exists, cannot be written, or another process is writing it;
    RunFailure: a file cannot be written.
    """
    place = folder_place(folder)
    with staged_folder(place, folder, is_staged_file, is_whole) as staged:
        require_free(folder, overwrite)
        _resume_or_clear(staged, fingerprint)
        dataset = StagedDataset(staged.path)
        try:
            yield dataset
            shutil.rmtree(staged.path / FRAMES, ignore_errors=True)
            (staged.path / FINGERPRINT).unlink()
            require_free(folder, overwrite)
            staged.publish(is_own=is_dataset_file)
        except InputError:
            raise
        except BaseException as error:
            done = len(list((staged.path / FRAMES).glob("*.done")))
            staged.keep = done > 0
            if isinstance(error, OSError) and error.errno in REFUSALS:
                error = write_failure(Path(error.filename or folder), error)
            if isinstance(error, RunFailure) and done:
                kept = f"{done} pairs are kept, the same command goes on from there"
                raise RunFailure(f"{error}; {kept}") from error
            raise error


def _resume_or_clear(staged: StagedFolder, fingerprint: str) -> None:
    """Keep a staged dataset with the same fingerprint; clear any other."""
    note = staged.path / FINGERPRINT
    if note.is_file() and note.read_text(encoding="utf-8") == fingerprint:
        staged.resume()
        return
    staged.claim()
    try:
        note.write_text(fingerprint, encoding="utf-8")
    except OSError as error:
        raise unwritable(staged.place, error) from error
