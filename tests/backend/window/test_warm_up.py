"""The window is compiled before the first frame."""

import pytest

from polhode.backend.window import FrameMeasurements, OnlineState, SlidingWindow
from polhode.backend.window.warm_up import FRAMES, warm_up
from polhode.camera import RectifiedRig
from polhode.config.backend_settings import Backend

RIG = RectifiedRig(400.0, 160.0, 128.0, 0.1, 320, 256)


def test_a_window_follows_the_body_that_it_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    added = []
    add = SlidingWindow.add

    def noted(window: SlidingWindow, measurements: FrameMeasurements) -> OnlineState:
        state = add(window, measurements)
        added.append((state, window.accepted, window.restarts, window.sigma_rate))
        return state

    monkeypatch.setattr(SlidingWindow, "add", noted)
    warm_up(RIG, Backend())
    # 17 degrees in half a second
    state, accepted, restarts, sigma = added[-1]
    assert len(added) == FRAMES and accepted > 30 and restarts == 0
    rate = float((state.w_P @ state.w_P) ** 0.5)
    assert 0.5 < rate < 0.7 and sigma < 0.05
