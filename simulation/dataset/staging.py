"""A dataset in the making: rendered into a draft beside its place, which it takes when it is complete.

The draft ``.SEQ.partial`` outlives an interruption: the same command goes on with the frames that miss.
Each frame is written aside and moved in whole, so a frame is there or it is not.
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

_MAKER = ".made_by"
_FRAMES = ".frames"


@dataclass(frozen=True)
class Draft:
    """The draft's folder. It may be used from several processes, one frame in one of them."""

    path: Path

    @property
    def mav0(self) -> Path:
        """Where the dataset's files go."""
        return self.path / "mav0"

    def missing(self, frames: Iterable[int]) -> list[int]:
        """Those of the frames that are not there yet."""
        return [k for k in frames if not self._has(k)]

    @contextmanager
    def frame(self, k: int) -> Iterator[Path]:
        """A folder for frame k's files, in mav0's layout; they move into mav0 when the block ends well."""
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
        """Whether the frame's note is there, and every file that it names, of its length."""
        try:
            lines = self._note(k).read_text(encoding="utf-8").splitlines()
            sizes = (line.split(" ", 1) for line in lines)
            return all((self.mav0 / name).stat().st_size == int(size) for size, name in sizes)
        except OSError:
            return False


def require_free(folder: Path, overwrite: bool) -> None:
    """Raise InputError unless a dataset may take the place ``folder``: free, empty, or one to be replaced."""
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
def drafted(folder: Path, overwrite: bool, maker: str) -> Iterator[Draft]:
    """The draft of ``folder``, begun or taken up again, which takes its place when the block ends well.

    ``maker`` is a text that tells what makes the dataset: a draft of another one is begun anew. When the
    block fails, the draft stays if it holds a frame; after an InputError it never does.
    Raises InputError: the place is taken, cannot be written, or another process is at work on it.
    """
    require_free(folder, overwrite)
    place = folder.resolve()
    draft = Draft(place.with_name(f".{place.name}.partial"))
    try:
        with _locked(draft.path):
            _take_up(draft, maker)
            try:
                yield draft
            except BaseException as error:
                if isinstance(error, InputError) or not any((draft.path / _FRAMES).glob("*.done")):
                    shutil.rmtree(draft.path, ignore_errors=True)
                raise
            shutil.rmtree(draft.path / _FRAMES, ignore_errors=True)
            (draft.path / _MAKER).unlink()
            _exchange(draft.path, place)
    except OSError as error:
        if error.strerror is None:
            raise
        raise InputError(f"{folder} cannot be made ({error.strerror}): choose another folder") from error


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Make the folder and hold it against other processes; the lock ends with this process at the latest."""
    path.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some network file systems lock no folders: then two at once are the user's own doing.
        with contextlib.suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{path}: another simulation is at work there; wait or stop it") from None
        yield
    finally:
        os.close(handle)


def _take_up(draft: Draft, maker: str) -> None:
    """Leave a draft of the same maker as it is; empty any other."""
    note = draft.path / _MAKER
    if note.is_file() and note.read_text(encoding="utf-8") == maker:
        return
    for path in draft.path.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    note.write_text(maker, encoding="utf-8")


def _exchange(draft: Path, folder: Path) -> None:
    """Put the draft in the folder's place; what stood there is deleted last, so one of them always stands."""
    if not folder.exists():
        draft.rename(folder)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
    folder.rename(aside / folder.name)
    draft.rename(folder)
    shutil.rmtree(aside)
