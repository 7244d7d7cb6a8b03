"""A source to a run directory, pair by pair: ``polhode run --live``."""

import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from polhode.config import Config
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Array
from polhode.pipeline.live.arrivals import Arrivals, require_pairs
from polhode.pipeline.live.feed import WAIT_S, Arrived, Dropped, Feed
from polhode.pipeline.live.folder_source import FolderSource
from polhode.pipeline.live.recording import FileRecording
from polhode.pipeline.live.warm_up import warm_up_stream
from polhode.pipeline.run import RunResult, fill_run_folder
from polhode.pipeline.stream.stream import Extracted, LiveState, Observed, Stream
from polhode.records.dataset import StereoImages
from polhode.report import write_report
from polhode.run_directory.run_folder import atomic_run_folder
from polhode.runtime.errors import InputError
from polhode.runtime.interrupts import interrupt_noted
from polhode.runtime.processes import worker_count
from polhode.runtime.progress import NOTE, LiveProgress
from polhode.runtime.threads import single_threaded

PATIENCE_S = 10.0
"""A folder that fills has ended when no pair came for so long."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Processed:
    """A state, and how long after its pair's arrival it was there."""

    state: LiveState
    latency_s: float


@dataclass
class LiveReport:
    """What a live run measured besides its result."""

    processed: list[Processed] = field(default_factory=list)
    dropped: int = 0
    report_s: float = 0.0
    """From the arrival of the last pair to the report"""
    report_processor_s: float = 0.0
    """The time of the processor that this process took for it: what it would take on a machine that does
    nothing else, as the other processes work beside it"""
    interrupted: bool = False


@dataclass(frozen=True)
class WatchedPair:
    """A pair whose state is known, for a viewer."""

    state: LiveState
    images: StereoImages | None
    rectifier: Rectifier
    X_NR: Array
    """(4, 4) the rectified left camera"""
    observed: Observed
    landmarks_G: Array
    """(L, 3) those of the window, in the present frame G [m]"""
    request_surface: Callable[[], "Future[Any] | None"]
    """The surface so far, a ``SurfaceModel``, once another process has made it; None: it makes none"""


Watch = Callable[[WatchedPair], None]


@single_threaded
def open_source(folder: Path, rate: float | None = None, patience_s: float = PATIENCE_S) -> FolderSource:
    """The pairs of a folder for ``run_live``.

    rate: speed of the replay of a recorded sequence, 0 as fast as it goes; None: the folder fills, until the
    file mav0/end appears or nothing came for ``patience_s``. Raises InputError: a wrong source or number.
    """
    if rate is not None and not 0.0 <= rate <= 1e4:
        raise InputError(f"--rate {rate:g}: give 1 for the sequence's own speed, 2 for twice, 0 for no pause")
    if not 0.0 < patience_s <= 1e6:
        raise InputError(f"--patience-s {patience_s:g}: give seconds, above 0")
    return FolderSource(folder, rate is None, patience_s)


def run_live(
    config: Config,
    source: FolderSource,
    run_folder: Path,
    progress: LiveProgress,
    rate: float | None = None,
    overwrite: bool = False,
    even_if_failed: bool = False,
    watch: Watch | None = None,
) -> tuple[RunResult, LiveReport]:
    """States of the pairs as they come, then the batch answer of the pairs that came.

    source, rate: as ``open_source`` has them. Ctrl-C ends the stream, not the run. ``watch`` is called with
    each pair after its state, and must not take long. Raises InputError for a wrong source, RunFailure as
    ``run``.
    """
    live, start_s = LiveReport(), perf_counter()
    with atomic_run_folder(run_folder, overwrite, write_report, even_if_failed) as written:
        stream = Stream(config, source.calibration, source.camera_motion())
        with progress.stage("compiling", 1) as advance:
            warm_up_stream(stream.rectifier.rig, config)
            advance()
        _log.log(NOTE, "ready for pairs after %.0f s", perf_counter() - start_s)
        recording = FileRecording(source.folder)
        try:
            loop = _Loop(stream, recording, source, live, watch, Arrivals(source.calibration.bits))
            with interrupt_noted() as interrupted, progress.line() as show:
                last_at = loop.run(rate, worker_count(config.runtime.workers), interrupted, show)
            require_pairs(len(stream), str(source.folder))
            recording.close()
            streamed = stream.streamed(loop.arrivals.warnings)
            finished = fill_run_folder(written, config, recording.folder, progress, streamed)
        finally:
            stream.close()
            recording.remove()
        live.report_s = perf_counter() - last_at
        live.report_processor_s = process_time() - loop.processor_s
        _log.info(
            "live: %.1f s from the last pair to the report, %.1f s of the processor",
            *(live.report_s, live.report_processor_s),
        )
    return finished(written), live


@dataclass
class _Loop:
    """Pairs from the feed through the stages; the features of the next ones are extracted meanwhile."""

    stream: Stream
    recording: FileRecording
    source: FolderSource
    live: LiveReport
    watch: Watch | None
    arrivals: Arrivals
    processor_s: float = 0.0
    """Of this process, when the last pair came"""
    is_prepared: bool = False

    def run(
        self, rate: float | None, workers: int, interrupted: Callable[[], bool], show: Callable[[str], None]
    ) -> float:
        """Process all pairs; returns when the last one came. Raises InputError of the source."""
        started, last_at = deque[tuple[Arrived, Future[Extracted]]](), perf_counter()
        with ThreadPoolExecutor(workers) as pool, Feed(self.source.items, rate) as feed:
            while not (feed.ended and not started):
                if interrupted() and not self.live.interrupted:
                    self.live.interrupted = True
                    feed.stop()
                    show("interrupted: the pairs that have come are finished")
                busy = len(started) >= workers or bool(started and started[0][1].done())
                # features are being extracted while another pair may come
                item = None if busy else feed.next(0.01 if started else WAIT_S)
                if isinstance(item, Arrived):
                    last_at, self.processor_s, pair = item.at, process_time(), item.pair
                    if self.arrivals.accepts(pair.stamps_ns[0]):
                        images = self.arrivals.images(pair.stamps_ns[0], pair.left, pair.right, pair.masks)
                        if not self.is_prepared:
                            self.stream.prepare(images)
                            self.is_prepared = True
                        started.append((item, pool.submit(self.stream.extract, images)))
                elif isinstance(item, Dropped):
                    self.live.dropped += 1
                    self.arrivals.note("dropped", f"{item.timestamp_ns} ns")
                elif item is not None:
                    self.arrivals.note("unusable", item.what)
                elif started and (busy or feed.ended):
                    show(self._finish(*started.popleft()))
        return last_at

    def _finish(self, arrived: Arrived, future: Future[Extracted]) -> str:
        """The state of a pair, and the line that shows it."""
        stream, pair, extracted = self.stream, arrived.pair, future.result()
        X_NC = np.eye(4) if pair.X_NB is None else pair.X_NB @ self.source.calibration.X_BC0
        state = stream.add(pair.stamps_ns[0], X_NC, extracted)
        self.recording.add(pair.stamps_ns, pair.names)
        latency_s = perf_counter() - arrived.at
        self.live.processed.append(Processed(state, latency_s))
        if self.watch is not None:
            seen = X_NC @ stream.rectifier.X_CR, stream.latest, stream.landmarks_G, stream.request_surface
            self.watch(WatchedPair(state, extracted.images, stream.rectifier, *seen))
        return line_of(state, latency_s, self.live.dropped)


def line_of(state: LiveState, latency_s: float, dropped: int) -> str:
    """What the terminal shows of a state."""
    sigma = state.sigma_rate_rpm
    rate = "rate unknown"
    if state.status != "searching":
        spread = f"+- {sigma:.3f} RPM" if np.isfinite(sigma) else "RPM, not determined"
        rate = f"{state.rate_rpm:.2f} {spread}"
    lost = f", {dropped} dropped" if dropped else ""
    return (
        f"frame {state.number}: {state.status}, {state.observations} observations, {rate}, "
        f"latency {latency_s:.2f} s{lost}"
    )
