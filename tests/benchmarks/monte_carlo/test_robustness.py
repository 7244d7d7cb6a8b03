"""The rows of the robustness benchmark: what is wrong in each, and how bias and bridging are measured."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.monte_carlo.bound import cramer_rao_bound, determined_at_truth, true_iterate
from benchmarks.monte_carlo.robustness import (
    CHOSEN,
    CONDITIONS,
    FRAMES,
    SIGNED,
    bias,
    gap_of,
    placed_off,
    print_tables,
    scene_of,
)
from benchmarks.record import Case
from polhode.config.backend_settings import Backend
from polhode.lie import Array, exp_so3, make_pose
from polhode.simulation.monte_carlo import generate

TUMBLE = "triaxial tumble, 7 RPM"
GIVEN = Backend(accel_psd=1e-7, torque_psd=1e-7)


def line_of(condition: str, motion: str, seed: int, signed: Array) -> Case:
    """A run without errors but for the signed ones."""
    line: Case = {
        "case": {"condition": condition, "motion": motion, "seed": seed},
        "errors": [0.0] * 8, "sigma": [1e-3] * 8, "determined_at_truth": [True] * 8,
        "squares": [4.0] * 6, "bound": [1.0] * 6, "nees": [3.0] * 5 + [5.0], "freedom": [9.0] * 6,
        "inside": 0.99, "signed": signed.tolist(), "pixels": 1.0, "levels": [1.0, 1.0], "seconds": 3.0,
    }  # fmt: skip
    if "gap" in condition:
        names = ("nees", "freedom", "squares", "bound", "inside")
        line["gap"] = {name: line[name] for name in names} | {
            "sigma": [[1e-3, 0.01, 0.01], [4e-3, 0.02, 0.02]], "behind": [1e-3, 0.01],
        }  # fmt: skip
    return line


def test_each_row_has_what_its_name_says() -> None:
    for motion in CHOSEN:
        gap = gap_of(scene_of("gap", motion))
        assert (gap.stop - gap.start) * scene_of("gap", motion).dt_s == pytest.approx(10.0)
        assert gap.start == FRAMES - gap.stop
    assert scene_of("no fault", TUMBLE).outliers == 0.0 and not scene_of("no fault", TUMBLE).dropped
    both = scene_of("gap and outliers", TUMBLE)
    assert both.outliers == 0.3 and both.wrong_pairs == 0.1 and len(both.dropped) == 20
    exact, reported = scene_of("jitter, exact poses", TUMBLE), scene_of("jitter, reported poses", TUMBLE)
    assert exact.deadband_m == reported.deadband_m == (4e-3, 1e-3)
    assert exact.sigma_camera_p_m == 0.0 < reported.sigma_camera_p_m


def test_a_bias_is_told_from_scatter() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(0.0, 1.0, (24, len(SIGNED)))
    values[12:] *= 100.0
    values[:, 4] += np.where(np.arange(24) < 12, 3.0, 300.0)
    lines = [line_of("gap", CHOSEN[n // 12], n % 12, v) for n, v in enumerate(values)]
    each, together = bias(lines)
    assert each.shape == (2, 17) and together.shape == (17,)
    assert np.argmax(np.abs(together)) == 4 and together[4] > 8.0
    assert np.abs(np.delete(together, 4)).max() < 4.0


def test_the_place_behind_the_gap_does_not_depend_on_where_G_was_put() -> None:
    sequence = generate(scene_of("gap", TUMBLE), 0)
    shift_of_G = make_pose(exp_so3([0.3, -0.2, 0.1]), np.array([0.02, 0.0, -0.01]))
    estimate: Any = SimpleNamespace(X_NG=sequence.X_NG @ shift_of_G)
    np.testing.assert_allclose(placed_off(sequence, estimate, 50), 0.0, atol=1e-9)
    estimate.X_NG[60:] = make_pose(exp_so3([0.0, 0.0, 0.1]), np.zeros(3)) @ estimate.X_NG[60:]
    off = placed_off(sequence, estimate, 50)
    assert off[1] == pytest.approx(0.1, rel=1e-6) and off[0] > 1e-3
    assert placed_off(sequence, SimpleNamespace(X_NG=sequence.X_NG), 60)[1] < 1e-7  # type: ignore[arg-type]


def test_the_bound_knows_of_noisy_poses_and_of_the_gap() -> None:
    exact, reported, gap = (
        generate(scene_of(name, TUMBLE), 0)
        for name in ("jitter, exact poses", "jitter, reported poses", "gap")
    )
    truth = true_iterate(reported, GIVEN)
    assert truth.camera is not None
    # half a millimetre and a fiftieth of a degree, as stated
    assert np.std(truth.camera[:, :3]) == pytest.approx(5e-4, rel=0.2)
    assert np.std(truth.camera[:, 3:]) == pytest.approx(np.deg2rad(0.02), rel=0.2)
    bounds = [cramer_rao_bound(sequence, GIVEN).mean_squares for sequence in (exact, reported)]
    assert np.all(bounds[1] > bounds[0]) and np.all(bounds[1] < 30.0 * bounds[0])
    whole, within = (cramer_rao_bound(gap, GIVEN, frames) for frames in (slice(None), slice(30, 50)))
    np.testing.assert_allclose(within.states, whole.states[30:50])
    assert np.all(within.mean_squares[:2] > whole.mean_squares[:2])
    np.testing.assert_array_equal(within.freedom[4:], whole.freedom[4:])
    assert all(determined_at_truth(reported, GIVEN))


def test_the_tables_name_what_went_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    lines = [
        line_of(condition, motion, seed, rng.normal(size=17))
        for condition in CONDITIONS
        for motion in CHOSEN[:2]
        for seed in range(3)
    ]
    failed = lines[9]
    failed["failure"] = "no consistent motion"
    lines[15]["errors"][3] = 0.3
    print_tables(lines)
    text = capsys.readouterr().out
    assert "| outliers | 6 | 1 | 6 | 5 (83%) | 0 |" in text
    assert "| gap | 6 | 0 | 6 | 5 (83%) | 1 |" in text
    assert "2.000 (1.00)" in text and "| 1 -> 4 |" in text
    assert f"outliers, {CHOSEN[1]}, 0: no consistent motion" in text
    assert "k1 off by 0.3, stated 0.001" in text
