"""The sliding window: frames in, one by one, and the causal estimate at each frame out, in bounded time.

- ``estimator``: the sliding window, frame by frame and over a whole sequence.
- ``frame``: frames and landmarks as the window keeps them; the observations, condensed to the poses.
- ``add_frame``: pose and landmarks of a new frame.
- ``solve``: the solves of one frame's update; the choice among several inertias; noise levels.
- ``estimator_state``: frames, landmarks, constants and noise levels; key frames are chosen, others leave.
- ``innovation``: whether a new frame continues the motion; ``judge``: what it means if not, clock or push.
- ``frame_of_reference``: which frame G it is, and where in the one before.
- ``causal_state``: the state that is reported, with its covariance.
- ``history``: the unknowns, the arrival cost about them, and the first frames as a whole.
- ``problem``: the nonlinear program of one update, its quadratic parts, Gauss-Newton and IPOPT on it.
"""

from polhode.backend.window.causal_state import BodyState, OnlineState
from polhode.backend.window.estimator import (
    SlidingWindow,
    align_online_estimate,
    body_estimate,
    estimate_online,
    online_estimate,
    stack_states,
    warm_up,
    window_warnings,
    without_claims_after_torques,
)
from polhode.backend.window.frame import CameraNoise, FrameMeasurements, camera_noise_of, frames_of

__all__ = [
    "BodyState",
    "CameraNoise",
    "FrameMeasurements",
    "OnlineState",
    "SlidingWindow",
    "align_online_estimate",
    "body_estimate",
    "camera_noise_of",
    "estimate_online",
    "frames_of",
    "online_estimate",
    "stack_states",
    "warm_up",
    "window_warnings",
    "without_claims_after_torques",
]
