"""Compiled code is kept only in folders into which no other user can put any."""

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.runtime import code_cache as module
from polhode.runtime.code_cache import code_cache, is_private

FUNCTION = "from polhode.runtime.compiled import compiled\n\n\n@compiled\ndef two() -> int:\n    return 2\n"


@pytest.fixture(autouse=True)
def unprepared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """No answer of before, and a folder of caches that is the test's."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    module._folder.cache_clear()
    module._say_once.cache_clear()
    yield
    module._folder.cache_clear()


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A module in a package of this user."""
    package = tmp_path / "package"
    package.mkdir(mode=0o755)
    path = package / "loops.py"
    path.write_text(FUNCTION)
    return path


@pytest.fixture
def own() -> Path:
    """The folder in the user's caches."""
    return Path(os.environ["XDG_CACHE_HOME"]) / "polhode"


def test_it_lies_beside_the_module_as_pythons_own_also_if_its_group_may_write_there(source: Path) -> None:
    beside = source.parent / "__pycache__"
    assert code_cache(source) == beside
    for folder in (source.parent, beside):
        folder.chmod(0o775)
    module._folder.cache_clear()
    assert code_cache(source) == beside


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o775, 0o757, None])
def test_a_folder_that_others_may_write_to_is_not_used(
    mode: int | None,
    source: Path,
    own: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The one beside the module, then the one in the user's caches."""
    beside = source.parent / "__pycache__"
    if mode is None and os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    for folder, found in ((beside, own), (own, None)):
        folder.mkdir(exist_ok=True)
        os.chown(folder, 54321, -1) if mode is None else folder.chmod(mode)
        module._folder.cache_clear()
        assert code_cache(source) == found
        assert found is None or own.stat().st_mode & 0o777 == 0o700
    assert [each.levelno for each in caplog.records] == [logging.WARNING]
    assert "set NUMBA_CACHE_DIR" in caplog.text and "\n" not in caplog.records[0].getMessage()


def test_what_lies_in_a_folder_that_others_may_rename_is_not_private(tmp_path: Path) -> None:
    outer = tmp_path / "outer"
    inner = outer / "inner"
    inner.mkdir(parents=True, mode=0o700)
    assert is_private(inner)
    outer.chmod(0o777)
    assert not is_private(inner)
    (tmp_path / "link").symlink_to(outer)
    assert not is_private(tmp_path / "link"), "a link is as private as what it leads to"
    outer.chmod(0o1777)
    assert is_private(inner), "in a sticky folder only the owner can replace it"


def test_a_folder_that_the_user_names_is_used_if_it_is_private(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    named = tmp_path / "named"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(named))
    assert code_cache(source) == named
    assert named.stat().st_mode & 0o777 == 0o700
    named.chmod(0o777)
    module._folder.cache_clear()
    assert code_cache(source) is None
    assert f"NUMBA_CACHE_DIR={named} is not used" in caplog.text


def test_without_a_file_nothing_is_kept(tmp_path: Path) -> None:
    assert code_cache(tmp_path / "<stdin>") is None


def test_numba_keeps_its_files_there_and_works_without(source: Path, tmp_path: Path) -> None:
    """In processes of their own, as numba is asked when a function is decorated."""
    named, shared = tmp_path / "named", tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    command = [sys.executable, "-c", "import loops; print(loops.two())"]
    path = os.pathsep.join([str(source.parent), str(Path(__file__).parents[2])])
    for folder in (named, shared):
        environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout == "2\n"
        assert ("is not used" in done.stderr) == (folder == shared)
    assert len(list(named.rglob("*.nbi"))) == 1 and len(list(named.rglob("*.nbc"))) == 1
    assert list(shared.iterdir()) == []
    assert list(source.parent.rglob("*.nbi")) == []


def test_settings_of_numba_in_the_current_folder_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They could name a folder of planted code; the folder may be a dataset of another person."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: /tmp/planted\ndisable_jit: 1\n")
    monkeypatch.chdir(tmp_path)
    assert main(["predict", "nowhere", "--horizon", "1"]) == 2
    stderr = capsys.readouterr().err
    assert "has settings of numba" in stderr and stderr.count("\n") == 1
    path = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-P", "-c", "import polhode.runtime.compiled"],
        env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1 and "has settings of numba" in done.stderr


@pytest.mark.parametrize(("name", "bad", "good"), [("DISABLE_JIT", "1", "0"), ("NUM_THREADS", "0", "x")])
def test_a_variable_with_which_numba_cannot_work_is_named(
    name: str, bad: str, good: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(f"NUMBA_{name}", bad)
    assert main(["predict", "nowhere", "--horizon", "1"]) == 2
    stderr = capsys.readouterr().err
    assert f"NUMBA_{name}={bad} in the environment" in stderr and stderr.count("\n") == 1
    monkeypatch.setenv(f"NUMBA_{name}", good)
    assert main(["predict", "nowhere", "--horizon", "1"]) == 2
    assert f"NUMBA_{name}" not in capsys.readouterr().err
