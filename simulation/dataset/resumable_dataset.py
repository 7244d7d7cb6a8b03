"""Datasets are rendered into a staging folder, which replaces the destination when it is complete.

The staging folder ``.SEQ.partial`` survives an interruption; the same command renders the missing frames.
The files of a frame are written to a temporary folder and then moved: a frame is complete or absent.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from polhode.errors import InputError

_FINGERPRINT = ".made_by"
_FRAMES = ".frames"


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
        aside = self.path / _FRAMES / str(k)
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
        return self.path / _FRAMES / f"{k}.done"

    def _has(self, k: int) -> bool:
        """Whether the frame's record exists, and every file that it lists has the recorded length."""
        try:
            lines = self._note(k).read_text(encoding="utf-8").splitlines()
            sizes = (line.split(" ", 1) for line in lines)
            return all((self.mav0 / name).stat().st_size == int(size) for size, name in sizes)
        except OSError:
            return False


def require_free(folder: Path, overwrite: bool) -> None:
    """Raise InputError unless ``folder`` is absent, empty, or a dataset that may be overwritten."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise InputError(f"{folder} is a file, not a dataset: choose another folder")
    if not any(folder.iterdir()):
        return
    if not overwrite:
        raise InputError(f"{folder} exists: choose another folder or pass --overwrite")
    if not (folder / "mav0").is_dir():
        raise InputError(f"{folder} is no dataset (it holds no mav0/): --overwrite does not touch it")


@contextmanager
def staged_dataset(folder: Path, overwrite: bool, fingerprint: str) -> Iterator[StagedDataset]:
    """A new or resumed staged dataset that replaces ``folder`` if the block succeeds.

    ``fingerprint`` is a text that identifies what makes the dataset: a staging folder with another one is
    cleared. If the block fails, the staging folder is kept when it holds a frame, but never after an
    InputError. Raises InputError: the folder exists, cannot be written, or another process is writing it.
    """
    require_free(folder, overwrite)
    place = folder.resolve()
    staged = StagedDataset(place.with_name(f".{place.name}.partial"))
    try:
        with _locked(staged.path):
            _resume_or_clear(staged, fingerprint)
            try:
                yield staged
            except BaseException as error:
                if isinstance(error, InputError) or not any((staged.path / _FRAMES).glob("*.done")):
                    shutil.rmtree(staged.path, ignore_errors=True)
                raise
            shutil.rmtree(staged.path / _FRAMES, ignore_errors=True)
            (staged.path / _FINGERPRINT).unlink()
            _exchange(staged.path, place)
    except OSError as error:
        if error.strerror is None:
            raise
        raise InputError(f"{folder} cannot be made ({error.strerror}): choose another folder") from error


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Create the folder and lock it against other processes, at most until this process ends."""
    path.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some network file systems cannot lock folders; there, nothing prevents two processes at once.
        with contextlib.suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{path}: another simulation is at work there; wait or stop it") from None
        yield
    finally:
        os.close(handle)


def _resume_or_clear(staged: StagedDataset, fingerprint: str) -> None:
    """Keep a staged dataset with the same fingerprint; clear any other."""
    note = staged.path / _FINGERPRINT
    if note.is_file() and note.read_text(encoding="utf-8") == fingerprint:
        return
    for path in staged.path.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    note.write_text(fingerprint, encoding="utf-8")


def _exchange(staged: Path, folder: Path) -> None:
    """Replace the folder; the old one is deleted last, so that one of the two always exists."""
    if not folder.exists():
        staged.rename(folder)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
    folder.rename(aside / folder.name)
    staged.rename(folder)
    shutil.rmtree(aside)
