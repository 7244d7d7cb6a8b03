"""The pairs of a stream in Rerun as their states come.

A thread encodes the images and logs, so that the stream need not wait; where it falls behind, pairs are shown
without their images. What is shown is the causal estimate: a state knows nothing of later pairs.
"""

import logging
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from polhode.frontend.rectification import rectified_images
from polhode.pipeline.live.run_live import Watch, WatchedPair
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import one_line
from polhode.viewer.blueprint import Eyes, arrangement, beside_camera
from polhode.viewer.recorder import Recorder, ShownFeatures, ShownFrame, ShownMotion, ShownRig, known_ratios
from polhode.viewer.target import ViewTarget

SURFACE_EVERY = 20
"""Pairs from one request of the growing surface to the next."""
MAX_FACES = 20_000
"""Of the growing surface."""
MAX_WAITING = 8
"""Pairs that wait to be shown with their images; later ones are shown without."""

_log = logging.getLogger(__name__)


@contextmanager
def watching(target: ViewTarget, name: str) -> Iterator[Watch]:
    """What is called with each pair after its state. When the block ends, but by an interrupt, all are shown.

    name: of the stream. A viewer that cannot show them is no failure of the stream, only a warning.
    """
    viewer = _LiveViewer(target, name)
    try:
        yield viewer
    except BaseException as error:
        # after an error what the stream has shown is kept, as what it has found is
        viewer.close(complete=isinstance(error, Exception))
        raise
    viewer.close()


class _LiveViewer:
    """Passes pairs on to a thread that shows them; what goes wrong there ends the showing with a warning."""

    def __init__(self, target: ViewTarget, name: str) -> None:
        self._target, self._name = target, name
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="polhode-view")
        self._waiting: list[Future[None]] = []
        self._requested: tuple[Future[Any], int] | None = None
        """A surface that another process makes, and the number of frames G before the one that it is in"""
        # of the thread:
        self._recorder: Recorder | None = None
        self._opened = ExitStack()
        self._failed = False
        self._first_ns, self._restarts = 0, 0

    def __call__(self, pair: WatchedPair) -> None:
        """Called by the stream; returns at once."""
        self._waiting = [each for each in self._waiting if not each.done()]
        has_images, surface = len(self._waiting) < MAX_WAITING, self._take_surface(pair.state.restarts)
        if self._requested is None and pair.state.number % SURFACE_EVERY == SURFACE_EVERY - 1:
            future = pair.request_surface()
            self._requested = None if future is None else (future, pair.state.restarts)
        self._waiting.append(self._thread.submit(self._show, pair, surface, has_images))

    def _take_surface(self, restarts: int) -> SurfaceModel | None:
        """The surface that was requested, once it is made, unless it is in a frame G that is gone."""
        if self._requested is None or not self._requested[0].done():
            return None
        (future, before), self._requested = self._requested, None
        failed = future.cancelled() or future.exception() is not None
        found = None if failed or before != restarts else future.result()
        return found if isinstance(found, SurfaceModel) and len(found.mesh.faces) else None

    def close(self, complete: bool = True) -> None:
        """Show what waits, and complete the recording; else give both up."""
        if complete:
            self._thread.submit(self._complete).result()
        self._thread.shutdown(cancel_futures=not complete)

    def _show(self, pair: WatchedPair, surface: SurfaceModel | None, has_images: bool) -> None:
        """Show the next pair, and the surface where another process has made it meanwhile."""
        if self._failed:
            return
        with self._warning_of_failure():
            recorder = self._recorder or self._open(pair)
            time_s = 1e-9 * (pair.state.timestamp_ns - self._first_ns)
            recorder.log_frame(shown_pair(pair, time_s, has_images))
            if pair.state.restarts != self._restarts:
                self._restarts = pair.state.restarts
                recorder.remove_surface()
            if surface is not None:
                recorder.log_surface(surface, MAX_FACES)

    def _complete(self) -> None:
        with self._warning_of_failure():
            self._opened.close()

    def _open(self, pair: WatchedPair) -> Recorder:
        self._first_ns = pair.state.timestamp_ns
        rig = ShownRig.rectified(pair.rectifier.rig)
        eyes = Eyes(beside_camera(pair.X_NR, rig.plane_m))
        blueprint = arrangement(eyes, has_motion=True, landmarks_add_up=False)
        self._recorder = self._opened.enter_context(self._target.opened(self._name, rig, blueprint))
        return self._recorder

    @contextmanager
    def _warning_of_failure(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # noqa: BLE001  the stream goes on, whatever happens to its viewer
            self._failed = True
            _log.warning("the stream is not shown any more: %s", one_line(str(error)))


def shown_pair(pair: WatchedPair, time_s: float, has_images: bool) -> ShownFrame:
    """What is shown of a pair; a motion from when one is known."""
    state, observed, images = pair.state, pair.observed, None
    if has_images and pair.images is not None:
        images = rectified_images(pair.images, pair.rectifier)
    is_known, motion = state.status != "searching", None
    if is_known:
        moments = np.array([np.exp(state.k[0]), 1.0, np.exp(-state.k[1])])
        states = (state.r_N, state.v_N, state.R_NP, state.w_P, state.covariance, state.X_NG)
        motion = ShownMotion(*states, moments)
    return ShownFrame(
        number=state.number,
        time_s=time_s,
        X_NL=pair.X_NR,
        left=None if images is None else images.left,
        right=None if images is None else images.right,
        features=ShownFeatures(observed.uv_px, observed.landmark, observed.agrees),
        motion=motion,
        ratios=known_ratios(state.k, state.cov_k, state.determined[:2]),
        landmarks_G=pair.landmarks_G if is_known else np.zeros((0, 3)),
    )
