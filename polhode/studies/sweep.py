"""The flow of ``polhode sweep``: what is missing, a window of tasks on a cluster, the table of all records.

A point is stored by the worker that computed it, so that whatever is killed loses at most what is in flight.
"""

import logging
import secrets
from array import array
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from distributed import CancelledError, as_completed
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from polhode.config import Config
from polhode.config.loader import plain_settings
from polhode.files.atomic import write_text
from polhode.files.output.locks import occupied
from polhode.files.output.marked_folder import claim, marked_place, withdrawn_if_refused
from polhode.files.output.place import folder_place, unwritable
from polhode.runtime.errors import InputError, RunFailure, one_line
from polhode.runtime.processes import worker_count
from polhode.runtime.program_digest import code_digest
from polhode.runtime.progress import NOTE, Progress
from polhode.simulation.dataset.sequence import sequence_digest
from polhode.studies.cluster import Cluster, ClusterOptions, opened_cluster
from polhode.studies.page.write_page import write_page
from polhode.studies.steps import (
    FAILED,
    OtherCode,
    PointJob,
    SequenceJob,
    SequenceOutcome,
    compute_point,
    failed_record,
    simulate_sequence,
    versions,
)
from polhode.studies.store import PARTS, Store
from polhode.studies.study import OpenStudy, Point
from polhode.studies.table import COMMAND, FILES, PAGE, STUDY, TABLE, stored_rows, write_table

READY_PER_WORKER = 3
"""Tasks per worker that could begin at once: one that is computed, two that wait for it"""
_SEQUENCE = "sequence-"
_KEPT = "points that are done are kept, the same command goes on from there"
_log = logging.getLogger(__name__)


@dataclass
class Swept:
    """What a study has at its end."""

    table: Path
    points: int
    stored: int
    """Points that were there before"""
    failed: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    """Reasons of points that failed, and how many have each"""


def sweep(
    study: OpenStudy,
    folder: Path,
    progress: Progress,
    cluster: ClusterOptions,
    again_failed: bool = False,
) -> Swept:
    """Compute the points of a study that ``folder`` lacks, and write its table and its page.

    ``again_failed``: points that have failed are computed again. Raises InputError for what is wrong with the
    folder or the cluster, before any point is computed; RunFailure when the cluster is lost.
    """
    place = folder_place(folder)
    with occupied(place, folder), withdrawn_if_refused(place, COMMAND, FILES, PARTS):
        store = Store(_claim_folder(folder))
        store.clear_work()
        # every record names them: an installation that cannot is found before anything is computed
        versions()
        missing = _missing(study, store, again_failed, progress)
        if missing:
            if cluster.address is None:
                cluster = replace(cluster, workers=min(worker_count(cluster.workers), len(missing)))
            with opened_cluster(cluster, store.folder, study.inputs()) as opened:
                # from here on, the table of what was there before is that of another study
                write_text(store.folder / STUDY, study.text())
                for name in (TABLE, PAGE):
                    (store.folder / name).unlink(missing_ok=True)
                _log.log(NOTE, "%s", opened.description)
                with progress.stage("points", len(missing)) as advance:
                    for _ in _Window(study, store, opened, missing).outcomes():
                        advance()
        write_text(store.folder / STUDY, study.text())
        return _gather_results(study, store, len(missing), progress)


def _claim_folder(folder: Path) -> Path:
    """Make the folder and mark it as ours. Raises InputError."""
    place = marked_place(folder, COMMAND, FILES.__contains__)
    for link in (place / part for part in PARTS if (place / part).is_symlink()):
        raise InputError(f"{link}: this is a link, which a study does not write through; remove it")
    claim(place, COMMAND, FILES)
    for part in PARTS:
        try:
            (place / part).mkdir(exist_ok=True)
        except OSError as error:
            raise unwritable(place / part, error) from error
    return place


def _missing(study: OpenStudy, store: Store, again_failed: bool, progress: Progress) -> "array[int]":
    """Numbers of the points that are to be computed. Of a new study nothing is looked up or said."""
    if not store.has_records():
        return array("l", range(study.count))
    missing = array("l")
    with progress.stage("points looked up", study.count) as advance:
        for number in range(study.count):
            record = store.read(study.point(number).address)
            if record is None or (again_failed and record["status"] == FAILED):
                missing.append(number)
            advance()
    _log.log(NOTE, "%d of %d points are stored already", study.count - len(missing), study.count)
    return missing


def _gather_results(study: OpenStudy, store: Store, computed: int, progress: Progress) -> Swept:
    found = Swept(store.folder / TABLE, study.count, study.count - computed)
    with progress.stage("table", 1) as advance:
        rows = write_table(study, store, found.table)
        advance()
    if rows != study.count:
        raise RunFailure(
            f"{store.folder}: {study.count - rows} points have no record, although all were computed; was "
            "the folder changed meanwhile? Repeat the command"
        )
    found.reasons = Counter(row["reason"] for row in stored_rows(study, store) if row["status"] == FAILED)
    found.failed = found.reasons.total()
    with progress.stage("page", 1) as advance:
        write_page(study, store.folder)
        advance()
    store.pack(study.point(number).address for number in range(study.count))
    return found


def rewrite_page(study: OpenStudy, folder: Path) -> Path:
    """Write study.html of what is stored, and compute nothing. Returns the file.

    Raises InputError: the folder is that of no study, or another process is at work there.
    """
    place = marked_place(folder, COMMAND, FILES.__contains__)
    with occupied(place, folder):
        write_page(study, place)
    return place / PAGE


class _Window:
    """Tasks in flight: enough that no worker waits, few enough that a million points take no memory.

    A sequence that is not there yet is a task of its own, which all points wait for that use it. While they
    wait, later points are looked at, so that workers do not wait for one sequence.
    """

    def __init__(self, study: OpenStudy, store: Store, cluster: Cluster, missing: "array[int]") -> None:
        self._study, self._store, self._client = study, store, cluster.client
        self._missing, self._workers, self._code = iter(missing), cluster.workers, code_digest()
        self._simulates = "simulate" in study.settings.steps
        # two studies on one scheduler may have the same point, and each stores its own record
        token = secrets.token_hex(4)
        self._point_key, self._sequence_key = f"point-{token}-", f"{_SEQUENCE}{token}-"
        self._completed = as_completed([], loop=cluster.client.loop)
        self._points: dict[str, tuple[Point, str]] = {}
        """Key of a task -> its point and the digest of its sequence"""
        self._renders: dict[str, Any] = {}
        """Digest -> task of the sequence, while a point in flight uses it"""
        self._rendering: set[str] = set()
        self._waiting: Counter[str] = Counter()
        """Digest -> points in flight that use the sequence"""
        self._unsimulated: dict[str, str] = {}
        """Digest -> reason why there is no sequence"""
        self._removes = self._simulates and not study.settings.keep_sequences
        self._left: Counter[str] = Counter()
        """Digest -> points that still need the sequence, where it is removed after the last"""
        for number in missing if self._removes else ():
            with suppress(InputError):
                self._left[self._sequence_of(study.config(study.point(number)))] += 1

    def outcomes(self) -> Iterator[str]:
        """The status of each point as it is stored. Raises RunFailure."""
        yield from self._fill()
        while self._points:
            future = next(self._completed)
            if future.key not in self._points:
                self._note_render(future)
            else:
                point, digest = self._points.pop(future.key)
                status = self._status(future, point, digest)
                if digest:
                    self._release(digest)
                yield status
            del future
            yield from self._fill()

    def _fill(self) -> Iterator[str]:
        """Submit points until there are enough. Yields the status of those that need no worker."""
        while len(self._points) < 64 * self._workers:
            # tasks that no other task holds back
            held = sum(self._waiting[digest] for digest in self._rendering)
            ready = len(self._rendering) + len(self._points) - held
            number = next(self._missing, None) if ready < READY_PER_WORKER * self._workers else None
            if number is None:
                return
            point = self._study.point(number)
            try:
                self._submit(point)
            except InputError as error:
                said = one_line(str(error).removeprefix(f"{self._study.source}: "))
                self._store.write(failed_record(point.address, point.values, f"settings: {said}"))
                yield FAILED

    def _submit(self, point: Point) -> None:
        study, config = self._study, self._study.config(point)
        settings = plain_settings(config)
        digest = self._sequence_of(config) if self._simulates else ""
        job = PointJob(
            folder=self._store.folder,
            address=point.address,
            values=point.values,
            steps=study.settings.steps,
            config=settings,
            plan=study.plan_options(point),
            keep=study.settings.keep,
            code=self._code,
            sequence=digest,
            data=study.data(point),
        )
        render = self._render_of(digest, settings) if digest else None
        key = f"{self._point_key}{point.address}"
        future = self._client.submit(compute_point, job, render, key=key, pure=False)
        self._points[key] = (point, digest)
        if digest:
            self._waiting[digest] += 1
        self._completed.add(future)

    def _sequence_of(self, config: Config) -> str:
        assert config.scene is not None
        return sequence_digest(config.scene, config.seed)

    def _render_of(self, digest: str, settings: dict[str, Any]) -> Any:
        """What a point waits for: a task, or an outcome that is known. None: the sequence is there."""
        if digest in self._unsimulated:
            return SequenceOutcome(self._unsimulated[digest])
        if digest not in self._renders:
            if self._store.has_sequence(digest):
                return None
            job = SequenceJob(self._store.folder, digest, settings, self._code)
            key = f"{self._sequence_key}{digest}"
            self._renders[digest] = self._client.submit(
                simulate_sequence, job, key=key, pure=False, priority=1
            )
            self._rendering.add(digest)
            self._completed.add(self._renders[digest])
        return self._renders[digest]

    def _note_render(self, future: Any) -> None:
        """Remember why there is no sequence, so that it is not tried again for every point."""
        digest, reason = future.key.removeprefix(self._sequence_key), ""
        self._rendering.discard(digest)
        if future.status == "finished":
            # points in flight have the same from their worker
            with suppress(CommClosedError, CancelledError, TimeoutError):
                reason = future.result().reason
        elif future.status == "error" and isinstance(error := future.exception(), KilledWorker):
            reason = _reason_of_kills(error)
        if reason:
            self._unsimulated[digest] = reason

    def _status(self, future: Any, point: Point, digest: str) -> str:
        """The status of a point that a worker has stored, or that no worker could compute."""
        if future.status == "finished":
            # read, not asked for: the worker may be gone, and another would compute the point again
            return self._appeared(point.address)
        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            self._store.write(failed_record(point.address, point.values, _reason_of_kills(error), digest))
            return FAILED
        if isinstance(error, OtherCode):
            raise RunFailure(f"{error}; was it changed meanwhile? {_KEPT.capitalize()}") from None
        if isinstance(error, RunFailure | InputError | OSError):
            raise RunFailure(f"{one_line(str(error))}; {_KEPT}") from None
        if error is not None:
            raise error
        raise RunFailure(f"the scheduler was lost; {_KEPT}")

    def _appeared(self, address: str) -> str:
        """The status of a record that a worker has written: network file systems may show it 90 s later."""
        deadline = monotonic() + 90.0
        while (record := self._store.read(address)) is None:
            if monotonic() > deadline:
                raise RunFailure(f"{self._store.record_file(address)} does not appear here; {_KEPT}")
            sleep(0.5)
        return str(record["status"])

    def _release(self, digest: str) -> None:
        self._waiting[digest] -= 1
        if not self._waiting[digest]:
            del self._waiting[digest]
            self._renders.pop(digest, None)
            self._rendering.discard(digest)
        if self._removes:
            self._left[digest] -= 1
            if not self._left[digest]:
                self._store.remove_sequence(digest)


def _reason_of_kills(error: Any) -> str:
    """The reason of a point whose workers were killed."""
    what = "simulating its sequence" if str(error.task).startswith(_SEQUENCE) else "computing it"
    return f"{error.allowed_failures + 1} workers ended while {what}, perhaps for lack of memory"
