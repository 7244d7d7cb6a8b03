"""The run directory appears complete or not at all, and what stood there is never half-overwritten."""

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from polhode.config import Config
from polhode.report import finish_run, write_report
from polhode.run_directory.archives import write_measurements
from polhode.run_directory.outputs import write_config, write_estimate, write_surface
from polhode.run_directory.run_folder import atomic_run_folder
from polhode.run_directory.summary import build_summary, read_summary, write_summary
from polhode.runtime.errors import InputError, RunFailure


@contextmanager
def _writing(target: Path, *arguments: Any, **more: Any) -> Iterator[Path]:
    with atomic_run_folder(target, *arguments, **more) as run:
        yield run.path


def _finish(folder: Path, run: Any, warning: str = "") -> None:
    write_config(folder, Config())
    write_estimate(folder, run.tracks, run.estimate)
    finish_run(folder, build_summary(run.tracks, run.estimate, run.surface, {}, [warning] if warning else []))


def _measure(folder: Path, example: Any) -> None:
    write_config(folder, Config())
    write_measurements(example.tracks, folder / "measurements.npz")


def _good(target: Path, example: Any, warning: str = "") -> None:
    with _writing(target, overwrite=True) as folder:
        _finish(folder, example, warning)


def _run(
    target: Path, work: Callable[[Path], None], error: BaseException, overwrite: bool = False, **more: Any
) -> None:
    with _writing(target, overwrite, more.pop("write_report", write_report), **more) as folder:
        work(folder)
        raise error


def _failing(target: Path, example: Any, **more: Any) -> str:
    """A run that fails after the measurements; returns its line."""
    with pytest.raises(RunFailure) as caught:
        _run(target, lambda folder: _measure(folder, example), RunFailure("broken chain"), True, **more)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def _refused(target: Path, example: Any, words: str) -> None:
    """A run is not replaced, in one line, and nothing in it changes."""
    before = {path: path.read_bytes() for path in target.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=words) as caught:
        _good(target, example)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in target.rglob("*") if path.is_file()} == before


def _warnings(run: Path) -> list[str]:
    return read_summary(run).warnings


def _leftovers(parent: Path) -> list[str]:
    return [entry.name for entry in parent.iterdir() if entry.name.startswith(".")]


@pytest.mark.parametrize("empty", [False, True])
def test_the_folder_appears_only_when_it_is_complete(empty: bool, example: Any, tmp_path: Path) -> None:
    target, logger = tmp_path / "deep" / "run", logging.getLogger("frontend")
    if empty:
        target.mkdir(parents=True)
    before = (logger.level, list(logger.handlers))
    with _writing(target) as folder:
        assert folder.parent == target.parent and target.exists() == empty
        logging.getLogger("polhode.frontend.stereo").info("562 matches")
        logging.getLogger("some.library").warning("not ours")
        _finish(folder, example)
        assert not (target / "summary.json").exists()
    assert read_summary(target).status == "ok" and (target / "report.html").is_file()
    assert _leftovers(target.parent) == []
    # as readable as any folder of the user
    (tmp_path / "plain").mkdir()
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode
    text = (target / "log.txt").read_text()
    assert "562 matches" in text and "not ours" not in text
    assert (logger.level, list(logger.handlers)) == before


def test_overwriting_replaces_the_whole_run_and_only_at_the_end(example: Any, tmp_path: Path) -> None:
    target = tmp_path / "run"
    _good(target, example, "the first")
    (target / "metrics.json").write_text("{}")
    with _writing(target, overwrite=True) as folder:
        with pytest.raises(InputError, match="another polhode is at work"):
            _good(target, example)
        _finish(folder, example, "the second")
        assert _warnings(target) == ["the first"]
    assert _warnings(target) == ["the second"] and not (target / "metrics.json").exists()
    assert _leftovers(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("mesh.ply", "; move it, or choose another folder"),
        ("config.yaml", "so it stays; choose another folder"),
    ],
)
def test_results_that_the_user_edited_are_not_replaced(
    name: str, remedy: str, example: Any, tmp_path: Path
) -> None:
    target = tmp_path / "run"
    with _writing(target) as folder:
        write_surface(folder, example.surface)
        _finish(folder, example)
    # these are written again by other commands
    (target / "metrics.json").write_text("{ }")
    write_report(target)
    written = (target / name).read_bytes()
    (target / name).write_bytes(written + b"# edited")
    _refused(target, example, f"{name} was changed since the run wrote it, .*{remedy}")
    (target / name).write_bytes(written)

    def edited_meanwhile() -> None:
        with _writing(target, overwrite=True) as folder:
            write_surface(folder, example.surface)
            _finish(folder, example)
            (target / name).write_bytes(written + b"# edited")

    with pytest.raises(RunFailure, match=r"the new run is .*run\.new"):
        edited_meanwhile()
    assert (target / name).read_bytes() == written + b"# edited"
    (target / name).write_bytes(written)
    _good(target, example, "the third")
    assert _warnings(target) == ["the third"]


def test_a_failed_run_leaves_what_it_found_and_says_why(example: Any, tmp_path: Path) -> None:
    run, failure = tmp_path / "run", RunFailure("the frames fall into two pieces;\n give masks")
    with pytest.raises(RunFailure):
        _run(run, lambda folder: _measure(folder, example), failure)
    summary = read_summary(run)
    assert summary.status == "failed" and summary.inertia is None and summary.frames == 24
    assert summary.warnings == ["the frames fall into two pieces; give masks"]
    for name in ("report.html", "log.txt"):
        assert "two pieces" in (run / name).read_text()
    assert _leftovers(tmp_path) == []

    def solve(folder: Path) -> None:
        write_config(folder, Config())
        write_estimate(folder, example.tracks, example.estimate)

    # after the estimate it keeps its numbers
    with pytest.raises(MemoryError):
        _run(tmp_path / "late", solve, MemoryError("the grid is too large"))
    summary = read_summary(tmp_path / "late")
    assert summary.status == "failed" and summary.warnings[0] == "the grid is too large"
    assert summary.inertia is not None and summary.inertia.k1 == example.estimate.mass.k1
    assert "Polhode" in (tmp_path / "late" / "report.html").read_text()

    def broken(folder: Path) -> None:
        raise KeyError(folder.name)

    # a report that breaks does not cost what was found
    with pytest.raises(RunFailure, match=r"no surface; what was found: .*/bare$"):
        _run(tmp_path / "bare", solve, RunFailure("no surface"), write_report=broken)
    assert (tmp_path / "bare" / "trajectory.csv").is_file()
    assert read_summary(tmp_path / "bare").status == "failed"
    # one with nothing found does not cost the old one
    with pytest.raises(RunFailure, match=r"nothing was found; .*late still holds the run before"):
        _run(tmp_path / "late", lambda folder: write_config(folder, Config()), RunFailure("black"), True)
    assert _warnings(tmp_path / "late")[0] == "the grid is too large"


@pytest.mark.parametrize("error", [InputError("no images"), KeyboardInterrupt()])
def test_bad_input_and_an_interrupt_leave_nothing(error: BaseException, example: Any, tmp_path: Path) -> None:
    with pytest.raises(type(error)):
        _run(tmp_path / "run", lambda folder: _measure(folder, example), error)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_came_meanwhile_is_not_touched(example: Any, tmp_path: Path) -> None:
    target = tmp_path / "run"
    with _writing(target) as folder:
        _finish(folder, example, "mine")
        target.mkdir()
        _finish(target, example, "theirs")
    assert _warnings(target) == ["theirs"] and _warnings(tmp_path / "run.new") == ["mine"]
    assert _leftovers(tmp_path) == []


def test_a_failed_run_replaces_a_failed_one_and_a_good_one_only_when_told_to(
    example: Any, tmp_path: Path
) -> None:
    run, failed = tmp_path / "run", tmp_path / "run.failed"
    line = _failing(run, example)
    assert line.endswith(f"what was found: {run / 'report.html'}")
    assert _failing(run, example) == line
    _good(run, example, "good")
    for _ in range(2):
        line = _failing(run, example)
        assert str(failed / "report.html") in line and f"{run} still holds the run before" in line
        assert read_summary(run).status == "ok" and read_summary(failed).status == "failed"
        (failed / "notes.txt").write_text("mine")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run.failed"]
    assert (failed / "notes.txt").read_text() == "mine"
    # so does one that did not converge
    with atomic_run_folder(run, overwrite=True) as new:
        _finish(new.path, example)
        summary = read_summary(new.path).model_copy(update={"status": "failed"})
        write_summary(summary, new.path / "summary.json")
    assert new.published == failed and "still holds" in new.note and _warnings(run) == ["good"]
    line = _failing(run, example, even_if_failed=True)
    assert read_summary(run).status == "failed" and line.endswith(str(run / "report.html"))
    # a folder that happens to have the name of a failed run is left alone
    _good(tmp_path / "other", example)
    (tmp_path / "other.failed").mkdir()
    (tmp_path / "other.failed" / "thesis.txt").write_text("mine")
    assert str(tmp_path / "other.failed-2") in _failing(tmp_path / "other", example)
    assert [path.name for path in (tmp_path / "other.failed").iterdir()] == ["thesis.txt"]


def test_a_full_disk_leaves_the_old_run_and_names_what_was_found(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _good(tmp_path / "run", example, "good")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(tmp_path / "there"))

    def measure(folder: Path) -> None:
        _measure(folder, example)
        monkeypatch.setattr(Path, "write_bytes", full)
        write_config(folder, Config())

    with pytest.raises(RunFailure) as caught:
        _run(tmp_path / "run", measure, RunFailure("not reached"), overwrite=True)
    monkeypatch.undo()
    line = str(caught.value)
    assert "config.yaml: cannot be written (No space left on device); free some space there" in line
    assert str(tmp_path / ".run.partial") in line and f"{tmp_path / 'run'} is as it was" in line
    assert (tmp_path / ".run.partial" / "measurements.npz").is_file()
    assert _warnings(tmp_path / "run") == ["good"]
    _good(tmp_path / "run", example, "better")
    assert _warnings(tmp_path / "run") == ["better"] and _leftovers(tmp_path) == []


def test_a_summary_that_lies_removes_nothing_but_files_of_a_run(example: Any, tmp_path: Path) -> None:
    run, outside = tmp_path / "run", tmp_path / "outside.txt"
    _good(run, example, "old")
    outside.write_text("mine")
    (run / "notes.txt").write_text("mine")
    (run / "mine").mkdir()
    (run / "mine" / "mesh.ply").write_text("mine")
    own = read_summary(run).files or ()
    listed = (
        "notes.txt",
        "../outside.txt",
        str(outside),
        "mine/mesh.ply",
        "mine",
        "..",
        "",
        "trajectory.csv",
    )

    def list_files(files: tuple[str, ...] | None) -> None:
        write_summary(read_summary(run).model_copy(update={"files": files}), run / "summary.json")

    list_files(listed)
    # what the list lacks is taken for the user's: with the name of a result it must be moved
    _refused(run, example, r"covariance.npz is not of the run there")
    list_files((*listed, *own))
    _good(run, example, "new")
    assert _warnings(run) == ["new"]
    # a run of an earlier version has no list
    list_files(None)
    _good(run, example, "newer")
    assert _warnings(run) == ["newer"] and outside.read_text() == "mine"
    assert (run / "notes.txt").read_text() == (run / "mine" / "mesh.ply").read_text() == "mine"


def test_what_only_looks_like_a_run_or_its_results_is_refused_and_the_rest_stays(
    example: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run, other = tmp_path / "run", r"is not of the run there"
    _good(run, example)
    # a summary alone makes no run; names that other programs use are ours by their content
    for name, words in (
        ("config.yaml", "not a run"), ("trajectory.csv", "not a run"), ("covariance.npz", "not a run"),
        ("report.html", f"report.html {other}"),
    ):  # fmt: skip
        content = (run / name).read_bytes()
        (run / name).unlink() if name != "report.html" else (run / name).write_text("mine: 1")
        _refused(run, example, words)
        (run / name).write_bytes(content)
    (run / "config.yaml").write_text("mine: 1")
    (run / "thesis.tex").write_text("mine")
    _refused(run, example, r"not a run.*never deleted \(thesis.tex\)")
    (run / "config.yaml").unlink()
    (run / "thesis.tex").unlink()
    write_config(run, Config())
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "captions.json").write_text("mine")
    (run / "pictures").symlink_to(tmp_path / "elsewhere")
    _refused(run, example, f"pictures {other}")
    (run / "pictures").unlink()
    (run / "mesh.ply").mkdir()
    _refused(run, example, f"mesh.ply {other}")
    assert (tmp_path / "elsewhere" / "captions.json").read_text() == "mine"
    (run / "mesh.ply").rmdir()
    for name in ("notes.txt", "other.txt", os.fsdecode(b"\xff.txt")):
        (run / name).write_text("mine")
    _good(run, example)
    (line,) = [each.getMessage() for each in caplog.records if "stays" in each.getMessage()]
    assert line == f"{run}: notes.txt and 2 more: not of the run, stays there"
