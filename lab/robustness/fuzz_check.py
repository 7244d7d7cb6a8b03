"""What an input may do to a reader: end in success or in one line of InputError, soon, and in little memory.

A reader prints nothing and touches no file but those it reads.
"""

import contextlib
import io
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from lab.command import ROOT
from lab.robustness.fuzz_targets import Target
from polhode.runtime.errors import InputError, one_line

LIMIT_S = 5.0
"""Of processor time, so that a busy machine is not taken for a slow reader."""
LIMIT_BYTES = 2**30
MAX_MESSAGE = 2_000


@dataclass(frozen=True)
class Finding:
    """An input that did something else."""

    place: str
    """Kind of the fault and where it happened: findings of one place are one finding"""
    details: str


class _TooSlow(BaseException):
    pass


class Checker:
    """Feeds inputs to one reader; ``folder`` is empty at first and belongs to the checker."""

    def __init__(self, target: Target, folder: Path) -> None:
        self.target, self.folder = target, folder
        target.lay_out(folder)
        self.file = folder / target.file
        self.file.parent.mkdir(parents=True, exist_ok=True)
        self.file.touch()
        self._files = set(self._names())
        self._slow = ""
        self.touched: list[str] = []
        signal.signal(signal.SIGPROF, self._alarm)
        if not _hooked:
            sys.addaudithook(_audit)
            _hooked.append(True)

    def warm_up(self, seeds: list[bytes]) -> list[Finding]:
        """Read the corpus, first unwatched: imports and compiled code belong to any running program."""
        for seed in seeds:
            self.file.write_bytes(seed)
            with contextlib.suppress(InputError), contextlib.redirect_stderr(io.StringIO()):
                self.target.read(self.file)
        return [found for seed in seeds if (found := self(seed, memory=False)) is not None]

    def __call__(self, content: bytes, memory: bool = True) -> Finding | None:
        """Write the input, read it, and judge."""
        self.file.write_bytes(content)
        size_of_stderr = _stderr_bytes()
        start_bytes = _peak_bytes(reset=True) if memory else 0
        said, self._slow, self.touched = io.StringIO(), "", []
        found: Finding | None = None
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S, 0.5)
            _watching.append(self)
            try:
                self.target.read(self.file)
            except InputError as error:
                found = _judged(error)
            except _TooSlow:
                pass
            except BaseException as error:  # noqa: BLE001  whatever the reader did
                found = _of_error(type(error).__name__, error)
            finally:
                _watching.clear()
                signal.setitimer(signal.ITIMER_PROF, 0.0)
        if self._slow:
            return Finding(f"slow {_place_in(self._slow)}", self._slow)
        if found is None and memory:
            grown = _peak_bytes() - start_bytes
            if grown > LIMIT_BYTES:
                found = Finding("memory", f"grew by {grown / 2**20:.0f} MiB")
        if found is None and self.touched:
            found = Finding(f"touched {self.touched[0].split()[0]}", "\n".join(self.touched))
        if found is None and (said.getvalue().strip() or _stderr_bytes() != size_of_stderr):
            words = said.getvalue() or "written by a library in C"
            found = Finding(f"printed {words.strip().rpartition('/')[2][:60]}", words)
        return found

    def changed_folder(self) -> Finding | None:
        """Whether there are other files than those that were laid out."""
        changed = set(self._names()) ^ self._files
        return Finding("changed the folder", f"{sorted(changed)}") if changed else None

    def _names(self) -> Iterator[str]:
        return (str(path) for path in self.folder.rglob("*"))

    def _alarm(self, number: int, frame: FrameType | None) -> None:
        self._slow = self._slow or "".join(traceback.format_stack(frame))
        raise _TooSlow


_hooked: list[bool] = []
"""Audit hooks cannot be removed: there is one, for all checkers."""
_watching: list[Checker] = []
"""The checker whose reader is at work."""


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    """Note what a reader must not do: write, remove, start programs, connect."""
    if not _watching:
        return
    touched = _watching[0].touched
    if event == "open":
        path, mode, flags = arguments
        flags = flags if isinstance(flags, int) else 0
        writes = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC)) or "w" in str(mode)
        if writes and isinstance(path, str | bytes | os.PathLike) and os.fsdecode(path) != os.devnull:
            touched.append(f"open {os.fsdecode(path)} for writing")
    elif event in _FORBIDDEN:
        touched.append(f"{event} {str(arguments)[:200]}")


_FORBIDDEN = (
    *("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "os.chmod"),
    *(
        "os.system",
        "os.exec",
        "os.posix_spawn",
        "os.fork",
        "subprocess.Popen",
        "shutil.rmtree",
        "pickle.find_class",
    ),
    *("socket.connect", "socket.getaddrinfo", "urllib.Request", "ctypes.dlopen"),
)


def _judged(error: InputError) -> Finding | None:
    """An InputError must be short, as one line, and hide no lack of memory."""
    message = one_line(str(error))
    if len(message) > MAX_MESSAGE:
        return _of_error(f"message of more than {MAX_MESSAGE} characters", error)
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return _of_error("MemoryError within InputError", cause)
        cause = cause.__cause__ or cause.__context__
    return None


def _of_error(kind: str, error: BaseException) -> Finding:
    text = "".join(traceback.format_exception(error))
    return Finding(f"{kind} {_place_in(''.join(traceback.format_tb(error.__traceback__)))}", text[-6000:])


def _place_in(trace: str) -> str:
    """The last line of our own code in a printed traceback."""
    own = [line for line in trace.splitlines() if 'File "' in line and str(ROOT) in line]
    own = [line for line in own if "site-packages" not in line and "lab/" not in line]
    if not own:
        return "elsewhere"
    file, line, *_ = own[-1].strip().removeprefix('File "').split('", line ')
    path = Path(file)
    return f"{path.relative_to(ROOT) if path.is_relative_to(ROOT) else path.name}:{line.split(',')[0]}"


def _stderr_bytes() -> int:
    return os.fstat(2).st_size


def _peak_bytes(reset: bool = False) -> int:
    """Largest resident memory so far, of Linux; 0 elsewhere."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return 0
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    for line in status.read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0
