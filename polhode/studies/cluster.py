"""Workers of a study by Dask distributed: processes of this machine, or a scheduler that runs already.

Dask passes its messages as pickles, so whoever can talk to a scheduler can execute code. A cluster of our own
therefore listens on this machine alone, and only to who has the key that it makes at its start (TLS).
"""

import logging
import os
import platform
import secrets
import signal
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster

from polhode.runtime.errors import InputError
from polhode.runtime.processes import worker_count
from polhode.runtime.program_digest import code_digest

CONNECT_S = 10.0
CHECKED = ("polhode", "python", "numpy", "distributed")
SETTINGS: dict[str, Any] = {
    # with one more killed worker, the point has failed
    "distributed.scheduler.allowed-failures": 3,
    # Results are small: nothing is worth a disk, and a worker that pauses for its memory would never go on.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.worker.profile.enabled": False,
    "distributed.diagnostics.nvml": False,
}


@dataclass(frozen=True)
class ClusterOptions:
    """Where the points are computed."""

    address: str | None = None
    """Of a scheduler; None: processes of this machine"""
    workers: int = 0
    """Processes of this machine; 0: one per core"""
    memory_gb: float | None = None
    """Limit of each process [1e9 bytes]; None: equal shares of the memory"""


@dataclass(frozen=True)
class Cluster:
    """What computes."""

    client: Client
    workers: int
    description: str


@contextmanager
def opened_cluster(options: ClusterOptions, folder: Path, inputs: Sequence[Path]) -> Iterator[Cluster]:
    """Start processes, or connect with a scheduler and check its workers, until the block ends.

    ``folder``: of the study; ``inputs``: files and folders that the points read. Raises InputError: no
    scheduler answers, it has no workers, or they cannot compute the study. What Dask says of its workers is
    no message of the program: a point that failed has its reason.
    """
    logger = logging.getLogger("distributed")
    level = logger.level
    try:
        if options.address is None:
            logger.setLevel(logging.CRITICAL)
            with _local(options) as cluster:
                yield cluster
        else:
            with _connected(options.address) as client:
                logger.setLevel(logging.CRITICAL)
                workers = _checked_workers(client, options.address, folder, inputs)
                yield _described(client, workers, f"{workers} workers of {options.address}")
    finally:
        logger.setLevel(level)


def _described(client: Client, workers: int, description: str) -> Cluster:
    if find_spec("bokeh") and client.dashboard_link:
        description += f"; dashboard: {client.dashboard_link}"
    return Cluster(client, workers, description)


@contextmanager
def _local(options: ClusterOptions) -> Iterator[Cluster]:
    """Workers of this machine, which import nothing from the current folder: it may be another person's."""
    workers = worker_count(options.workers)
    with (
        tempfile.TemporaryDirectory(prefix="polhode-sweep-", ignore_cleanup_errors=True) as scratch,
        dask.config.set(SETTINGS),
        _safe_path(),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit="auto" if options.memory_gb is None else int(options.memory_gb * 1e9),
            host="127.0.0.1",
            security=True,
            dashboard_address="127.0.0.1:0",
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        try:
            plural = "s" if workers > 1 else ""
            yield _described(client, workers, f"{workers} worker{plural} on this machine")
        except BaseException:
            # at once: otherwise each worker would end its point, for up to half a minute
            for nanny in cluster.workers.values():
                nanny.auto_restart = False
                if nanny.process is not None and nanny.process.pid:
                    with suppress(ProcessLookupError):
                        os.kill(nanny.process.pid, signal.SIGKILL)
            raise


@contextmanager
def _safe_path() -> Iterator[None]:
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        os.environ.pop("PYTHONSAFEPATH")
        if before is not None:
            os.environ["PYTHONSAFEPATH"] = before


def _connected(address: str) -> Client:
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as error:
        said = str(error).partition("\n")[0][:120]
        raise InputError(
            f"--cluster {address}: no scheduler answers there ({said}); start one (dask scheduler), and give "
            "its address, such as tcp://HOST:8786"
        ) from None


def _checked_workers(client: Client, address: str, folder: Path, inputs: Sequence[Path]) -> int:
    """How many workers there are. Raises InputError unless all of them can compute the study."""
    try:
        client.wait_for_workers(1, timeout=30.0)
    except TimeoutError:
        raise InputError(
            f"--cluster {address}: the scheduler has no workers; start some: dask worker {address} "
            "--nworkers 2 --nthreads 1"
        ) from None
    for worker, threads in sorted(client.nthreads().items()):
        if threads != 1:
            raise InputError(
                f"--cluster {address}: worker {worker} has {threads} threads, and a point takes a whole "
                "process; start it with --nthreads 1, and --nworkers for more processes"
            )
    token = secrets.token_hex(16)
    file = folder / f".token-{token}"
    file.write_text(token, encoding="utf-8")
    try:
        answers = client.run(probe, str(file), token, [str(each) for each in inputs], on_error="return")
    finally:
        file.unlink()
    own = probed_versions()
    for worker, answer in sorted(answers.items()):
        _check_answer(f"--cluster {address}: worker {worker}", answer, own, folder)
    return len(answers)


def _check_answer(worker: str, answer: Any, own: dict[str, str], folder: Path) -> None:
    if isinstance(answer, BaseException):
        said = str(answer).partition("\n")[0][:120]
        raise InputError(f"{worker} cannot run polhode ({said}); install the same version there")
    for name in CHECKED:
        if answer[name] != own[name]:
            raise InputError(
                f"{worker} has {name} {answer[name]}, and here it is {own[name]}; install the same version"
            )
    if answer["code"] != own["code"]:
        raise InputError(f"{worker} has polhode of other code, or other libraries; install the same there")
    if not answer["sees"]:
        raise InputError(
            f"{worker} does not see {folder}, or cannot write there; give -o a folder of a file system that "
            "all workers share"
        )
    if answer["lacks"]:
        raise InputError(f"{worker} does not see {answer['lacks'][0]}; put it where all workers see it")


def probe(file: str, token: str, inputs: Sequence[str]) -> dict[str, Any]:
    """On a worker: its versions, whether it sees a file of the study and can write beside it, and which of
    the inputs it does not have."""
    sees = False
    with suppress(OSError):
        sees = Path(file).read_text(encoding="utf-8") == token and os.access(Path(file).parent, os.W_OK)
    lacks = [each for each in inputs if not Path(each).exists()]
    return {**probed_versions(), "sees": sees, "lacks": lacks}


def probed_versions() -> dict[str, str]:
    """What must be equal on all machines."""
    own = {"python": platform.python_version(), "code": code_digest()}
    return {name: own.get(name) or version(name) for name in (*CHECKED, "code")}
