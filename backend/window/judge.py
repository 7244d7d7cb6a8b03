"""Each new frame judged: it continues the motion, its stamp is wrong, or something else has happened.

A frame that contradicts the motion is explained by one length of its step, then the clock may have jumped; or
by several, as whole revolutions look alike; or by none, then a force, a torque or a wrong measurement moved
it. A torque along the axis of rotation looks like a jump in one frame, but changes the rate, so that the next
frame contradicts the motion again: until then the jump is a guess, and nothing is claimed of that state. The
step of a doubtful stamp keeps no information about its length, that of a push none about the disturbance
within it: what follows is judged by the images before and after.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from polhode.backend.problem.iterate import N_POSE
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.frame import Frame
from polhode.backend.window.innovation import NewPose, StepFit, new_pose
from polhode.geometry.lie import Array

AGREES, DOUBTED, USUAL = (float(chdtri(N_POSE, p)) for p in (1e-6, 1e-3, 0.5))
"""Squared innovations from which a frame contradicts the motion, and its step is left free; the median, from
which it is left free too after one that was."""
FITS = float(chdtri(N_POSE - 1, 1e-6))
"""Largest squared innovation at the length of the step that fits best."""
LARGEST_PUSH_RAD = 0.5
"""Turn that a push may cause within a step: after a larger one the rate is not known to first order."""
DOUBTED_SIGMAS, FREE = 3.0, 10.0
"""From so many sigmas by which a stamp is off, the length of a step is left free: with so many times what the
images leave."""
LEVEL_FRAMES = 24
"""Frames whose innovations say how much larger than stated they are on this target."""


@dataclass(frozen=True)
class Judgement:
    """Whether a frame continues the motion, and what was found about it in words."""

    consistent: bool
    reason: str = ""


@dataclass(frozen=True)
class Guess:
    """A jump of the clock that explains a frame, for the next one to confirm."""

    frame: Frame
    longer_s: float
    words: str
    if_pushed: Array
    """(3,) ``Frame.doubts`` of a push"""


@dataclass
class Judge:
    """The innovations of the frames so far, and what they say about the clock."""

    offset_s: float = 0.0
    """What is added to the stamps from now on"""
    _guess: Guess | None = None
    _agreed: "deque[StepFit]" = field(default_factory=lambda: deque(maxlen=LEVEL_FRAMES))

    @property
    def level(self) -> float:
        """Factor on the covariance of innovations, at least 1: above it where errors depend on each other."""
        squared = [fit.squared for fit in self._agreed]
        return max(1.0, float(np.median(squared)) / USUAL) if len(squared) > N_POSE else 1.0

    def judge(self, state: EstimatorState, contradicts: bool) -> Judgement:
        """The newest frame, whose step is not yet part of the window; may change its time and its step.

        contradicts: whether it is known that nothing of it agrees with the map. Raises LinAlgError.
        """
        before, frame = state.active.recent[-2:]
        pose, guess, limit = new_pose(state), self._guess, AGREES * self.level
        if pose is None:
            return Judgement(not contradicts, "it contradicts the map" if contradicts else "")
        self._guess, length_s = None, frame.time_s - before.time_s
        fit = pose.fits(np.array([length_s]))[0]
        said = f"it contradicts the motion by {np.sqrt(fit.squared / self.level):.1f} sigma"
        if fit.squared <= limit:
            self._agreed.append(fit)
            if abs(fit.longer_s) > DOUBTED_SIGMAS * fit.sigma_s * np.sqrt(self.level):
                # too little to tell what it is, enough to pull the rate
                frame.doubts[0] = FREE * fit.sigma_s
            elif fit.squared > (DOUBTED if not before.doubts[1] else 2.0 * USUAL) * self.level:
                frame.doubts = doubts_of_push(fit)
            if before.doubts[2] * length_s > LARGEST_PUSH_RAD:
                return Judgement(False, "the rate is not known again yet")
            return Judgement(True, "" if guess is None else f"since the pair before {guess.words}")
        if guess is None:
            return self._explained(pose, frame, fit, said)
        alone_s = length_s - guess.longer_s
        if alone_s > 0.0 and pose.fits(np.array([alone_s]))[0].squared <= limit:
            self._move(-guess.longer_s, frame)
            return Judgement(True, f"at the pair before alone {guess.words}")
        # the motion has changed since then: it was no jump
        self._move(-guess.longer_s, guess.frame, frame)
        guess.frame.doubts = guess.if_pushed
        state.renew_step()
        again = new_pose(state)
        fit = fit if again is None else again.fits(np.array([length_s]))[0]
        if fit.squared > limit:
            frame.doubts = doubts_of_push(fit)
        return Judgement(False, f"{said}, as the pair before: a force, a torque or a wrong measurement")

    def _explained(self, pose: NewPose, frame: Frame, fit: StepFit, said: str) -> Judgement:
        """Take the jump that explains the frame, the one nearest to the usual length if there are several."""
        found = [
            each
            for each in pose.best(fit.length_s)
            if each.squared - (each.longer_s / each.sigma_s) ** 2 <= FITS * self.level
        ]
        if not found:
            frame.doubts = doubts_of_push(fit)
            return Judgement(False, f"{said} at any time: a force, a torque or a wrong measurement")
        usual_s = np.median([each.length_s for each in self._agreed or [fit]])
        found.sort(key=lambda each: abs(each.length_s - usual_s))
        longer_s = found[0].length_s - fit.length_s
        words = " or ".join(f"{fit.length_s - each.length_s:+.3f} s" for each in found)
        done = "their step is left open, as revolutions look alike" if len(found) > 1 else "re-timed"
        words = f"the stamps are off by {words}: {done}"
        self._guess = Guess(frame, longer_s, words, doubts_of_push(fit))
        self._move(longer_s, frame)
        frame.doubts[0] = max(FREE * found[0].sigma_s, np.ptp([each.length_s for each in found]))
        return Judgement(False, f"{said}, unless {words}; the next pair decides")

    def _move(self, by_s: float, *frames: Frame) -> None:
        self.offset_s += by_s
        for frame in frames:
            frame.time_s += by_s


def doubts_of_push(fit: StepFit) -> Array:
    """(3,) ``Frame.doubts`` that leave free what has happened within a step."""
    return np.append(0.0, np.sqrt(3.0) * fit.off / fit.length_s)
