"""The stages of one pair after the other: features, links with earlier frames, landmarks, window.

``extract`` needs nothing of other pairs, so that the next ones may be extracted meanwhile; ``add`` takes
them in order. The batch uses the same stages: ``extract_pair``, ``match_pair`` and the window's frames. What
differs is the association, which here depends on this pair and earlier ones only.
"""

import logging
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from time import perf_counter
from typing import Any, Literal

import numpy as np

from polhode.backend.window import (
    BodyState,
    SlidingWindow,
    body_estimate,
    online_estimate,
    stack_states,
    without_claims_after_torques,
)
from polhode.backend.window.causal_state import OnlineState
from polhode.backend.window.frame import CameraNoise, FrameMeasurements
from polhode.backend.window.frame_of_reference import FrameOfReference
from polhode.config import Config
from polhode.frontend.calibration_effects import calibration_effects
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import patch_half_m
from polhode.frontend.matching.frame_choice import (
    MOST_IN_VIEW,
    earlier_frames,
    frames_to_let_go,
    viewing_direction_G,
)
from polhode.frontend.matching.methods import match_method
from polhode.frontend.matching.pairs import PairMatch, match_pair
from polhode.frontend.rectification import make_rectifier, rectified_images
from polhode.frontend.segmentation import has_surroundings
from polhode.frontend.tracks.causal_tracks import CausalTracks
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.pipeline.stream.work_ahead import Ahead, ComingPair
from polhode.pipeline.stream_results import Observations, Streamed, observations_of
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.dataset import StereoImages
from polhode.records.estimate import OnlineEstimate
from polhode.records.rig_calibration import StereoCalibration
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import Wrench
from polhode.run_directory.live_states import LiveRow
from polhode.runtime.processes import worker_count

_log = logging.getLogger(__name__)
UNKNOWN = np.full(3, np.nan)
Status = Literal["searching", "predicted", "measured", "uncertain"]
REASONS: dict[Status, str] = {
    "searching": "no motion is known yet",
    "predicted": "nothing of the pair agrees with the motion: the dynamics bridge it",
}
SHOWN_REASONS = 10
"""Of pairs, among the warnings of a run."""
RPM = 30.0 / np.pi


@dataclass(frozen=True, kw_only=True)
class LiveState(OnlineState):
    """The state after a pair, from this pair and earlier ones; variances are inf where undetermined.

    G is the frame of the stream: it begins again, as ``restarts`` counts, when the motion was lost. N and the
    choice among the half-turns of P stay.
    """

    number: int
    """Of the pair, counted from 0"""
    status: Status
    """searching: no motion is known yet; predicted: the pair shows nothing that agrees, the dynamics bridge
    it; uncertain: the pair contradicts the motion; measured"""
    consistent: bool
    """Whether the pair continues the motion, within the covariance of what it differs by"""
    reason: str
    """Why not, or what was done about the time of the pair; empty: there is nothing to say"""
    frame_of_reference: FrameOfReference | None
    """Which frame G it is, and its pose in the one before; None: there is none yet"""
    observations: int
    """Of this pair, that agree with the motion"""
    restarts: int
    sigma_rate: float
    """Standard deviation of the size of w [rad/s], which is known long before the axes are; inf: unknown"""
    seconds: Mapping[str, float]
    """Time of each stage: features, matching, window"""

    @property
    def rate_rpm(self) -> float:
        """Rate of rotation."""
        return float(np.linalg.norm(self.w_P)) * RPM

    @property
    def sigma_rate_rpm(self) -> float:
        """Its standard deviation; inf: unknown."""
        return self.sigma_rate * RPM


@dataclass(frozen=True)
class CameraMotion:
    """How well the inspector's poses are known, and what is known to act on the target."""

    sigma_p_m: float = 0.0
    sigma_theta_rad: float = 0.0
    wrench: Wrench | None = None
    stated: bool | None = None
    """Whether there are poses of the inspector; None: if the first one is not that of a camera at rest"""
    has_ranges: bool = False
    """Whether ranges take the place of a right camera"""


@dataclass(frozen=True)
class Extracted:
    """The features of one pair."""

    features: StereoFeatures
    images: StereoImages | None
    """None: nothing is to be made ahead of the batch"""
    seconds: float


@dataclass(frozen=True)
class Observed:
    """The features of a pair in its rectified left image, n of them."""

    uv_px: Array
    """(n, 2)"""
    landmark: Ints
    """(n,)"""
    agrees: Bools
    """(n,) with the motion"""


@dataclass
class _Past:
    """What is kept of the frames so far."""

    timestamps_ns: list[int] = field(default_factory=list)
    features: dict[int, StereoFeatures] = field(default_factory=dict)
    """By frame, in the order of time: of all frames, of a long stream those of its key frames"""
    observations: dict[int, Observations] = field(default_factory=dict)
    """By frame: of the frames that are no key frames"""
    tried: dict[tuple[int, int], PairMatch | None] = field(default_factory=dict)
    views_G: list[Array] = field(default_factory=list)
    states: list[OnlineState] = field(default_factory=list)
    live: list[LiveRow] = field(default_factory=list)
    first_known: tuple[OnlineState, Array] | None = None
    """The first state of which something is determined, and X_NR there"""
    before: tuple[OnlineState, Array] | None = None
    """The latest state, and X_NR there"""
    first_X_NR: Array | None = None
    known: tuple[list[OnlineState], Array] | None = None
    """The latest state as the window gave it, those before that it is held against, and X_NR of all"""


class Stream:
    """Features, landmarks and window of the pairs that have come."""

    def __init__(
        self, config: Config, calibration: StereoCalibration, camera: CameraMotion | None = None
    ) -> None:
        """Raises InputError: the calibration gives no common field of view, or weights are missing."""
        self.rectifier = make_rectifier(calibration)
        self._camera = camera or CameraMotion()
        self._X_CR = self.rectifier.X_CR
        self._calibration = calibration
        self._frontend = config.frontend
        feature_method(self._frontend), match_method(self._frontend)
        X_BR = calibration.X_BC0 @ self._X_CR
        noise = CameraNoise(self._camera.sigma_p_m, self._camera.sigma_theta_rad, X_BR)
        self._window = SlidingWindow(self.rectifier.rig, config.backend, noise)
        self._tracks = CausalTracks()
        self._past = _Past()
        self._config = config
        self._ahead: Ahead | None = None
        self.latest = Observed(np.zeros((0, 2)), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_))
        """What the latest pair observes"""

    def __len__(self) -> int:
        return len(self._past.timestamps_ns)

    def prepare(self, images: StereoImages) -> None:
        """Take from the first pair what the batch takes from all: dim surroundings, size of patches."""
        if images.mask_left is None:
            left = self.rectifier(images.left, 0)
            surroundings = has_surroundings([left], self.rectifier.borders[0])
            self.rectifier = replace(self.rectifier, surroundings=surroundings)
        features = self._frontend.features
        if features.method == "polhode" and features.patch_half_m is None:
            found = self.extract(images).features
            if len(found):
                half_m = patch_half_m(float(np.median(found.p_R[:, 2])), self.rectifier.rig)
                sized = features.model_copy(update={"patch_half_m": half_m})
                self._frontend = self._frontend.model_copy(update={"features": sized})

    def extract(self, images: StereoImages) -> Extracted:
        """Rectify, mask and extract; independent of every other pair."""
        begin = perf_counter()
        pair = rectified_images(images, self.rectifier)
        features = extract_pair(pair, self.rectifier.rig, self._frontend)
        return Extracted(features, images, perf_counter() - begin)

    def add(self, timestamp_ns: int, X_NC: Array, extracted: Extracted) -> LiveState:
        """Match, associate and estimate; the pair is later than all before. X_NC (4, 4): left camera."""
        begin = perf_counter()
        past, k, X_NR = self._past, len(self), X_NC @ self._X_CR
        past.timestamps_ns.append(timestamp_ns)
        past.features[k] = extracted.features
        matches = self._match_earlier(timestamp_ns, X_NR)
        landmark = self._tracks.add(len(extracted.features), matches)
        matched = perf_counter()
        state = self._estimate(timestamp_ns, X_NR, extracted.features, landmark)
        past.states.append(state)
        agrees = np.isin(landmark, self._window.accepted_landmarks)
        self.latest = Observed(extracted.features.uvd_px[:, :2], landmark, agrees)
        if self.is_long:
            self._let_go()
        done = perf_counter()
        seconds = {"features": extracted.seconds, "matching": matched - begin, "window": done - matched}
        window = self._window
        self._work_ahead(k, extracted, X_NR, state)
        known, judged = bool(np.isfinite(np.diagonal(state.covariance)).any()), window.judgement
        seen: Status = "measured" if judged.consistent else "uncertain"
        status: Status = "searching" if not known else seen if window.accepted else "predicted"
        reason = judged.reason or ("" if status == "measured" else REASONS[status])
        row = LiveRow(
            *(timestamp_ns, status, reason, "" if window.frame is None else window.frame.name),
            int(known and judged.consistent),
        )
        past.live.append(row)
        return LiveState(
            **{each.name: getattr(state, each.name) for each in fields(OnlineState)},
            number=k,
            status=status,
            consistent=bool(row.consistent),
            reason=reason,
            frame_of_reference=window.frame,
            observations=window.accepted,
            restarts=window.restarts,
            sigma_rate=window.sigma_rate,
            seconds=seconds,
        )

    def _work_ahead(self, k: int, extracted: Extracted, X_NR: Array, state: OnlineState) -> None:
        """Pass the pair on to the process that does what the batch will want."""
        if extracted.images is None or worker_count(self._config.runtime.workers) == 1:
            return
        if self._ahead is None:
            self._ahead = Ahead(self.rectifier, self._config.model_copy(update={"frontend": self._frontend}))
        images, tried = extracted.images, [i for i, j in self._past.tried if j == k]
        measured = images.mask_left is None or bool(images.mask_left.any())
        X_RG = inverse_pose(X_NR) @ state.X_NG if self._window.accepted else None
        seen, restarts = images if measured else None, self._window.restarts
        self._ahead.add(ComingPair(k, seen, extracted.features, tried, X_RG, restarts))

    def surface(self) -> SurfaceModel | None:
        """The surface that the pairs so far have shown, in the present frame G; None: with one process only,
        the surface is made at the end."""
        return None if self._ahead is None else self._ahead.surface()

    def body_state(self) -> BodyState | None:
        """The body itself at the latest pair, in the present frame G; None: no motion is known."""
        known, body = self._past.known, self._window.body_state()
        if known is None or body is None or not np.isfinite(np.diagonal(known[0][-1].covariance)).any():
            return None
        rows, X_NR = known
        return body_estimate(body, rows, self.rectifier.rig, X_NR, self._config.backend, self._effects)

    def request_surface(self) -> "Future[Any] | None":
        """The same, a ``SurfaceModel``, as soon as it is made; None: it will not be."""
        return None if self._ahead is None else self._ahead.request_surface()

    @property
    def landmarks_G(self) -> Array:
        """(L, 3) landmarks of the present window, in the present frame G [m]."""
        return self._window.landmarks_G

    def close(self) -> None:
        """Stop what works ahead, and remove what it has stored."""
        if self._ahead is not None:
            self._ahead.remove()

    def _match_earlier(self, timestamp_ns: int, X_NR: Array) -> list[PairMatch]:
        k, X_NG, past = len(self) - 1, self._window.predict(timestamp_ns), self._past
        predicted = None if X_NG is None else viewing_direction_G(X_NR, X_NG)
        matches = list[PairMatch]()
        frames = earlier_frames(np.array(past.views_G).reshape(k, 3), predicted).tolist()
        # where nothing matches, the prediction may be wrong, as after a jump of the clock: other sides follow
        others = range(0, k, 1 + k // MOST_IN_VIEW) if len(past.features[k]) else ()
        for n, i in enumerate([*frames, *(i for i in others if i in past.features and i not in frames)]):
            if n >= len(frames) and matches:
                break
            match = match_pair(past.features, i, k, self.rectifier.rig, self._frontend, self._config.seed)
            if not self.is_long:
                past.tried[i, k] = match
            if match is not None:
                matches.append(match)
        return matches

    def _estimate(
        self, timestamp_ns: int, X_NR: Array, features: StereoFeatures, landmark: Ints
    ) -> OnlineState:
        window, past, restarts = self._window, self._past, self._window.restarts
        state = window.add(
            FrameMeasurements(timestamp_ns, X_NR, landmark, features.uvd_px, features.sigma_px)
        )
        if window.restarts > restarts:
            # The views of the frames so far are in a frame G that is gone.
            past.views_G = [UNKNOWN] * len(past.views_G)
        past.views_G.append(viewing_direction_G(X_NR, state.X_NG) if window.accepted else UNKNOWN)
        return self._with_systematic(state, X_NR)

    def _with_systematic(self, state: OnlineState, X_NR: Array) -> OnlineState:
        """The state with the errors that all landmarks share in its covariances, as the batch reports it."""
        past = self._past
        past.first_X_NR = X_NR if past.first_X_NR is None else past.first_X_NR
        if past.first_known is None and np.isfinite(np.diagonal(state.covariance)).any():
            past.first_known = state, X_NR
        earlier = [row for row in (past.first_known, past.before) if row is not None]
        past.before = state, X_NR
        rows, X = [*(row[0] for row in earlier), state], [*(row[1] for row in earlier), X_NR]
        past.known = rows, np.stack(X)
        online = online_estimate(rows, self.rectifier.rig, np.stack(X), self._config.backend, self._effects)
        if self._camera.wrench is not None:
            online = without_claims_after_torques(online, self._camera.wrench)
        names = [each.name for each in fields(OnlineEstimate) if each.name != "timestamps_ns"]
        return replace(state, **{name: getattr(online, name)[-1] for name in names})

    @cached_property
    def _effects(self) -> CalibrationEffects | None:
        stated = self._camera.stated
        if stated is None:
            first = self._past.first_X_NR
            stated = first is not None and not np.array_equal(first, self._X_CR)
        return calibration_effects(self._calibration, self.rectifier, stated, self._camera.has_ranges)

    @property
    def is_long(self) -> bool:
        """Whether so many pairs have come that only key frames keep their features."""
        return len(self) > self._config.key_frames.above

    @property
    def n_with_features(self) -> int:
        """Number of frames whose features are kept: of a long stream, those of the key frames."""
        return len(self._past.features)

    def _let_go(self) -> None:
        """Keep of the frames that others tell the same as what they observe of which landmark."""
        past = self._past
        # the first time; what was tried is not used again, as there are too many pairs to match all
        past.tried.clear()
        kept = np.fromiter(past.features, dtype=np.int64)
        time_s = 1e-9 * (np.array(past.timestamps_ns)[kept] - past.timestamps_ns[0])
        views = np.stack([past.views_G[k] for k in kept])
        for k in kept[frames_to_let_go(views, time_s, self._config.key_frames.number)].tolist():
            landmark = self._tracks.forget(k)
            past.observations[k] = observations_of(past.features.pop(k), landmark)
            past.views_G[k] = UNKNOWN

    def streamed(self, warnings: tuple[str, ...]) -> Streamed:
        """What was found, for the batch. At least one pair has come."""
        past, ahead, n = self._past, self._ahead, len(self)
        told = [
            f"live: {row.timestamp_ns} ns: {row.reason}"
            for row in past.live
            if row.reason and row.status in ("uncertain", "measured")
        ]
        observations = [
            past.observations[k]
            if k in past.observations
            else observations_of(past.features[k], self._tracks.landmark[k])
            for k in range(n if self.is_long else 0)
        ]
        return Streamed(
            np.array(past.timestamps_ns, dtype=np.int64),
            tuple(past.features.values()),
            {**past.tried, **({} if ahead is None else ahead.finish())},
            self.rectifier.surroundings,
            stack_states(past.states),
            (*warnings, *told[:SHOWN_REASONS]),
            np.fromiter(past.features, dtype=np.int64),
            tuple(observations),
            tuple(past.live),
            None if ahead is None else ahead.depth,
        )
