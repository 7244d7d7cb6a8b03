"""Pairs that the caller pushes, and the state after each: the stream as a library."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from polhode.config import Config
from polhode.geometry.lie import Array, Bools
from polhode.pipeline.live.arrivals import Arrivals, require_pairs
from polhode.pipeline.live.live_volumes import live_keep_out
from polhode.pipeline.live.recording import ImageRecording
from polhode.pipeline.run import RunResult, run
from polhode.pipeline.stream.stream import CameraMotion, LiveState, Stream
from polhode.planning.keep_out.measured_body import Cover
from polhode.planning.keep_out.queries import KeepOut
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.records.rig_calibration import StereoCalibration
from polhode.records.surface import SurfaceModel
from polhode.runtime.argument_names import errors_name_arguments
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress, Silent
from polhode.runtime.threads import single_threaded

MAX_TIME_S = 4e9
"""Seconds since 1970, until the year 2096: the difference of two times in ns fits 64 bits."""


class Session:
    """A stream of pairs of one rig: ``push`` each, then ``finish``.

    Use it in a ``with`` block, or call ``close``: the pairs are kept in a temporary folder until then.
    """

    def __init__(
        self,
        config: Config,
        calibration: StereoCalibration,
        sigma_p_m: float = 0.0,
        sigma_theta_rad: float = 0.0,
    ) -> None:
        """calibration: of the rig, e.g. from ``polhode.records.rig_calibration.read_calibration``; the
        sigmas are those of the inspector's poses, if ``push`` gets any.

        Raises InputError: the calibration gives no common field of view, or weights are missing.
        """
        self.config, self.calibration = config, calibration
        self._stream = Stream(config, calibration, CameraMotion(sigma_p_m, sigma_theta_rad))
        self._arrivals = Arrivals(calibration.bits)
        self._recording = ImageRecording(calibration, (sigma_p_m, sigma_theta_rad))
        self._moves: bool | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._stream)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What became of late, missing and repeated pairs so far, one line for each kind."""
        return self._arrivals.warnings

    @property
    def landmarks_G(self) -> Array:
        """(L, 3) the sparse map so far, of the frames that the window keeps, in the present frame G [m]."""
        return self._stream.landmarks_G

    def surface(self) -> SurfaceModel | None:
        """The surface that the pairs so far have shown, in the present frame G: it grows from call to call.

        Another process makes it, at the poses as they were known live; it is empty until a motion is known.
        None: with ``runtime.workers`` 1 it is made at the end only.
        """
        return self._stream.surface()

    @errors_name_arguments({"--horizon": "horizon_s"})
    def keep_out(
        self,
        horizon_s: float = 60.0,
        confidence: float = 0.99,
        members: int | None = None,
        cover: Cover = "auto",
    ) -> KeepOut:
        """The space that the target may sweep from the latest pair on, as ``Run.keep_out``: in N, with times
        after that pair.

        The body is the live surface, and no occupancy is at hand: "possible" and "outlines" are refused, and
        "auto" is the convex hull where the mesh is open. Raises InputError: no motion is known, there is no
        surface yet, or options that do not fit.
        """
        body = self._stream.body_state()
        if body is None:
            raise InputError("no motion is known yet: a keep-out volume needs more pairs")
        surface = self.surface()
        if surface is None:
            raise InputError("there is no live surface: set runtime.workers to 2 or more")
        options = KeepOutOptions(horizon_s, confidence, members=members, cover=cover)
        return live_keep_out(body, surface, options)

    @single_threaded
    def push(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        time: float,
        masks: Sequence[Bools | None] = (None, None),
        X_NB: Array | None = None,
    ) -> LiveState | None:
        """The state after a pair; None: the pair is not used, as it is not later than the one before.

        left, right (H, W): grey, 8 or 16 bits, as recorded; time: of the pair [s], on any clock; masks: of
        the target in the two images (H, W), None: it is brighter than the dark sky; X_NB (4, 4): pose of the
        inspector, None: it is at rest. Raises InputError for wrong sizes, types, times or poses.
        """
        if not np.isfinite(time) or abs(time) > MAX_TIME_S:
            raise InputError(f"time {time:g}: give seconds, finite and at most {MAX_TIME_S:g}")
        timestamp_ns = round(time * 1e9)
        sides = zip(("left", "right"), (left, right), masks, strict=True)
        for camera, (name, image, mask) in enumerate(sides):
            width, height = self.calibration.size_px(camera)
            if image.dtype not in (np.uint8, np.uint16) or image.shape != (height, width):
                raise InputError(
                    f"{name} image: {image.dtype} of shape {image.shape}; give uint8 or uint16 of shape "
                    f"({height}, {width}), as calibrated"
                )
            if mask is not None and (mask.dtype != np.bool_ or mask.shape != (height, width)):
                raise InputError(f"mask of the {name} image: give booleans of shape ({height}, {width})")
        if self._moves is not None and self._moves != (X_NB is not None):
            raise InputError("X_NB: give the inspector's pose with every pair, or with none")
        if X_NB is not None and (np.shape(X_NB) != (4, 4) or not np.isfinite(X_NB).all()):
            raise InputError("X_NB: give a finite pose (4, 4)")
        if not self._arrivals.accepts(timestamp_ns):
            return None
        self._moves = X_NB is not None
        self._recording.add_images(timestamp_ns, (left, right), (masks[0], masks[1]), X_NB)
        images = self._arrivals.images(timestamp_ns, left, right, (masks[0], masks[1]))
        if len(self) == 0:
            self._stream.prepare(images)
        # Without poses, N is the left camera itself.
        X_NC = np.eye(4) if X_NB is None else X_NB @ self.calibration.X_BC0
        return self._stream.add(timestamp_ns, X_NC, self._stream.extract(images))

    @errors_name_arguments({"-o": "run_folder"})
    def finish(
        self, run_folder: Path, progress: Progress | None = None, overwrite: bool = False
    ) -> RunResult:
        """The batch answer of all pairs as a run directory; features and links of the stream are used again.

        Raises InputError: fewer than three pairs have come; RunFailure as ``run``.
        """
        require_pairs(len(self), "the session")
        self._recording.close()
        streamed = self._stream.streamed(self.warnings)
        shown = progress or Silent()
        return run(self.config, self._recording.folder, run_folder, shown, overwrite, streamed=streamed)

    def close(self) -> None:
        """Remove the pairs that were kept."""
        self._stream.close()
        self._recording.remove()
