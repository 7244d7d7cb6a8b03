"""The run directory as a whole: it appears complete under its name, or not at all.

Everything is written into a hidden folder beside RUN, which is renamed to RUN at the end:
- success: the new run is published (with ``overwrite``, the old one is removed only now);
- failure of the run: summary.json gets the status ``failed`` and the results so far are published, unless
  there are none and a run exists already, which is then kept;
- the user's mistake (InputError) or an interrupt: nothing is left behind, and an existing run stays.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from polhode.errors import InputError
from polhode.pipeline.run_directory.archives import read_measurements
from polhode.pipeline.run_directory.summary import build_summary, read_summary, write_summary

RESULTS: tuple[str, ...] = ("measurements.npz", "trajectory.csv", "landmarks.ply", "mesh.ply")
"""A failed run is worth publishing if it contains one of these."""
PACKAGES: tuple[str, ...] = ("polhode",)
"""Loggers whose messages go to log.txt."""

_log = logging.getLogger(__name__)


class RunFolder:
    """``with RunFolder(path, ...) as folder:`` write into ``folder``; it becomes ``path`` at the end.

    The constructor raises InputError at once when ``path`` is a file, or a folder that is not empty, unless
    it is a run and ``overwrite`` is set. ``write_report`` makes the report of a failed run from its files.
    Log messages of the program go to ``folder/log.txt``.
    """

    def __init__(
        self, path: Path, overwrite: bool = False, write_report: Callable[[Path], None] | None = None
    ) -> None:
        self.path = path.absolute()
        self.overwrite = overwrite
        self.write_report = write_report
        _require_usable(self.path, path, overwrite)
        self.folder: Path | None = None
        self._handler: logging.Handler | None = None
        self._levels: dict[str, int] = {}

    def __enter__(self) -> Path:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            name = tempfile.mkdtemp(prefix=f".{self.path.name}.partial-", dir=self.path.parent)
        except OSError as error:
            raise InputError(
                f"{self.path.parent}: cannot write here ({error.strerror}); choose another -o"
            ) from error
        self.folder = Path(name)
        # mkdtemp makes the folder private; a run is readable like any other folder of the user.
        self.folder.chmod(0o777 & ~_umask())
        self._open_log(self.folder / "log.txt")
        return self.folder

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        folder = self.folder
        assert folder is not None
        failed = isinstance(error, Exception) and not isinstance(error, InputError)
        if error is not None and not (failed and self._worth_publishing(folder)):
            self._close_log()
            shutil.rmtree(folder, ignore_errors=True)
            return
        try:
            if error is not None:
                _log.error("the run failed: %s", error, exc_info=error)
                record_failure(folder, _one_line(error))
                if self.write_report is not None:
                    self.write_report(folder)
        finally:
            # The cause of the failure may break the report too: the files are published even then.
            self._close_log()
            self._publish(folder)

    def _worth_publishing(self, folder: Path) -> bool:
        return any((folder / name).exists() for name in RESULTS) or not _is_not_empty(self.path)

    def _publish(self, folder: Path) -> None:
        if not _is_not_empty(self.path):
            folder.rename(self.path)
            return
        if not self.overwrite:
            raise InputError(
                f"{self.path}: another run was written here in the meantime; this one is kept in {folder}"
            )
        old = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.old-", dir=self.path.parent))
        self.path.rename(old)
        try:
            folder.rename(self.path)
        except OSError:
            old.rename(self.path)
            raise
        shutil.rmtree(old, ignore_errors=True)

    def _open_log(self, file: Path) -> None:
        self._handler = logging.FileHandler(file, encoding="utf-8")
        self._handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        for name in PACKAGES:
            logger = logging.getLogger(name)
            self._levels[name] = logger.level
            logger.setLevel(logging.INFO)
            logger.addHandler(self._handler)

    def _close_log(self) -> None:
        if self._handler is None:
            return
        for name in PACKAGES:
            logging.getLogger(name).removeHandler(self._handler)
            logging.getLogger(name).setLevel(self._levels[name])
        self._handler.close()
        self._handler = None


def record_failure(folder: Path, message: str) -> None:
    """Turn the files in the folder into a failed run, whose summary.json says why."""
    if (folder / "summary.json").exists():
        summary = read_summary(folder)
        warnings = list(dict.fromkeys([message, *summary.warnings]))
        summary = summary.model_copy(update={"status": "failed", "warnings": warnings})
    else:
        tracks = read_measurements(folder) if (folder / "measurements.npz").exists() else None
        summary = build_summary(tracks, None, None, {}, failure=message)
    write_summary(summary, folder / "summary.json")


def _require_usable(path: Path, shown: Path, overwrite: bool) -> None:
    if path.exists() and not path.is_dir():
        raise InputError(f"{shown}: this is a file; choose another folder for -o")
    if not _is_not_empty(path):
        return
    is_run = (path / "summary.json").is_file()
    if is_run and not overwrite:
        raise InputError(
            f"{shown}: already contains a run; choose another folder, or replace it with --overwrite"
        )
    if not is_run:
        raise InputError(
            f"{shown}: contains files that are not a run and are never deleted; choose another folder"
        )


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _is_not_empty(path: Path) -> bool:
    return path.is_dir() and any(path.iterdir())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
