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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from polhode.errors import InputError
from polhode.pipeline.run_directory.archives import read_measurements
from polhode.pipeline.run_directory.summary import build_summary, read_summary, write_summary

RESULTS: tuple[str, ...] = ("measurements.npz", "trajectory.csv", "landmarks.ply", "mesh.ply")
"""A failed run is worth publishing if it contains one of these."""

_log = logging.getLogger(__name__)


@contextmanager
def atomic_run_folder(
    path: Path, overwrite: bool = False, write_report: Callable[[Path], None] | None = None
) -> Iterator[Path]:
    """The folder to write into, which becomes ``path`` at the end; messages of the program go to its log.txt.

    Raises InputError when ``path`` is a file, or a folder that is not empty, unless it is a run and
    ``overwrite`` is set. ``write_report`` makes the report of a failed run from its files.
    """
    target = path.absolute()
    _require_usable(target, path, overwrite)
    folder, publish = _hidden_folder(target), False
    try:
        with _logging_to(folder / "log.txt"):
            try:
                yield folder
                publish = True
            except Exception as error:
                failed = not isinstance(error, InputError)
                has_results = any((folder / name).exists() for name in RESULTS)
                publish = failed and (has_results or not _is_not_empty(target))
                if publish:
                    _log.error("the run failed: %s", error, exc_info=error)
                    record_failure(folder, _one_line(error))
                    if write_report is not None:
                        write_report(folder)
                raise
    finally:
        # The cause of the failure may break the report too: the files are published even then.
        if publish:
            _publish(folder, target, overwrite)
        else:
            shutil.rmtree(folder, ignore_errors=True)


def _hidden_folder(target: Path) -> Path:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    except OSError as error:
        raise InputError(
            f"{target.parent}: cannot write here ({error.strerror}); choose another -o"
        ) from error
    # mkdtemp makes the folder private; a run is readable like any other folder of the user.
    folder.chmod(0o777 & ~_umask())
    return folder


@contextmanager
def _logging_to(file: Path) -> Iterator[None]:
    handler, logger = logging.FileHandler(file, encoding="utf-8"), logging.getLogger("polhode")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()


def _publish(folder: Path, target: Path, overwrite: bool) -> None:
    if not _is_not_empty(target):
        folder.rename(target)
        return
    if not overwrite:
        raise InputError(
            f"{target}: another run was written here in the meantime; this one is kept in {folder}"
        )
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old-", dir=target.parent))
    target.rename(old)
    try:
        folder.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


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
