"""The run directory as a whole: it appears complete under its name, or not at all.

Everything is written into a hidden folder beside RUN, which takes the place of RUN at the end:
- success: the new run is published (with ``overwrite``, the old one is there until now);
- failure of the run: summary.json gets the status ``failed`` and the results so far are published, beside RUN
  as RUN.failed if RUN holds a run that did not fail; nothing is published if there are no results and a run
  exists already, nor if even summary.json cannot be written: the hidden folder is then kept;
- the user's mistake (InputError): nothing is left behind, and an existing run stays;
- an interrupt: likewise, but for the results of finished stages (``stages``), which stay in the hidden folder
  for a run that resumes from them.

Replaced are a run's own files: those of ``polhode.files.output.run_files`` that its summary.json lists, if
they are what the run wrote. Files of the user that are among them stay in RUN.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from polhode.config import Runtime
from polhode.files.atomic import REFUSALS, refused
from polhode.files.output.exchange import IsOwn, entries, foreign, is_regular
from polhode.files.output.place import begins_with, folder_place, printable
from polhode.files.output.run_files import LATER, PICTURES, STAGES, SUMMARY, is_run_file, is_stage_file
from polhode.files.output.staged_folder import StagedFolder, staged_folder
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.finished_stages import KeptStages, StageStore
from polhode.run_directory.own_results import changed_results
from polhode.run_directory.summary import build_summary, read_summary, with_files, write_summary
from polhode.run_directory.summary_schema import Recording
from polhode.run_directory.verdict import lower_status
from polhode.runtime.errors import InputError, RunFailure

REPORT = "report.html"
RESULTS: tuple[str, ...] = ("measurements.npz", "trajectory.csv", "landmarks.ply", "mesh.ply")
"""A failed run is worth publishing if it contains one of these."""
NEEDED: tuple[str, ...] = ("config.yaml", "trajectory.csv", "covariance.npz")
"""A folder without them is no run; the first is in that of a failed one, too."""

_log = logging.getLogger(__name__)


@dataclass
class RunFolder:
    """The folder of a run that is being written."""

    path: Path
    """Where to write: a hidden folder"""
    published: Path
    """Where the run is to be read, after the block; None: it was not published"""
    stages: KeptStages
    """Results of finished stages, of this run and of those before it"""
    before: Recording | None = None
    """The recording of the run that is to be replaced"""
    note: str = ""
    """What the user should know about the place"""
    recording: Recording | None = None
    """What the run is made from, for the summary of a failure"""

    def open_stages(self, sequence_folder: Path, runtime: Runtime) -> StageStore:
        """The results of finished stages, of this recording. Raises InputError: they are of another."""
        assert self.recording is not None
        salt = f"{runtime.blas_threads} threads"
        return self.stages.open(self.recording, self.before, sequence_folder, runtime.stages, salt)


@contextmanager
def atomic_run_folder(
    path: Path,
    overwrite: bool = False,
    write_report: Callable[[Path], None] | None = None,
    even_if_failed: bool = False,
    resume: bool = False,
) -> Iterator[RunFolder]:
    """The folder to write into, which becomes ``path`` at the end; messages of the program go to its log.txt.

    ``even_if_failed``: a failed run, too, replaces one that did not fail. ``resume``: the run goes on from
    the stages that an earlier one has finished, and replaces that one as with ``overwrite``. ``write_report``
    makes the report of a failed run from its files. Raises InputError when ``path`` is a file, or a folder
    that is not empty, unless it is a run and ``overwrite`` is set; RunFailure, which says where the results
    are, instead of one that is raised in the block, and when the run cannot be written.
    """
    place = folder_place(path)
    overwrite = overwrite or resume
    with staged_folder(place, path, is_run_file, lambda folder: own_files(folder) is not None) as staged:
        _require_usable(place, path, overwrite)
        stages, before = KeptStages(staged.path / STAGES, place, resume), None
        if resume:
            staged.claim(is_stage_file)
            stages.take_over()
            with suppress(InputError):
                before = read_summary(place / SUMMARY).data
        else:
            staged.claim()
        was_interrupted = stages.has_results
        run = RunFolder(staged.path, path, stages, before)
        try:
            with _logging_to(staged.path / "log.txt"):
                try:
                    yield run
                    stages.finish()
                except InputError:
                    raise
                except Exception as error:
                    _log.error("the run failed: %s", error, exc_info=error)
                    raise
        except InputError:
            staged.keep = was_interrupted
            raise
        except KeyboardInterrupt as stop:
            if not stages.has_results:
                raise
            staged.keep = True
            kept = "finished stages are kept, the same command with --resume goes on from there"
            raise KeyboardInterrupt(f"interrupted; {kept}") from stop
        except Exception as error:
            stages.finish()
            where = _publish_failed(run, staged, path, error, write_report, overwrite, even_if_failed)
            if isinstance(error, RunFailure):
                raise RunFailure(f"{error}; {where}") from error
            if isinstance(error, OSError) and error.errno in REFUSALS:
                file = error.filename or staged.path
                raise RunFailure(f"{refused(Path(file), 'cannot be written', error)}; {where}") from error
            error.add_note(where)
            raise
        else:
            _publish(run, staged, path, overwrite, even_if_failed)


def require_run_folder(folder: Path) -> None:
    """Raise InputError for a file, such as one of a run, and for a folder that is missing."""
    if not folder.is_dir():
        what = "a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {what}; give the folder of a run")


def own_files(folder: Path) -> IsOwn | None:
    """What in ``folder`` belongs to its run, by name; None: it holds no whole run of ours."""
    try:
        summary = read_summary(folder / SUMMARY)
    except InputError:
        return None
    needed = NEEDED if summary.inertia is not None else NEEDED[:1]
    if not all((folder / name).is_file() and is_regular(folder / name) for name in (SUMMARY, *needed)):
        return None
    if not begins_with(folder / "config.yaml", "# Resolved configuration"):
        return None
    # Other programs use the names config.yaml and report.html, too. The results of stages are many, and not
    # listed: no other program uses their names.
    listed = None if summary.files is None else {*summary.files, *LATER}
    changed = changed_results(folder, summary.sha256)
    has_other_page = (folder / REPORT).is_file() and not begins_with(folder / REPORT, "polhode</title>")

    def is_own(name: str) -> bool:
        if not is_run_file(name) or name in changed or (name == REPORT and has_other_page):
            return False
        return listed is None or name in listed or is_stage_file(name) or "/." in f"/{name}"

    return is_own


def _require_usable(place: Path, shown: Path, overwrite: bool) -> None:
    """Raise InputError unless the place is empty, or holds a run that may be replaced."""
    if not _is_not_empty(place):
        return
    is_own, remedy = own_files(place), "choose another folder"
    if is_own is None:
        names = [name for name, is_folder in entries(place) if not is_folder] or [place.name]
        example = printable(min(names, key=lambda name: (is_run_file(name), name)))
        why = f"contains files that are not a run and are never deleted ({example})"
        raise InputError(f"{shown}: {why}; {remedy}")
    if not overwrite:
        raise InputError(f"{shown}: already contains a run; {remedy}, or replace it with --overwrite")
    try:
        others = foreign(place, is_own)
    except OSError as error:
        why = f"cannot be read ({error.strerror}), so that it could not stay in {shown}"
        raise InputError(f"{error.filename}: {why}; {remedy}") from error
    changed = changed_results(place, read_summary(place / SUMMARY).sha256)
    for name in others:
        if name in changed:
            why = "was changed since the run wrote it, so it stays"
            # without a file that is needed the folder would be no run
            remedy = remedy if name in NEEDED else f"move it, or {remedy}"
        elif (place / name).lstat().st_dev != place.stat().st_dev:
            why = "is on another file system, and could not stay there"
        elif is_run_file(name) or is_run_file(name.split("/")[0]) or name == PICTURES:
            why, remedy = "is not of the run there, but has the name of a result", f"move it, or {remedy}"
        else:
            continue
        raise InputError(f"{shown}: {printable(name)} {why}; {remedy}")


def _publish(run: RunFolder, staged: StagedFolder, path: Path, overwrite: bool, even_if_failed: bool) -> None:
    """The run takes its place, or one beside it where that is taken; ``run`` says which."""
    failed = read_summary(staged.path / SUMMARY).status == "failed"
    place, is_own = staged.place, own_files(staged.place)
    if _is_not_empty(place):
        if is_own is None or not overwrite:
            run.note = f"{path} was filled by another program in the meantime and stays as it is"
            place, is_own = _free(place, "new"), None
        elif failed and not even_if_failed and read_summary(place / SUMMARY).status != "failed":
            run.note = f"{path} still holds the run before, as this one failed"
            # RUN.failed, where an earlier failed run may be replaced; else another name.
            place = place.with_name(f"{place.name}.failed")
            is_own = own_files(place)
            is_failed_run = (
                is_own is not None
                and not place.is_symlink()
                and not any(is_run_file(name) for name in foreign(place, is_own))
                and read_summary(place / SUMMARY).status == "failed"
            )
            if not is_failed_run and (_is_not_empty(place) or (place.exists() and not place.is_dir())):
                place, is_own = _free(staged.place, "failed"), None
    try:
        stays = staged.publish(place, is_own)
    except OSError as error:
        # Where the new folder cannot take the place, it can still have a name of its own.
        staged.keep = True
        other = _free(staged.place, "new")
        try:
            staged.path.rename(other)
        except OSError:
            other = staged.path
        raise RunFailure(f"{refused(place, 'cannot be replaced', error)}; the new run is {other}") from error
    run.published = path if place == staged.place else place
    if stays:
        more = f" and {len(stays) - 1} more" if len(stays) > 1 else ""
        _log.warning("%s: %s%s: not of the run, stays there", run.published, printable(stays[0]), more)
    if place.name.startswith(f"{staged.place.name}.new"):
        _log.warning("%s; the run is %s", run.note, place)


def _publish_failed(
    run: RunFolder,
    staged: StagedFolder,
    path: Path,
    error: Exception,
    write_report: Callable[[Path], None] | None,
    overwrite: bool,
    even_if_failed: bool,
) -> str:
    """Publish what the run had found; returns where that is, in words."""
    folder = staged.path
    has_results = any((folder / name).exists() for name in RESULTS)
    if _is_not_empty(staged.place) and not has_results:
        return f"nothing was found; {path} still holds the run before"
    try:
        record_failure(folder, " ".join(str(error).split()) or type(error).__name__, run.recording)
    except Exception as second:  # noqa: BLE001  whatever prevents it: the files are kept as they are
        _log.debug("no summary", exc_info=second)
        staged.keep = True
        kept = f"; {path} is as it was" if _is_not_empty(staged.place) else ""
        return f"what was found, without a summary: {folder}, which the next run there removes{kept}"
    if write_report is not None:
        try:
            write_report(folder)
        except Exception as second:  # noqa: BLE001  the cause of the failure may break the report, too
            _log.debug("no report", exc_info=second)
    _publish(run, staged, path, overwrite, even_if_failed)
    report = run.published / REPORT
    where = f"what was found: {report if report.is_file() else run.published}"
    return f"{where}; {run.note}" if run.note else where


def _free(place: Path, ending: str) -> Path:
    """A name beside the place that nothing has yet."""
    numbers = ("", *(f"-{number}" for number in range(2, 10_000)))
    names = (place.with_name(f"{place.name}.{ending}{number}") for number in numbers)
    return next(found for found in names if not found.exists() and not found.is_symlink())


@contextmanager
def _logging_to(file: Path) -> Iterator[None]:
    handler, logger = logging.FileHandler(file, encoding="utf-8"), logging.getLogger("polhode")
    # a log that goes without a line where the disk is full: the results tell of it
    handler.handleError = lambda record: None  # type: ignore[method-assign]
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        with suppress(OSError):
            handler.close()


def record_failure(folder: Path, message: str, recording: Recording | None = None) -> None:
    """Turn the files in the folder into a failed run, whose summary.json says why."""
    if (folder / SUMMARY).exists():
        summary = lower_status(read_summary(folder / SUMMARY), "failed", message, first=True)
    else:
        tracks = read_measurements(folder) if (folder / "measurements.npz").exists() else None
        summary = build_summary(tracks, None, None, {}, failure=message)
    summary = summary.model_copy(update={"data": summary.data or recording})
    write_summary(with_files(summary, folder), folder / SUMMARY)


def _is_not_empty(path: Path) -> bool:
    return path.is_dir() and any(path.iterdir())
