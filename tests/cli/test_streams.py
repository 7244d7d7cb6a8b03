"""Output that nobody reads, that is full, or that is closed: the work goes on and is complete."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.writing_commands import SCENE

ROOT = Path(__file__).parents[2]
THRESHOLD = (
    f"{sys.executable} -m polhode threshold --radius-m 2 --mass-kg 100 --force-n 1 --isp-s 220"
    " --duration-s 60 --fuel-fraction 0.1"
)
REFUSED = THRESHOLD.replace("0.1", "2")
"""One line on standard error and exit code 2"""
SIMULATE = f"{sys.executable} -m polhode simulate scene.yaml -o S"
NO_READER = "(sleep 0.2; exec {}) | true; echo ${{PIPESTATUS[0]}} >&2"


def shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def test_a_reader_that_goes_away_is_not_noticed_however_much_is_printed(scene: Path) -> None:
    for words in (SIMULATE, THRESHOLD, f"{sys.executable} -m polhode run --help"):
        assert shell(NO_READER.format(words), scene).stderr == "0\n"
    assert len(list(scene.glob("S/mav0/cam0/data/*.png"))) == 1
    assert sorted(path.name for path in scene.iterdir()) == ["S", "scene.yaml"]
    done = shell(f"(sleep 0.2; exec {REFUSED}) 2>&1 >/dev/null | true; echo ${{PIPESTATUS[0]}}", scene)
    assert done.stdout == "2\n", "an error without a reader keeps its exit code"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_output_ends_with_one_line_after_the_work(scene: Path) -> None:
    done = shell(f"{SIMULATE} > /dev/full", scene)
    lost = "No space left on device: what was printed is lost, the work is complete"
    assert (done.returncode, done.stderr) == (1, f"polhode: error: standard output: {lost}\n")
    assert len(list(scene.glob("S/mav0/cam0/data/*.png"))) == 1
    done = shell(f"{REFUSED} > /dev/full", scene)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert shell(f"{REFUSED} 2> /dev/full", scene).returncode == 2


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_matter(closed: str, scene: Path) -> None:
    done = shell(f"{THRESHOLD} {closed}", scene)
    assert (done.returncode, done.stderr) == (0, "")
    assert shell(f"{REFUSED} {closed}", scene).returncode == 2
    if closed.count("&") == 3:
        assert shell(f"{SIMULATE} {closed}", scene).returncode == 0
        assert len(list(scene.glob("S/mav0/cam0/data/*.png"))) == 1


def test_what_the_encoding_cannot_show_is_escaped() -> None:
    code = "from polhode.cli.streams import tolerant_streams\nwith tolerant_streams(): print('\\xb1 \\udcff')"
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    words = [sys.executable, "-c", code]
    assert subprocess.check_output(words, env=environment, text=True) == "\\xb1 \\udcff\n"
