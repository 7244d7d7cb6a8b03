"""Where many matches contradict the motion, or what stands still hides it, other motions take their place."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.config.frontend_settings import Frontend, PairMatching
from polhode.frontend.matching.methods import Matches
from polhode.frontend.matching.pairs import PairMatch
from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.pipeline import correspondences
from polhode.pipeline.correspondences import _agreeing_with_motion, _of_the_body

FRAMES = 40
PAIRS = [(i, j) for i in range(FRAMES) for j in range(i + 1, FRAMES)]
LEARNED = Frontend(pairs=PairMatching(method="polhode"))
SPINNING = make_pose(
    exp_so3(np.outer(np.deg2rad(21.0) * np.arange(FRAMES), [0.0, 1.0, 0.0])),
    np.tile([0.0, 0.0, 1.0], (FRAMES, 1)),
)
"""X_RG (F, 4, 4) of a body that turns by 21 degrees from frame to frame."""


def at_rest(i: int, j: int) -> PairMatch:
    return PairMatch(i, j, np.eye(4), np.zeros((90, 2), dtype=np.int64))


def of_body(i: int, j: int, inliers: int = 25) -> PairMatch:
    return PairMatch(i, j, SPINNING[i] @ inverse_pose(SPINNING[j]), np.ones((inliers, 2), dtype=np.int64))


def assert_of_the_body(matches: list[PairMatch]) -> None:
    for match in matches:
        np.testing.assert_allclose(match.X_RiRj[:3, :3], of_body(match.i, match.j).X_RiRj[:3, :3], atol=1e-9)


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Of a camera at rest; matching again gives both motions of near frames and of a revolution."""

    def several(*_: Any) -> list[PairMatch]:
        found = []
        for i, j in PAIRS:
            found.append(at_rest(i, j))
            if min((j - i) % 17, -(j - i) % 17) <= 1:
                found.append(of_body(i, j, 300 if j - i > 3 else 25))
        return found

    monkeypatch.setattr(correspondences, "_match", several)
    return SimpleNamespace(time_s=0.5 * np.arange(float(FRAMES)), X_NR=np.tile(np.eye(4), (FRAMES, 1, 1)))


def test_a_known_motion_selects_among_the_motions_of_two_frames(context: Any) -> None:
    first, near = [at_rest(0, 1), of_body(0, 1)], list(pairwise(range(FRAMES)))
    wrong, right = ([kind(i, j) for i, j in near] for kind in (at_rest, of_body))
    kept, matches = _agreeing_with_motion(context, [], [], wrong, LEARNED, first, SPINNING)
    assert kept == first[1:] and {(m.i, m.j) for m in matches} >= set(near)
    assert_of_the_body(matches)
    # matches that agree or are missing stay
    for given in (right, []):
        assert _agreeing_with_motion(context, [], [], given, LEARNED, [], SPINNING) == ([], given)


@pytest.mark.parametrize("frontend", [LEARNED, Frontend()], ids=["learned", "rootsift"])
def test_what_returns_after_a_revolution_decides_without_a_known_motion(
    context: Any, frontend: Frontend, monkeypatch: pytest.MonkeyPatch
) -> None:
    still, first = [at_rest(i, j) for i, j in PAIRS], [at_rest(0, 1)]
    kept, matches = _of_the_body(context, [], [], still, frontend, first)
    assert not kept and len(matches) > FRAMES
    assert_of_the_body(matches)
    one = frontend.model_copy(update={"pairs": frontend.pairs.model_copy(update={"motions": 1})})
    assert _of_the_body(context, [], [], still, one, first) == (first, still)
    # a method that knows one motion of two frames
    monkeypatch.setattr(correspondences, "match_method", lambda _: lambda _a, _b: Matches.none())
    assert _of_the_body(context, [], [], still, frontend, first) == (first, still)
