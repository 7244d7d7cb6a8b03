"""Pairs pushed one at a time: a state for each, which later pairs cannot change."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import polhode
from polhode.config import Config
from polhode.pipeline.live.session import Session
from polhode.pipeline.stream.live_state import LiveState
from polhode.records.dataset import StereoImages, StereoSequence, open_sequence
from polhode.records.estimate import OnlineEstimate
from polhode.run_directory.archives import read_online
from polhode.run_directory.summary import read_summary
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import WITHOUT_NETWORKS

CONFIG = Config.model_validate(WITHOUT_NETWORKS)
FIRST = 8


@pytest.fixture(scope="module")
def sequence(rendered_sequence: Path) -> StereoSequence:
    return open_sequence(rendered_sequence)


@pytest.fixture(scope="module")
def pairs(sequence: StereoSequence) -> list[StereoImages]:
    return [sequence.read_pair(k) for k in range(len(sequence))]


@pytest.fixture
def session(sequence: StereoSequence) -> Iterator[Session]:
    with Session(CONFIG, sequence.calibration) as session:
        yield session


def push(session: Session, pairs: list[StereoImages], times: list[float]) -> list[LiveState | None]:
    return [session.push(pair.left, pair.right, time) for pair, time in zip(pairs, times, strict=True)]


def times(count: int) -> list[float]:
    return [0.5 * k for k in range(count)]


@pytest.fixture(scope="module")
def whole(
    sequence: StereoSequence, pairs: list[StereoImages], tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[LiveState], Path, tuple[str, ...]]:
    """States of all pairs, the run that follows, and what was odd."""
    folder = tmp_path_factory.mktemp("live") / "run"
    with Session(CONFIG, sequence.calibration) as session:
        states = push(session, pairs, times(len(pairs)))
        session.finish(folder)
        warnings = session.warnings
    return [state for state in states if state is not None], folder, warnings


def test_a_state_does_not_depend_on_later_pairs(
    whole: tuple[list[LiveState], Path, tuple[str, ...]], session: Session, pairs: list[StereoImages]
) -> None:
    states = whole[0]
    # other images follow, at other times: the states before must have the same bits
    early = push(session, pairs[:FIRST], times(FIRST))
    swapped = [pairs[0], pairs[FIRST + 2], pairs[3]]
    push(session, swapped, [0.5 * FIRST + 0.3, 0.5 * FIRST + 0.4, 0.5 * FIRST + 2.0])
    for state, again in zip(states, early, strict=False):
        assert again is not None
        for each in fields(LiveState):
            if each.name != "seconds":
                np.testing.assert_array_equal(getattr(state, each.name), getattr(again, each.name))


def test_the_states_follow_the_motion(whole: tuple[list[LiveState], Path, tuple[str, ...]]) -> None:
    states, run_folder, warnings = whole
    assert not warnings
    assert states[0].status == "searching" and not np.isfinite(np.diagonal(states[0].covariance)).any()
    assert {state.status for state in states[len(states) // 2 :]} == {"measured"}
    final = read_trajectory(run_folder / "trajectory.csv")
    rates = np.linalg.norm(final.w_P, axis=1)
    assert abs(np.linalg.norm(states[-1].w_P) - rates[-1]) < 5.0 * states[-1].sigma_rate + 0.01
    assert states[-1].sigma_rate < states[2].sigma_rate
    # along which the centre of mass is not determined yet, the sigma says so
    apart, sigma = states[-1].r_N - final.r_N[-1], np.sqrt(np.diagonal(states[-1].covariance)[:3])
    known = np.isfinite(sigma)
    assert known.any() and (np.abs(apart) < 4.0 * sigma).all() and np.linalg.norm(apart[known]) < 0.01


def test_the_run_has_the_record_of_the_stream(whole: tuple[list[LiveState], Path, tuple[str, ...]]) -> None:
    states, run_folder, _ = whole
    online = read_online(run_folder / "online.npz")
    assert isinstance(online, OnlineEstimate) and len(online.timestamps_ns) == len(states)
    # alignment with the final frame changes conventions only
    np.testing.assert_array_equal(online.r_N, [state.r_N for state in states])
    np.testing.assert_array_equal(online.k, [state.k for state in states])
    assert read_summary(run_folder).status in ("ok", "degraded")
    assert (run_folder / "report.html").is_file()


def test_late_repeated_and_frozen_pairs_are_bridged_and_named(
    session: Session, pairs: list[StereoImages]
) -> None:
    order = [0, 1, 2, 3, 2, 3, 3, 5]
    at = [0.0, 0.5, 1.0, 1.5, 1.0, 1.5, 2.0, 3.5]
    states = push(session, [pairs[k] for k in order], at)
    assert [state is None for state in states] == [False] * 4 + [True, True, False, False]
    frozen = states[6]
    assert frozen is not None and frozen.status == "predicted" and frozen.observations == 0
    told = " ".join(session.warnings)
    for sentence in ("earlier than the pair before", "the time of the pair before", "bit for bit", "missing"):
        assert sentence in told
    assert len(session) == 6


def test_wrong_pairs_are_refused_in_one_line(
    session: Session, pairs: list[StereoImages], tmp_path: Path
) -> None:
    left, right = pairs[0].left, pairs[0].right
    with pytest.raises(InputError, match=r"left image: uint8 of shape \(10, 10\); give uint8 or uint16"):
        session.push(left[:10, :10], right, 0.0)
    with pytest.raises(InputError, match="right image: float64"):
        session.push(left, right.astype(float), 0.0)
    with pytest.raises(InputError, match="time nan: give seconds"):
        session.push(left, right, float("nan"))
    with pytest.raises(InputError, match=r"mask of the left image: give booleans of shape \(256, 320\)"):
        session.push(left, right, 0.0, masks=(left, None))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="X_NB: give a finite pose"):
        session.push(left, right, 0.0, X_NB=np.full((4, 4), np.nan))
    session.push(left, right, 0.0)
    with pytest.raises(InputError, match="with every pair, or with none"):
        session.push(left, right, 1.0, X_NB=np.eye(4))
    with pytest.raises(InputError, match="1 pairs have come; at least 3 are needed"):
        session.finish(tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_package_offers_it_by_name() -> None:
    assert polhode.Session is Session
    with pytest.raises(AttributeError, match="no attribute 'Sessions'"):
        _ = polhode.Sessions
