"""Studies on processes: of this machine, of a scheduler that runs already, and killed ones."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from polhode.cli.main import main
from polhode.errors import InputError
from polhode.studies import cluster as cluster_module
from polhode.studies.cluster import probe, probed_versions
from tests.studies.conftest import SCENE, WriteStudy
from tests.studies.test_sweep import timeless

Capture = pytest.CaptureFixture[str]
LONG_S = 300.0
"""After which a process that should have ended has failed"""
STUDY: dict[str, Any] = {
    "base": {"scene": SCENE},
    "axes": {"seed": [1, 2, 3, 4, 5, 6]},
    "steps": ["simulate"],
}
LARGER = {"rig": {"width_px": 240, "height_px": 180, "focal_px": 175.0}}
"""Images that take about as long as looking for the process that renders them"""


@contextmanager
def begun(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A process of Python; it and what it has started are ended with the block."""
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        for each in [*_below(process.pid), process]:
            each.kill()
        process.communicate()


def _below(pid: int) -> list[psutil.Process]:
    try:
        return list(psutil.Process(pid).children(recursive=True))
    except psutil.NoSuchProcess:
        return []


def until(holds: Callable[[], Any]) -> Any:
    """What a condition gives as soon as it holds."""
    deadline = time.monotonic() + LONG_S
    while time.monotonic() < deadline:
        if found := holds():
            return found
        time.sleep(0.02)
    return pytest.fail("never came")


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    return [each for each in _below(process.pid) if "spawn_main" in " ".join(each.cmdline())]


def records(folder: Path) -> int:
    return len(list(folder.glob("points/*/*.json")))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study on one worker of this machine: the file beside the folder of its results."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "study.yaml").write_text(json.dumps({**STUDY, "base": {"scene": {**SCENE, **LARGER}}}))
    assert main(["sweep", str(folder / "study.yaml"), "-o", str(folder / "out"), "--workers", "1"]) == 0
    return folder


@pytest.mark.parametrize("killed", ["program", "worker"])
def test_a_killed_study_ends_with_the_table_of_an_undisturbed_one(
    killed: str, undisturbed: Path, tmp_path: Path
) -> None:
    words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(tmp_path), "--workers", "1"]
    with begun("-m", "polhode", *words) as process:
        until(lambda: records(tmp_path) >= 2)
        workers = until(lambda: workers_of(process))
        if killed == "program":
            process.kill()
            until(lambda: not any(each.is_running() for each in workers))
        else:
            workers[0].kill()
            _, errors = process.communicate(timeout=LONG_S)
            assert (process.returncode, errors) == (0, "")
            assert records(tmp_path) == 6
    assert main(words) == 0
    assert timeless(tmp_path) == timeless(undisturbed / "out")
    assert list((tmp_path / "work").iterdir()) == []


def test_an_interrupted_study_ends_in_one_line_and_leaves_no_process(
    undisturbed: Path, tmp_path: Path
) -> None:
    words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(tmp_path), "--workers", "1"]
    with begun("-m", "polhode", *words) as process:
        until(lambda: records(tmp_path) >= 1)
        workers = until(lambda: workers_of(process))
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LONG_S)
    assert process.returncode == 128 + signal.SIGINT
    assert errors == (
        "polhode: error: sweep interrupted by SIGINT; points that are done are kept, the same command goes "
        "on from there\n"
    )
    assert not any(each.is_running() for each in workers)


@contextmanager
def begun_scheduler(file: Path, workers: int) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A scheduler with workers of one thread, each a process of its own; its address, which the file has."""
    scheduler = ("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0")
    worker = ("-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard")
    with ExitStack() as stack:
        words = (*scheduler, "--no-dashboard", "--scheduler-file", str(file))
        process = stack.enter_context(begun(*words))
        for _ in range(workers):
            stack.enter_context(begun(*worker, "--scheduler-file", str(file)))
        until(file.is_file)
        yield process, str(json.loads(file.read_text())["address"])


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with two workers."""
    with begun_scheduler(tmp_path_factory.mktemp("scheduler") / "scheduler.json", 2) as (_, address):
        yield address


def test_a_scheduler_that_runs_already_gives_the_same_table(
    scheduler: str, undisturbed: Path, tmp_path: Path, capsys: Capture
) -> None:
    words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(tmp_path)]
    assert main([*words, "--cluster", scheduler]) == 0
    assert f"workers of {scheduler}" in capsys.readouterr().out
    assert timeless(tmp_path) == timeless(undisturbed / "out")


def test_a_study_whose_scheduler_is_killed_ends_in_one_line_and_goes_on_elsewhere(
    scheduler: str, undisturbed: Path, tmp_path: Path
) -> None:
    words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(tmp_path / "out")]
    with (
        begun_scheduler(tmp_path / "scheduler.json", 1) as (other, address),
        begun("-m", "polhode", *words, "--cluster", address) as process,
    ):
        until(lambda: records(tmp_path / "out") >= 1)
        other.kill()
        _, errors = process.communicate(timeout=LONG_S)
        assert process.returncode == 1 and errors.count("\n") == 1
        assert "the scheduler was lost; points that are done are kept" in errors
    assert main([*words, "--cluster", scheduler]) == 0
    assert timeless(tmp_path / "out") == timeless(undisturbed / "out")


def test_workers_that_cannot_compute_the_study_are_refused_before_anything_runs(
    scheduler: str, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def refused() -> str:
        words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(tmp_path / "out")]
        assert main([*words, "--cluster", scheduler]) == 2
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1 and not (tmp_path / "out").exists()
        return printed

    own = probed_versions()
    monkeypatch.setattr(cluster_module, "probed_versions", lambda: own | {"numpy": "1.0"})
    assert f"has numpy {own['numpy']}, and here it is 1.0; install the same version" in refused()
    monkeypatch.setattr(cluster_module, "probed_versions", lambda: own | {"code": "another"})
    assert "has polhode of other code" in refused()


def test_a_worker_that_does_not_see_the_folder_or_an_input_says_so(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("1")
    assert probe(str(token), "1", [str(token)])["sees"] and not probe(str(token), "1", [])["lacks"]
    for answer, said in (
        (probe(str(tmp_path / "none"), "1", []), "does not see"),
        (probe(str(token), "2", []), "does not see"),
        (probe(str(token), "1", [str(tmp_path / "mesh.ply")]), "does not see .*mesh.ply"),
        (ModuleNotFoundError("No module named 'polhode.studies'"), "cannot run polhode"),
    ):
        with pytest.raises(InputError, match=f"worker 1 {said}"):
            cluster_module._check_answer("worker 1", answer, probed_versions(), tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--cluster", "tcp://127.0.0.1:1"], "no scheduler answers there"),
        (["--cluster", "nonsense://x"], "no scheduler answers there"),
        (["--cluster", "tcp://127.0.0.1:1", "--workers", "2"], "with --cluster, leave them out"),
        (["--workers", "-1"], "give 0 to 1024"),
        (["--memory-gb", "0"], "--memory-gb 0: give a number above 0"),
    ],
)
def test_a_cluster_that_cannot_be_had_gives_one_line(
    options: list[str],
    said: str,
    write_study: WriteStudy,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.2)
    path = write_study(axes={"seed": [1]}, steps=[])
    assert main(["sweep", str(path), "-o", str(tmp_path / "out"), *options]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("polhode: error: ") and printed.count("\n") == 1 and said in printed
    assert not (tmp_path / "out").exists()


def test_the_rest_of_the_program_does_not_load_dask() -> None:
    code = (
        "import sys, polhode.api, polhode.cli.main; "
        "sys.exit(' '.join({'dask', 'distributed', 'pyarrow'} & set(sys.modules)) or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=dict(os.environ)
    )
    assert (done.returncode, done.stderr) == (0, "")
