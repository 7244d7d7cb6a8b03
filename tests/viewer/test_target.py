"""Where a recording goes, and the one line where it cannot."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import missing_message, require_part
from polhode.runtime.progress import Silent
from polhode.viewer.show_run import show_sequence
from polhode.viewer.target import ViewTarget, is_recording, require_target


def test_without_rerun_one_line_has_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    require_part("rerun", "--view")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=re.escape(f"--view: {missing_message('rerun')}")):
        require_part("rerun", "--view")


def test_without_a_display_one_line_names_the_file_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"no display.*--save FILE writes the recording instead"):
        require_target(None, window=True)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert require_target(None, window=True) == ViewTarget(None, True)


def test_a_file_of_the_user_stays(small_sequence: Path, tmp_path: Path) -> None:
    for name in ("notes.txt", "notes.rrd"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(InputError, match=r"was not written by polhode view.*choose another --view-save"):
            require_target(tmp_path / name, False, "--view-save")
        assert (tmp_path / name).read_text() == "mine"
    with pytest.raises(InputError, match=r"new.txt: give a name that ends in .rrd"):
        require_target(tmp_path / "new.txt", False)
    own = tmp_path / "own.rrd"
    show_sequence(small_sequence, require_target(own, window=False), Silent())
    assert is_recording(own)
    assert require_target(own, window=False).file == own
    # a recording of another program, of the same format
    (tmp_path / "other.rrd").write_bytes(own.read_bytes().replace(b"polhode", b"another"))
    with pytest.raises(InputError, match=r"was not written by polhode view"):
        require_target(tmp_path / "other.rrd", window=False)


def test_the_window_is_of_this_machine_alone_and_sends_no_statistics(
    small_sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, real = list[Any](), subprocess.Popen

    def fail(command: list[str], **options: Any) -> Any:
        started.append((command, options))
        failing = [
            sys.executable,
            "-c",
            "print('a first line', flush=True); raise SystemExit('no graphics card')",
        ]
        return real(failing, **options)

    monkeypatch.setattr(subprocess, "Popen", fail)
    before = dict(os.environ)
    with pytest.raises(InputError, match=r"window did not open \(no graphics card\): --save FILE"):
        show_sequence(small_sequence, ViewTarget(None, window=True), Silent())
    ((command, options),) = started
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    # Rerun's own switch for it: where CI is set, nothing is sent and no setting is written
    assert options["env"]["CI"] == "true"
    assert dict(os.environ) == before


def test_nothing_is_written_if_what_is_shown_ends_by_an_error(
    small_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = iter(range(3))

    def broken(self: object, frame: object) -> None:
        if next(calls) == 2:
            raise InputError("changed while in use")

    monkeypatch.setattr("polhode.viewer.recorder.Recorder.log_frame", broken)
    file = tmp_path / "s.rrd"
    with pytest.raises(InputError, match="changed while in use"):
        show_sequence(small_sequence, ViewTarget(file, window=False), Silent())
    assert [each.name for each in tmp_path.iterdir()] == ["sequence"]
