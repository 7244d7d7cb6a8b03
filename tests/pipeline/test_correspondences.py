"""Where many matches contradict the motion, or what stands still hides it, other motions take their place."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.config.frontend_settings import Frontend, PairMatching
from polhode.frontend.matching.methods import Matches
from polhode.frontend.matching.pairs import PairMatch
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.pipeline import correspondences
from polhode.pipeline.correspondences import _agreeing_with_motion, _of_the_body

FRAMES = 40
LEARNED = Frontend(pairs=PairMatching(method="polhode"))


def spinning() -> Array:
    """X_RG (F, 4, 4) of a body that turns by 21 degrees from frame to frame."""
    turn = exp_so3(np.outer(np.deg2rad(21.0) * np.arange(FRAMES), [0.0, 1.0, 0.0]))
    return make_pose(turn, np.tile([0.0, 0.0, 1.0], (FRAMES, 1)))


def at_rest(i: int, j: int) -> PairMatch:
    return PairMatch(i, j, np.eye(4), np.zeros((90, 2), dtype=np.int64))


def of_body(i: int, j: int, inliers: int = 25) -> PairMatch:
    X_RG = spinning()
    return PairMatch(i, j, X_RG[i] @ inverse_pose(X_RG[j]), np.ones((inliers, 2), dtype=np.int64))


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Of a camera at rest; matching again gives both motions of near frames and of a revolution."""

    def several(*_: Any) -> list[PairMatch]:
        found = []
        for i in range(FRAMES):
            for j in range(i + 1, FRAMES):
                found.append(at_rest(i, j))
                steps = min((j - i) % 17, -(j - i) % 17)
                if steps <= 1:
                    found.append(of_body(i, j, 300 if j - i > 3 else 25))
        return found

    monkeypatch.setattr(correspondences, "_match", several)
    return SimpleNamespace(time_s=0.5 * np.arange(float(FRAMES)), X_NR=np.tile(np.eye(4), (FRAMES, 1, 1)))


def test_a_known_motion_selects_among_the_motions_of_two_frames(context: Any) -> None:
    first = [at_rest(0, 1), of_body(0, 1)]
    wrong = [at_rest(k, k + 1) for k in range(FRAMES - 1)]
    kept, matches = _agreeing_with_motion(context, [], [], wrong, LEARNED, first, spinning())
    assert kept == first[1:]
    assert {(m.i, m.j) for m in matches} >= {(k, k + 1) for k in range(FRAMES - 1)}
    for match in matches:
        np.testing.assert_allclose(match.X_RiRj[:3, :3], of_body(match.i, match.j).X_RiRj[:3, :3], atol=1e-9)


def test_matches_that_agree_or_are_missing_stay(context: Any) -> None:
    right = [of_body(k, k + 1) for k in range(FRAMES - 1)]
    assert _agreeing_with_motion(context, [], [], right, LEARNED, [], spinning()) == ([], right)
    assert _agreeing_with_motion(context, [], [], [], LEARNED, [], spinning()) == ([], [])


@pytest.mark.parametrize("frontend", [LEARNED, Frontend()], ids=["learned", "rootsift"])
def test_what_returns_after_a_revolution_decides_without_a_known_motion(
    context: Any, frontend: Frontend, monkeypatch: pytest.MonkeyPatch
) -> None:
    still = [at_rest(i, j) for i in range(FRAMES) for j in range(i + 1, FRAMES)]
    first = [at_rest(0, 1)]
    kept, matches = _of_the_body(context, [], [], still, frontend, first)
    assert not kept and len(matches) > FRAMES
    for match in matches:
        np.testing.assert_allclose(match.X_RiRj[:3, :3], of_body(match.i, match.j).X_RiRj[:3, :3], atol=1e-9)
    one = frontend.model_copy(update={"pairs": frontend.pairs.model_copy(update={"motions": 1})})
    assert _of_the_body(context, [], [], still, one, first) == (first, still)
    # a method that knows one motion of two frames
    monkeypatch.setattr(correspondences, "match_method", lambda _: lambda _a, _b: Matches.none())
    assert _of_the_body(context, [], [], still, frontend, first) == (first, still)
