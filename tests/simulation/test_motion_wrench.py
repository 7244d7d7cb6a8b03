"""What is written of known pushes says the same to readers that hold rows and that interpolate."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.lie import Array
from polhode.simulation.dataset.sequence import plan_sequence, write_knowledge
from polhode.simulation.motion import known_wrench, target_motion
from tests.simulation.motion_scenes import MASS_KG, mass_of, scene_of

PUSHES = [
    {"start_s": 0.0, "duration_s": 1.25, "force_N": [0.01, 0.0, 0.0], "torque_P": [0.0, 1e-3, 0.0]},
    {
        "start_s": 1.2,
        "duration_s": 2.0,
        "force_N": [0.0, 0.02, 0.0],
        "torque_P": [0, 0, 1e-3],
        "period_s": 0.8,
    },
    {"start_s": 4.4, "duration_s": 99.0, "force_N": [0.0, 0.0, -0.01]},
]


def _rows() -> tuple[Array, Array, Array]:
    scene = scene_of(11, 0.5, 1.0, pushes=PUSHES)
    known = known_wrench(scene)
    assert known is not None
    stamps, force_N, torque_P = known
    return (stamps - scene.start_ns) / 1e9, force_N, torque_P


def test_rows_are_in_order_at_20_hz_and_more_and_cover_the_truth() -> None:
    t_s, _, _ = _rows()
    assert t_s[0] == 0.0
    assert t_s[-1] == 6.0
    assert (np.diff(t_s) > 0).all()
    assert np.diff(t_s).max() <= 0.05 + 1e-9


def test_a_jump_lies_between_two_rows_1_ns_apart() -> None:
    t_s, force_N, _ = _rows()
    for edge_s, axis, before, after in [(1.25, 0, 0.01, 0.0), (4.4, 2, 0.0, -0.01)]:
        row = int(np.searchsorted(t_s, edge_s - 1e-12))
        assert t_s[row] == pytest.approx(edge_s, abs=1e-12)
        assert t_s[row] - t_s[row - 1] == pytest.approx(1e-9, rel=1e-3)
        assert (force_N[row - 1, axis], force_N[row, axis]) == (before, after)


@pytest.mark.parametrize("reader", ["hold", "interpolate"])
def test_either_reading_gives_the_velocity_of_the_truth(reader: str) -> None:
    t_s, force_N, _ = _rows()
    dt = np.diff(t_s)[:, None]
    mean_N = force_N[:-1] if reader == "hold" else 0.5 * (force_N[:-1] + force_N[1:])
    v_N = np.concatenate([np.zeros((1, 3)), np.cumsum(mean_N * dt, axis=0)]) / MASS_KG
    motion = target_motion(scene_of(11, 0.5, 1.0, pushes=PUSHES), mass_of(), 0)
    read = np.stack([np.interp(motion.t_s, t_s, v_N[:, axis]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(read, motion.v_N, atol=2e-5 if reader == "hold" else 1e-6)


def test_torques_are_written_beside_the_forces() -> None:
    t_s, _, torque_P = _rows()
    inside = (t_s > 1.25) & (t_s < 3.2 - 1e-12)
    expected = 1e-3 * np.sin(2 * np.pi * (t_s[inside] - 1.2) / 0.8)
    np.testing.assert_allclose(torque_P[inside, 2], expected, atol=1e-9)
    np.testing.assert_array_equal(torque_P[t_s < 1.25 - 1e-12, 1], 1e-3)


@pytest.mark.parametrize("motion", [{}, {"pushes": PUSHES, "pushes_known": False}])
def test_nothing_is_known_without_pushes_or_when_they_are_kept_back(motion: dict[str, Any]) -> None:
    assert known_wrench(scene_of(3, **motion)) is None


@pytest.mark.parametrize("known", [True, False])
def test_a_sequence_tells_the_pushes_when_they_are_known(known: bool, tmp_path: Path) -> None:
    scene = scene_of(3, pushes=PUSHES, pushes_known=known, position_m=[0.0, 0.0, 0.8])
    write_knowledge(plan_sequence(scene, 0), tmp_path)
    path = tmp_path / "wrench0" / "data.csv"
    assert path.exists() == known
    if known:
        first = path.read_text().splitlines()[1].split(",")
        assert [float(value) for value in first] == [scene.start_ns, 0.01, 0, 0, 0, 1e-3, 0]
