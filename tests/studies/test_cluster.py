"""Studies on processes: of this machine, of a scheduler that runs already, and killed ones.

Processes take seconds to start, and what they compute takes no time. Their points wait until the test allows
them, so that whatever is killed is killed while it computes a point.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import dask
import psutil
import pytest
from distributed import Client

from polhode.cli.main import main
from polhode.runtime.errors import InputError
from polhode.studies import cluster as cluster_module
from polhode.studies import sweep as flow
from polhode.studies.cluster import probe, probed_versions
from polhode.studies.store import Store
from tests.studies.conftest import SCENE, WriteStudy, thread_of, timeless

Capture = pytest.CaptureFixture[str]
LONG_S = 300.0
"""After which a process that should have ended has failed"""
POINTS = 3
STUDY: dict[str, Any] = {
    "base": {"scene": SCENE},
    "axes": {"seed": [1], "backend.accel_psd": [1e-6, 1e-5, 1e-4]},
    "steps": ["simulate"],
}
PATIENT = Path(__file__).with_name("patient_worker.py")


def below(pid: int) -> list[psutil.Process]:
    """What a process has started."""
    with suppress(psutil.NoSuchProcess):
        return list(psutil.Process(pid).children(recursive=True))
    return []


def workers_of(pid: int) -> list[psutil.Process]:
    """The workers of a program with a cluster of its own; none once the program has ended."""
    found = list[psutil.Process]()
    for each in below(pid):
        with suppress(psutil.NoSuchProcess):
            if "spawn_main" in " ".join(each.cmdline()):
                found.append(each)
    return found


def allow(folder: Path, points: int) -> None:
    """Let the workers of a study compute until so many points are stored."""
    partial = folder.parent / "allowed.partial"
    partial.write_text(str(points))
    partial.rename(folder.parent / "allowed")


@contextmanager
def begun(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A process of Python; it and what it has started are ended with the block."""
    env = {**os.environ, "DASK_DISTRIBUTED__WORKER__PRELOAD": str([str(PATIENT)])}
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, *words], stdout=pipe, stderr=pipe, text=True, env=env)
    try:
        yield process
    finally:
        for each in [*below(process.pid), process]:
            each.kill()
        process.communicate()


@contextmanager
def beside(action: Callable[[], None], finally_: Callable[[], None]) -> Iterator[None]:
    """Do something in another thread meanwhile; whatever comes of it, the block can end."""
    with ThreadPoolExecutor(1) as thread:
        future = thread.submit(action)
        future.add_done_callback(lambda _: finally_())
        yield
        future.result()


def until(holds: Callable[[], Any]) -> Any:
    """What a condition gives as soon as it holds."""
    deadline = time.monotonic() + LONG_S
    while time.monotonic() < deadline:
        if found := holds():
            return found
        time.sleep(0.02)
    return pytest.fail("never came")


def records(folder: Path) -> int:
    return len(list(folder.glob("points/*/*.json"))) or len(list(Store(folder).records()))


def computes_after(points: int, folder: Path) -> Callable[[], bool]:
    """Whether so many points are stored and a worker has begun with another."""
    return lambda: records(folder) >= points and any((folder / "work").iterdir())


@pytest.fixture(scope="module")
def undisturbed(client: Client, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study, computed in this process: the file beside the folder of its results."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "study.yaml").write_text(json.dumps(STUDY))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flow, "opened_cluster", thread_of(client))
        assert main(["sweep", str(folder / "study.yaml"), "-o", str(folder / "out")]) == 0
    assert records(folder / "out") == POINTS
    return folder


def test_a_study_that_is_interrupted_and_whose_worker_is_killed_has_the_table_of_an_undisturbed_one(
    undisturbed: Path, tmp_path: Path, capfd: Capture
) -> None:
    out = tmp_path / "out"
    words = ["sweep", str(undisturbed / "study.yaml"), "-o", str(out), "--workers", "1"]

    # interrupted: one line, and no process stays
    allow(out, 1)
    with begun("-m", "polhode", *words) as process:
        until(computes_after(1, out))
        workers = workers_of(process.pid)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LONG_S)
        assert workers and not any(each.is_running() for each in workers)
    assert process.returncode == 128 + signal.SIGINT
    assert errors == (
        "polhode: error: sweep interrupted by SIGINT; points that are done are kept, the same command goes "
        "on from there\n"
    )
    assert records(out) == 1

    # a worker is killed: another one computes its point, and nothing is said of it
    def kill_a_worker() -> None:
        until(computes_after(2, out))
        (worker,) = workers_of(os.getpid())
        worker.kill()
        until(lambda: set(workers_of(os.getpid())) - {worker})

    allow(out, 2)
    capfd.readouterr()
    with (
        dask.config.set({"distributed.worker.preload": [str(PATIENT)]}),
        beside(kill_a_worker, lambda: allow(out, POINTS)),
    ):
        assert main(words) == 0
    assert capfd.readouterr().err == ""
    assert timeless(out) == timeless(undisturbed / "out") and records(out) == POINTS
    # what it left of its attempt goes with the next command
    assert main(words) == 0 and not list((out / "work").iterdir())


def test_a_scheduler_that_runs_already_may_be_lost_and_the_study_goes_on_elsewhere(
    undisturbed: Path, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    study, out, file = str(undisturbed / "study.yaml"), tmp_path / "out", tmp_path / "scheduler.json"
    words = ["sweep", study, "-o", str(out)]
    scheduled = ("--no-dashboard", "--scheduler-file", str(file))
    listening = ("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0")
    working = ("-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny")
    with begun(*listening, *scheduled) as scheduler, begun(*working, *scheduled):
        until(file.is_file)
        address = str(json.loads(file.read_text())["address"])
        with Client(address, set_as_default=False) as other:
            other.wait_for_workers(1, timeout=LONG_S)

        # workers that lack a file which the points read are refused, as on a machine without that disk
        mesh, opened = tmp_path / "mesh.ply", cluster_module.opened_cluster
        with monkeypatch.context() as patch:
            patch.setattr(
                flow,
                "opened_cluster",
                lambda options, folder, inputs: opened(options, folder, [*inputs, mesh]),
            )
            assert main([*words, "--cluster", address]) == 2
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1 and not out.exists()
        assert f"does not see {mesh}; put it where all workers see it" in printed

        def kill_the_scheduler() -> None:
            until(computes_after(1, out))
            scheduler.kill()

        allow(out, 1)
        # as long as a lost scheduler is looked for, too
        monkeypatch.setattr(cluster_module, "CONNECT_S", 4.0)
        with beside(kill_the_scheduler, scheduler.kill):
            assert main([*words, "--cluster", address]) == 1
        said, printed = capsys.readouterr()
        assert printed.count("\n") == 1 and f"1 workers of {address}" in said
        assert "the scheduler was lost; points that are done are kept" in printed
    assert 1 <= records(out) < POINTS
    monkeypatch.setattr(flow, "opened_cluster", thread_of(client))
    assert main(words) == 0
    assert timeless(out) == timeless(undisturbed / "out")


def test_workers_that_cannot_compute_the_study_are_named(tmp_path: Path) -> None:
    token, own = tmp_path / "token", probed_versions()
    token.write_text("1")
    answer = probe(str(token), "1", [str(token)])
    cluster_module._check_answer("worker 1", answer, own, tmp_path)
    for wrong, said in (
        (probe(str(tmp_path / "none"), "1", []), "does not see"),
        (probe(str(token), "2", []), "does not see"),
        (probe(str(token), "1", [str(tmp_path / "mesh.ply")]), f"does not see {tmp_path / 'mesh.ply'}"),
        (ModuleNotFoundError("No module named 'polhode.studies'"), "cannot run polhode"),
        (answer | {"code": "another"}, "has polhode of other code"),
        *(
            (answer | {name: "0.0"}, f"has {name} 0.0, and here it is {own[name]}; install the same version")
            for name in cluster_module.CHECKED
        ),
    ):
        with pytest.raises(InputError) as refusal:
            cluster_module._check_answer("worker 1", wrong, own, tmp_path)
        assert str(refusal.value).startswith(f"worker 1 {said}")
    token.unlink()

    threads: dict[str, int] = {}

    def wait(count: int, timeout: float) -> None:
        if not threads:
            raise TimeoutError

    client: Any = SimpleNamespace(wait_for_workers=wait, nthreads=lambda: threads)
    for workers, said in (
        ({}, "the scheduler has no workers; start some: dask worker tcp://1:2 --nworkers 2 --nthreads 1"),
        (
            {"tcp://1:3": 4},
            "worker tcp://1:3 has 4 threads, and a point takes a whole process; start it with --nthreads 1",
        ),
    ):
        threads |= workers
        with pytest.raises(InputError) as refusal:
            cluster_module._checked_workers(client, "tcp://1:2", tmp_path, [])
        assert said in str(refusal.value) and "\n" not in str(refusal.value)
        assert list(tmp_path.iterdir()) == []


BAD = {
    "--cluster tcp://127.0.0.1:1": "no scheduler answers there",
    "--cluster nonsense://x": "no scheduler answers there",
    "--cluster tcp://127.0.0.1:1 --workers 2": "with --cluster, leave them out",
    "--workers -1": "give a whole number from 0 to 1024",
    "--memory-gb 0": "--memory-gb 0: give a number above 0",
}


def test_a_cluster_that_cannot_be_had_gives_one_line(
    write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.2)
    path = write_study(axes={"seed": [1]}, steps=[])
    for options, said in BAD.items():
        assert main(["sweep", str(path), "-o", str(tmp_path / "out"), *options.split()]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("polhode: error: ") and printed.count("\n") == 1 and said in printed
        assert not (tmp_path / "out").exists()
