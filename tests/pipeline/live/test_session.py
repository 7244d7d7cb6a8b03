"""Pairs pushed one at a time: a state for each, which later pairs cannot change; and what is done ahead."""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import polhode
from polhode.config import Config
from polhode.pipeline.live.session import Session
from polhode.pipeline.stream.stream import LiveState
from polhode.planning.keep_out.queries import KeepOut
from polhode.records.dataset import StereoImages, StereoSequence, open_sequence
from polhode.records.surface import SurfaceModel
from polhode.run_directory.archives import read_online
from polhode.run_directory.finished_stages import DEPTH
from polhode.run_directory.summary import read_summary
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.processes import kill_workers
from tests.pipeline.conftest import ONE_METHOD

CONFIG = Config.model_validate(ONE_METHOD)
AHEAD = Config.model_validate({**ONE_METHOD, "runtime": {"workers": 2}})
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


def push(session: Session, pairs: list[StereoImages], times: list[float]) -> list[Any]:
    return [session.push(pair.left, pair.right, time) for pair, time in zip(pairs, times, strict=True)]


@dataclass(frozen=True)
class Finished:
    """A session in which everything was done ahead, and the run that followed."""

    states: list[LiveState]
    folder: Path
    warnings: tuple[str, ...]
    surfaces: list[SurfaceModel]
    """Halfway and at the end"""
    made: tuple[int, int]
    """Depth maps and links that were made ahead"""
    landmarks: int
    volume: KeepOut
    """After the last pair"""
    refused: str
    """Why there was none after the first"""


@pytest.fixture(scope="module")
def whole(
    sequence: StereoSequence, pairs: list[StereoImages], tmp_path_factory: pytest.TempPathFactory
) -> Finished:
    folder = tmp_path_factory.mktemp("live") / "run"
    states, surfaces = list[LiveState](), list[Any]()
    with Session(AHEAD, sequence.calibration) as session:
        for k, pair in enumerate(pairs):
            states += push(session, [pair], [0.5 * k])
            if k == 0:
                with pytest.raises(InputError) as early:
                    session.keep_out()
            if k in (len(pairs) // 2, len(pairs) - 1):
                surfaces.append(session.surface())
        volume = session.keep_out(10.0, members=120)
        landmarks, ahead = len(session.landmarks_G), session._stream._ahead
        assert ahead is not None and ahead.depth.folder is not None
        made = sum(ahead.depth.has(DEPTH, str(k)) for k in range(len(pairs))), len(ahead.finish())
        session.finish(folder)
        assert ahead.depth.folder.is_dir()
    assert not ahead.depth.folder.exists()
    return Finished(states, folder, session.warnings, surfaces, made, landmarks, volume, str(early.value))


def test_a_keep_out_volume_holds_the_body_as_it_is_known_live(whole: Finished) -> None:
    """It contains the surface where the run's own motion has it, now and at the horizon."""
    assert whole.refused == "no motion is known yet: a keep-out volume needs more pairs"
    volume, state = whole.volume, whole.states[-1]
    (estimate,) = volume.estimates
    np.testing.assert_allclose(estimate.last.r_N, state.r_N, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(estimate.last.w_G), np.linalg.norm(state.w_P), rtol=1e-9)
    covariance = estimate.last.covariance
    assert np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance).min() > -1e-12
    known = np.isfinite(np.diagonal(state.covariance)[:6])
    same = np.sqrt(np.diagonal(covariance)[:6] / np.diagonal(state.covariance)[:6])[known]
    np.testing.assert_allclose(same, 1.0, rtol=1e-6)
    run = polhode.load(whole.folder)
    vertices = np.asarray(run.mesh.vertices)
    for time_s in (0.0, 10.0):
        places = run.points_N(vertices, time_s)
        assert volume.contains(places, time_s).mean() > 0.99 and volume.contains(places).mean() > 0.99
    far = state.r_N + np.array([0.0, 0.0, 2.0])
    assert not volume.contains(far[None])[0]


def test_the_answer_is_that_of_a_batch_run_and_the_surface_grows_towards_it(
    whole: Finished, run_of_one_method: Path, pairs: list[StereoImages]
) -> None:
    assert whole.made[0] == len(pairs) and whole.made[1] > 0
    # the names of the files differ, and so the recorded data; what is measured and found does not
    found, batch = (
        np.loadtxt(each / "trajectory.csv", delimiter=",", skiprows=1)
        for each in (whole.folder, run_of_one_method)
    )
    np.testing.assert_array_equal(found[:, 1:], batch[:, 1:])
    for name in ("landmarks.ply", "mesh.ply"):
        assert (whole.folder / name).read_bytes() == (run_of_one_method / name).read_bytes(), name
    final: Any = trimesh.load(whole.folder / "mesh.ply")
    half, last = (surface.mesh for surface in whole.surfaces)
    assert 0 < half.area < last.area and abs(last.area / final.area - 1.0) < 0.2
    np.testing.assert_allclose(last.extents, final.extents, rtol=0.1)
    assert whole.landmarks > 50


def test_without_the_process_the_stream_goes_on(sequence: StereoSequence, pairs: list[StereoImages]) -> None:
    pair = pairs[0]
    with Session(AHEAD, sequence.calibration) as session:
        session.push(pair.left, pair.right, 0.0)
        assert session.surface() is not None
        kill_workers()
        assert session.surface() is None
        state = session.push(pair.right, pair.left, 0.5)
        assert state is not None and state.number == 1 and session.surface() is None


def test_a_state_does_not_depend_on_later_pairs(
    whole: Finished, session: Session, pairs: list[StereoImages]
) -> None:
    # other images follow, at other times: the states before must have the same bits
    early = push(session, pairs[:FIRST], [0.5 * k for k in range(FIRST)])
    push(session, [pairs[0], pairs[FIRST + 2]], [0.5 * FIRST + 0.3, 0.5 * FIRST + 2.0])
    for state, again in zip(whole.states, early, strict=False):
        for each in fields(LiveState):
            if each.name != "seconds":
                np.testing.assert_array_equal(getattr(state, each.name), getattr(again, each.name))


def test_the_states_follow_the_motion_and_are_those_of_the_run(whole: Finished) -> None:
    states, last = whole.states, whole.states[-1]
    assert not whole.warnings
    assert states[0].status == "searching" and not np.isfinite(np.diagonal(states[0].covariance)).any()
    assert {state.status for state in states[len(states) // 2 :]} == {"measured"}
    final = read_trajectory(whole.folder / "trajectory.csv")
    rates = np.linalg.norm(final.w_P, axis=1)
    assert abs(np.linalg.norm(last.w_P) - rates[-1]) < 5.0 * last.sigma_rate + 0.01
    assert last.sigma_rate < states[2].sigma_rate
    # along which the centre of mass is not determined yet, the sigma says so
    apart, sigma = last.r_N - final.r_N[-1], np.sqrt(np.diagonal(last.covariance)[:3])
    known = np.isfinite(sigma)
    assert known.any() and (np.abs(apart) < 4.0 * sigma).all() and np.linalg.norm(apart[known]) < 0.01
    online = read_online(whole.folder / "online.npz")
    assert online is not None and len(online.timestamps_ns) == len(states)
    # alignment with the final frame changes conventions only
    for name in ("r_N", "k"):
        np.testing.assert_array_equal(getattr(online, name), [getattr(state, name) for state in states])
    assert read_summary(whole.folder).status in ("ok", "degraded")
    assert (whole.folder / "report.html").is_file()


def test_each_pair_is_judged_and_the_run_keeps_what_was_said(whole: Finished) -> None:
    with (whole.folder / "live_states.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert list(rows[0]) == ["timestamp_ns", "status", "reason", "frame_of_reference", "consistent"]
    for row, state in zip(rows, whole.states, strict=True):
        told = [str(state.timestamp_ns), state.status, state.reason, "G@0", str(int(state.consistent))]
        assert list(row.values()) == told
    assert not whole.states[0].consistent and whole.states[0].reason == "no motion is known yet"
    assert all(state.consistent and not state.reason for state in whole.states[FIRST:])


def test_a_jump_of_the_clock_is_found_in_images_and_the_rate_stays(
    whole: Finished, session: Session, pairs: list[StereoImages]
) -> None:
    n = FIRST + 3
    states = push(session, pairs[:n], [0.5 * k + (7.3 if k >= FIRST else 0.0) for k in range(n)])
    assert [state.status for state in states[FIRST:]] == ["uncertain", "measured", "measured"]
    off = re.search(r"the stamps are off by (\S+) s", states[FIRST].reason)
    assert off is not None and abs(float(off[1]) - 7.3) < 0.05 and not states[FIRST].consistent
    assert states[FIRST + 1].consistent and states[-1].timestamp_ns == round(1e9 * (0.5 * (n - 1) + 7.3))
    free = whole.states[n - 1]
    assert abs(states[-1].rate_rpm - free.rate_rpm) < free.sigma_rate_rpm
    assert (states[-1].sigma_rate_rpm < 2.0 * free.sigma_rate_rpm) and len(session) == n


def test_late_repeated_and_frozen_pairs_are_bridged_and_named(
    session: Session, pairs: list[StereoImages]
) -> None:
    order, at = [0, 1, 2, 3, 2, 3, 3, 5], [0.0, 0.5, 1.0, 1.5, 1.0, 1.5, 2.0, 3.5]
    states = push(session, [pairs[k] for k in order], at)
    assert [state is None for state in states] == [False] * 4 + [True, True, False, False]
    assert states[6].status == "predicted" and states[6].observations == 0
    told = " ".join(session.warnings)
    for sentence in ("earlier than the pair before", "the time of the pair before", "bit for bit", "missing"):
        assert sentence in told
    assert len(session) == 6


def test_wrong_pairs_are_refused_in_one_line(
    session: Session, pairs: list[StereoImages], tmp_path: Path
) -> None:
    left, right = pairs[0].left, pairs[0].right
    wrong: dict[str, dict[str, Any]] = {
        r"left image: uint8 of shape \(10, 10\); give uint8 or uint16": {"left": left[:10, :10]},
        "right image: float64": {"right": right.astype(float)},
        "time nan: give seconds": {"time": float("nan")},
        r"mask of the left image: give booleans of shape \(256, 320\)": {"masks": (left, None)},
        "X_NB: give a finite pose": {"X_NB": np.full((4, 4), np.nan)},
    }
    good: dict[str, Any] = {"left": left, "right": right, "time": 0.0}
    for words, given in wrong.items():
        with pytest.raises(InputError, match=words):
            session.push(**{**good, **given})
    session.push(**good)
    with pytest.raises(InputError, match="with every pair, or with none"):
        session.push(left, right, 1.0, X_NB=np.eye(4))
    with pytest.raises(InputError, match="1 pairs have come; at least 3 are needed"):
        session.finish(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert polhode.Session is Session
    with pytest.raises(AttributeError, match="no attribute 'Sessions'"):
        _ = polhode.Sessions
