"""Work over processes: results in order for any number of workers, errors reach the caller."""

import errno
import gc
import multiprocessing.forkserver
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Any, cast

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from polhode.runtime import processes
from polhode.runtime.errors import RunFailure
from polhode.runtime.interrupts import interrupts_raised, raise_if_received
from polhode.runtime.processes import BACKGROUND_NICENESS, Background, in_order, worker_count

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Square:
    """Squares; fails at one number."""

    bad: int = -1

    def __call__(self, k: int) -> int:
        if k == self.bad:
            raise ValueError(f"frame {k}")
        return k * k


def program(folder: Path, script: str, **options: Any) -> subprocess.Popen[str]:
    """A script that runs in its own process, with the modules of its folder."""
    (folder / "start.py").write_text(script)
    environment = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"}
    environment.pop("PYTHONSAFEPATH", None)
    given: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": folder, **options}
    command = [sys.executable, str(folder / "start.py")]
    started: subprocess.Popen[str] = subprocess.Popen(command, env=environment, text=True, **given)
    return started


def test_an_interrupt_while_the_server_imports_is_left_to_the_program(tmp_path: Path) -> None:
    """As Ctrl-C does it: the signal goes to all processes of the terminal."""
    (tmp_path / "slow.py").write_text("import time\nopen('begun', 'w').close()\ntime.sleep(2)\n")
    script = (
        "import time\nfrom polhode.runtime.processes import start_server\nstart_server(('slow',), 2)\n"
        "try:\n    time.sleep(60)\nexcept KeyboardInterrupt:\n    print('ended')\n"
    )
    started = program(
        tmp_path,
        script,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        assert _eventually((tmp_path / "begun").exists)
        os.killpg(started.pid, signal.SIGINT)
        assert started.communicate(timeout=60) == ("ended\n", "")
    finally:
        started.kill()


def test_an_interrupt_while_abandoned_results_are_cleaned_up_is_neither_printed_nor_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """``zip`` ends with its first argument: it is the garbage collector that then closes the results."""
    ignored: list[object] = []
    shutdown = ProcessPoolExecutor.shutdown

    def interrupted(self: ProcessPoolExecutor, wait: bool = True, *, cancel_futures: bool = False) -> None:
        monkeypatch.setattr(ProcessPoolExecutor, "shutdown", shutdown)
        os.kill(os.getpid(), signal.SIGINT)
        shutdown(self, wait, cancel_futures=cancel_futures)

    with interrupts_raised(first=processes.kill_workers):
        pairs = list(zip(range(3), in_order(Square(), range(6), 2), strict=False))
        monkeypatch.setattr(sys, "unraisablehook", ignored.append)
        results = in_order(Square(), range(6), 2)
        assert next(results) == 0
        monkeypatch.setattr(ProcessPoolExecutor, "shutdown", interrupted)
        del results
        gc.collect()
        assert pairs == [(0, 0), (1, 1), (2, 4)] and ignored == []
        with pytest.raises(KeyboardInterrupt):
            raise_if_received()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_come_in_order_and_an_error_after_the_results_before_it(workers: int) -> None:
    assert list(in_order(Square(), range(20), workers)) == [k * k for k in range(20)]
    assert list(in_order(Square(), [], workers)) == []
    assert worker_count(0) == len(os.sched_getaffinity(0)) and worker_count(3) == 3
    results = in_order(Square(bad=5), range(9), workers)
    assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
    with pytest.raises(ValueError, match="frame 5"):
        next(results)


def is_loaded(module: str) -> bool:
    return module in sys.modules


@pytest.mark.parametrize("early", [True, False])
def test_the_server_imports_what_workers_need_while_the_command_does_something_else(
    early: bool, tmp_path: Path
) -> None:
    module = "polhode.geometry.camera"
    begin = f"start_server(({module!r},), workers=2)" if early else ""
    script = (
        "from polhode.runtime.processes import in_order, start_server\n"
        "from tests.runtime.test_processes import is_loaded\n"
        f"{begin}\nprint(list(in_order(is_loaded, [{module!r}] * 2, 2)))"
    )
    assert program(tmp_path, script).communicate() == (f"{[early] * 2}\n", "")


def kill_itself(k: int) -> int:
    if k == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return k


def test_a_killed_process_is_reported() -> None:
    with pytest.raises(RunFailure, match="a worker process was killed"):
        list(in_order(kill_itself, range(4), 2))


def kill_server(k: int) -> int:
    if k == 0:
        # later on, another process is the parent
        os.kill(os.getppid(), signal.SIGKILL)
    return k


def test_a_killed_server_of_the_workers_costs_at_most_this_work() -> None:
    found, said = [], ""
    try:
        found = list(in_order(kill_server, range(4), 2))
    except RunFailure as failure:
        said = str(failure)
    # workers that were started before may do everything
    assert found == [0, 1, 2, 3] or "was killed, perhaps for lack of memory: use fewer --runtime" in said
    assert list(in_order(Square(), range(4), 2)) == [0, 1, 4, 9]


@pytest.mark.parametrize("error", [EOFError, BrokenPipeError, ConnectionRefusedError])
def test_a_server_that_is_killed_before_it_starts_a_worker_is_replaced_or_reported(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = multiprocessing.forkserver.connect_to_new_process, []

    def lost(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) <= losses:
            raise error
        return real(*arguments)

    monkeypatch.setattr("multiprocessing.forkserver.connect_to_new_process", lost)
    losses = 1  # its end is noticed only now
    assert list(in_order(Square(), range(4), 2)) == [0, 1, 4, 9] and len(calls) > 1
    calls.clear()
    losses = 100
    with pytest.raises(RunFailure, match="the process that starts the workers was killed, perhaps for lack"):
        list(in_order(Square(), range(4), 2))


def threads_and_interrupts(k: int) -> tuple[int, int]:
    """Most threads of a library, and the process, which neither Ctrl-C nor what ends a group ends."""
    np.linalg.inv(np.eye(2))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(os.getpid(), number)
    return max(each["num_threads"] for each in threadpool_info()), os.getpid()


def test_a_worker_uses_one_thread_and_leaves_interrupts_to_its_parent() -> None:
    found = list(in_order(threads_and_interrupts, range(4), 2))
    assert {threads for threads, _ in found} == {1}
    assert os.getpid() not in {process for _, process in found}


def test_workers_import_no_module_from_the_current_folder(tmp_path: Path) -> None:
    """It may be the dataset of another person."""
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for module in ("multiprocessing", "selectors", "yaml", "polhode"):
        (theirs / f"{module}.py").write_text("open('sprung', 'a').write(__name__)\n")
    script = (
        "import os\nfrom polhode.runtime.processes import in_order\n\nif __name__ == '__main__':\n"
        "    assert list(in_order(abs, range(3), 2, ['yaml'])) == [0, 1, 2]\n"
        "    print('PYTHONSAFEPATH' in os.environ)\n"
    )
    assert program(tmp_path, script, cwd=theirs).communicate() == ("False\n", "")
    assert not (theirs / "sprung").exists()


ENDLESS = (
    "import os, re, time\nfrom pathlib import Path\n\n\ndef wait(k: int) -> None:\n"
    "    Path(f'{k}.pid').write_text(str(os.getpid()))\n"
)
FAMILIES = {
    "asleep": ("time.sleep(600)", "wait", "[]"),
    # One long call of C, which lets no other thread of the process run.
    "holding the interpreter": ("re.match(r'(a+)+b', 'a' * 60)", "wait", "[]"),
    "a server that imports": ("", "abs", "['slow']"),
    "a worker that imports": ("", "Work()", "[]"),
}


@pytest.mark.parametrize("doing", FAMILIES)
def test_processes_end_with_their_parent_whatever_they_are_doing(doing: str, tmp_path: Path) -> None:
    line, work, preload = FAMILIES[doing]
    (tmp_path / "slow.py").write_text(f"{ENDLESS}    time.sleep(600)\n\n\nwait(1)\n")
    (tmp_path / "work.py").write_text(
        "class Work:\n"
        "    def __call__(self, k: int) -> None: ...\n"
        "    def __reduce__(self): return (__import__, ('slow',))\n"
    )
    script = (
        f"from work import Work\nfrom polhode.runtime.processes import in_order\n{ENDLESS}    {line}\n\n\n"
        f"if __name__ == '__main__':\n    list(in_order({work}, range(2), 2, {preload}))\n"
    )
    parent = program(tmp_path, script)
    try:
        assert _eventually(lambda: len(_numbers(tmp_path)) == (2 if line else 1))
        family = descendants(parent.pid)
        # two workers, the server that forks them, the tracker of their semaphores
        assert len(family) == 4 if line else _numbers(tmp_path)[0] in family
    finally:
        parent.kill()
        parent.communicate()
    assert _eventually(lambda: not any(_is_there(number) for number in family), limit_s=10.0)


def test_a_started_program_ends_with_its_parent(tmp_path: Path) -> None:
    parent = program(
        tmp_path,
        "import subprocess\nfrom polhode.runtime.parent_death import tied\n"
        "child = subprocess.Popen(tied(['sleep', '600']))\nprint(child.pid, flush=True)\nchild.wait()\n",
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert _eventually(lambda: "sleep" in Path(f"/proc/{child}/cmdline").read_text())
    parent.kill()
    parent.communicate()
    assert _eventually(lambda: not _is_there(child), limit_s=10.0)


def descendants(process: int) -> list[int]:
    """The processes that a process has started, and those that these have."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = int(path.read_text().rpartition(")")[2].split()[1])
            if parent == process:
                found += [int(path.parent.name), *descendants(int(path.parent.name))]
    return found


def _is_there(process: int) -> bool:
    """Whether a process is alive, not merely waiting for its parent to notice its end."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def test_without_processes_the_work_is_done_here(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*arguments: object) -> None:
        raise OSError(errno.ENOENT, "No such file or directory", "/dev/shm")

    monkeypatch.setattr(processes, "ProcessPoolExecutor", refuse)
    assert list(in_order(Square(), range(4), 2)) == [0, 1, 4, 9]
    assert "no parallel processes can be started" in caplog.text


class Counting:
    """Counts its calls, and says at which priority they are made."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, item: str) -> tuple[str, int, int]:
        if item == "fail":
            raise ValueError(item)
        self.calls += 1
        return item, self.calls, os.nice(0)


def test_a_process_in_the_background_keeps_what_it_finds() -> None:
    background = Background(Counting())
    futures = [background.submit(item) for item in ("a", "fail", "b")]
    assert all(future is not None for future in futures)
    first, failed, second = (cast("Future[tuple[str, int, int]]", future) for future in futures)
    assert first.result()[:2] == ("a", 1) and second.result()[:2] == ("b", 2)
    assert isinstance(failed.exception(), ValueError)
    assert second.result()[2] == min(os.nice(0) + BACKGROUND_NICENESS, 19)
    background.close()
    background.close()
    assert background.submit("c") is None


def slowly(item: Path) -> None:
    sleep(0.1)
    item.touch()


def test_what_a_closed_process_had_not_begun_is_never_done(tmp_path: Path) -> None:
    """Nothing refers to its pool any more, by which alone the library would not cancel it."""
    background = Background(slowly)
    futures = [background.submit(tmp_path / f"{k}") for k in range(20)]
    assert futures[0] is not None and futures[0].result() is None
    background.close()
    del background
    gc.collect()
    sleep(1.0)
    # that in work, and those that its process had been given already
    assert len(list(tmp_path.iterdir())) <= 5


def _numbers(folder: Path, names: str = "*.pid") -> list[int]:
    texts = [path.read_text() for path in folder.glob(names)]
    return [int(text) for text in texts if text]


def _eventually(holds: Callable[[], bool], limit_s: float = 60.0) -> bool:
    end = monotonic() + limit_s
    while not holds():
        if monotonic() > end:
            return False
        sleep(0.05)
    return True


def sleeps(path: Path) -> None:
    path.write_text(str(os.getpid()))
    sleep(600.0)


def test_a_process_in_the_background_is_ended_amid_its_work(tmp_path: Path) -> None:
    background = Background(sleeps)
    background.submit(tmp_path / "number")
    assert _eventually(lambda: len(_numbers(tmp_path, "number")) == 1)
    background.close(kill=True)
    assert _eventually(lambda: not _is_there(_numbers(tmp_path, "number")[0]), limit_s=10.0)


def squares_in_a_pool(count: int) -> list[int]:
    """Called in a worker process of the caller, which may have no children."""
    return list(in_order(Square(), range(count), 2))


def test_a_worker_process_of_the_caller_does_the_work_itself() -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(squares_in_a_pool, (3,)) == [0, 1, 4]


class _Holder:
    """Work that calls a function which it holds."""

    def __init__(self, function: Callable[[int], int]) -> None:
        self.function = function


def test_work_that_holds_a_function_of_the_script_needs_the_script() -> None:
    def of_the_script(item: int) -> int:
        return item

    assert not processes._needs_script(_Holder(of_the_script))
    of_the_script.__module__ = "__main__"
    assert processes._needs_script(_Holder(of_the_script))
    assert processes._needs_script(partial(map, of_the_script))
