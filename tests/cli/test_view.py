"""``polhode view`` and ``polhode run --view-save``: what they write, and one line for mistakes."""

import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

import polhode.pipeline.run
from polhode.cli.main import main
from polhode.pipeline.live import run_live
from polhode.runtime.errors import RunFailure
from polhode.runtime.optional_parts import part_with
from polhode.viewer.target import is_recording
from tests.cli.writing_commands import run_of_stored_files
from tests.conftest import MakeOnce
from tests.pipeline.conftest import N_FRAMES, make_example, write_example
from tests.viewer.read_recording import values_of

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def run(make_once: MakeOnce) -> Path:
    def write(folder: Path) -> None:
        folder.mkdir()
        write_example(folder, make_example())

    return make_once("run_to_view", write)


def test_a_run_and_a_sequence_are_recorded(
    run: Path, small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    for shown in (run, small_sequence):
        file = tmp_path / f"{shown.name}.rrd"
        assert main(["view", str(shown), "--save", str(file)]) == 0
        printed = capsys.readouterr()
        assert printed.out.splitlines()[-1] == f"Recording: {file}" and printed.err == ""
        assert is_recording(file)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["nowhere"], "nowhere: neither a run (summary.json) nor a sequence (mav0/)"),
        (["SEQ", "--data", "SEQ"], "--data goes with a run: a sequence has its images"),
        (["SEQ", "--save", "s.txt"], "s.txt: give a name that ends in .rrd"),
        (["SEQ"], "no display for Rerun's window (DISPLAY is not set): --save FILE"),
    ],
)
def test_a_mistake_is_one_line(
    words: list[str], line: str, small_sequence: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert main(["view", *(word.replace("SEQ", str(small_sequence)) for word in words)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"polhode: error: {line}") and error.count("\n") == 1


@pytest.mark.parametrize("words", [["view", "SEQ"], ["run", "--data", "SEQ", "-o", "R", "--view"]])
def test_without_rerun_the_line_has_the_command_that_installs_it(
    words: list[str], small_sequence: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.chdir(small_sequence)
    assert main([word.replace("SEQ", ".") for word in words]) == 2
    error = capsys.readouterr().err
    assert f"Rerun is not installed ({part_with('rerun').how_to_install})" in error
    assert error.count("\n") == 1
    assert not (small_sequence / "R").exists()


def test_a_finished_run_is_recorded_and_is_complete_though_it_cannot_be_shown(
    run: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(polhode.pipeline.run, "run", partial(run_of_stored_files, run))
    none = SimpleNamespace(has_ranges=False)
    for name in ("unseen", "seen"):
        if name == "seen":
            monkeypatch.setattr("polhode.viewer.show_run.open_sequence", lambda folder: none)
            monkeypatch.setattr("polhode.viewer.show_run.pictures_of", lambda *_: lambda k: None)
        folder, file = tmp_path / name, tmp_path / f"{name}.rrd"
        words = ["run", "--data", str(tmp_path), "-o", str(folder), "--view-save", str(file)]
        assert main(words) == 0
        printed = capsys.readouterr()
        assert printed.out.splitlines()[-1].endswith(str(folder / "report.html")) and printed.err == ""
        not_shown = "the run is complete, but it could not be shown: " in printed.out
        assert not_shown == (name == "unseen")
    assert len(values_of(file, "/N/target", "Transform3D:translation")) == N_FRAMES


def test_a_stream_is_recorded_even_if_no_motion_is_found(
    small_sequence: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*words: object) -> None:
        raise RunFailure("no consistent motion")

    monkeypatch.setattr(run_live, "fill_run_folder", fails)
    monkeypatch.setattr(run_live, "warm_up_stream", lambda *words: None)
    file = tmp_path / "live.rrd"
    words = ["--rate", "0", "-o", str(tmp_path / "R"), "--view-save", str(file), "--runtime.workers", "1"]
    assert main(["run", "--live", str(small_sequence), *words]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert len(values_of(file, "/N/camera/left", "EncodedImage:blob")) == 6
