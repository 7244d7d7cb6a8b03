"""The benchmark of trust: scenes are what they say, errors are counted as they should be."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.robustness.judge import Errors
from benchmarks.trust.cases import CONFIGS, GROUPS, SHORT, scene_of
from benchmarks.trust.consistency import band, entry_of, holds, pooled
from benchmarks.trust.error_models import MODELS
from benchmarks.trust.error_models import print_tables as print_models
from benchmarks.trust.judgement import OUTCOMES, spin_outcome
from benchmarks.trust.new_scenes import KINDS, new_scene
from benchmarks.trust.revolution import BODIES, SHAPES, SURFACES, body_scene, painted, turned
from benchmarks.trust.trust import print_tables
from polhode.simulation.dataset.plan import plan_sequence


def test_there_are_enough_scenes() -> None:
    assert len(CONFIGS) == 19 and len(KINDS) >= 8 and len(BODIES) >= 20
    for group, names in SHORT.items():
        assert set(names) <= set(GROUPS[group])


@pytest.mark.parametrize("kind", KINDS)
def test_a_draw_is_the_same_every_time_and_differs_from_the_next(kind: str) -> None:
    scene, seed = new_scene(kind, 1)
    assert (scene, seed) == new_scene(kind, 1)
    other, other_seed = new_scene(kind, 2)
    assert seed != other_seed and scene.motion != other.motion


def test_a_scene_is_found_by_group_and_name(tmp_path: Path) -> None:
    for group, names in SHORT.items():
        scene, _ = scene_of(group, names[0], 1, tmp_path)
        assert scene.frames >= 30


@pytest.mark.parametrize("shape", SHAPES)
def test_each_piece_is_closed_and_symmetric(shape: str) -> None:
    for piece in SHAPES[shape]():
        mesh, uv = turned(piece)
        assert len(uv) == len(mesh.vertices)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.is_watertight and mesh.volume > 0.0
        values = np.linalg.eigvalsh(mesh.moment_inertia)
        assert min(np.diff(values)) < 1e-6 * values[-1]


def test_marks_go_around_the_seam_and_are_few_where_sparse() -> None:
    rng = np.random.default_rng(1)
    rich, sparse = (painted(3.0, 0.75, flag, rng).astype(int) for flag in (True, False))
    ground = np.bincount(sparse.ravel()).argmax()
    assert np.mean(sparse != ground) < 0.15 < np.mean(rich != np.bincount(rich.ravel()).argmax())
    assert np.mean(rich[:, 0] != rich[:, -1]) < 0.05


@pytest.mark.parametrize("name", ["dish_sparse", "cone_bare"])
def test_bodies_spin_about_their_axis_of_symmetry(name: str, tmp_path: Path) -> None:
    scene, seed = body_scene(name, tmp_path)
    plan = plan_sequence(scene, seed)
    moments = np.sort(plan.mass.moments)
    assert min(np.diff(moments)) < 1e-6 * moments[-1]
    across = np.hypot(*scene.motion.spin_rpm[:2]) / abs(scene.motion.spin_rpm[2])
    assert (0.05 <= across <= 0.25) if BODIES.index(name) % 3 == 2 else across == 0.0
    assert (scene.body.contrast == 0.0) == name.endswith(SURFACES[-1])


def drawn(runs: int, scale: float) -> list[dict[str, Any]]:
    """Entries of runs of 20 frames with constant errors, and sigmas ``scale`` times the right ones."""
    rng = np.random.default_rng(2)
    A = np.array([[2.0, 0.3, 0.0], [0.0, 1e-3, 0.0], [0.0, 2e-4, 5e-4]])
    errors = (rng.normal(size=(runs, 3)) @ A.T)[:, None].repeat(20, axis=1)
    covariance = np.tile(scale**2 * A @ A.T, (20, 1, 1))
    return [entry_of(Errors(each, covariance, np.ones((20, 3), bool))) for each in errors]


def test_pooled_errors_hold_for_true_sigmas_only() -> None:
    assert holds(pooled(drawn(40, 1.0)))
    assert not holds(pooled(drawn(40, 1.6)))
    assert not holds(pooled(drawn(40, 0.7)))
    assert pooled([]) == {"runs": 0, "ratio": None, "low": None, "high": None, "coverage": None}
    assert holds(pooled([]))


def test_only_claimed_components_count() -> None:
    errors, covariance = np.array([[1.0, 5.0, 1e3]]), np.diag([1.0, 1.0, np.inf])[None]
    entry = entry_of(Errors(errors, covariance, np.array([[True, True, False]])))
    assert entry == {"nees": 26.0, "expected": 2.0, "inside": 1, "total": 2}


def test_the_band_narrows_with_the_number_of_components() -> None:
    (low, high), (least, most) = band(3), band(300)
    assert low < least < 1.0 < most < high
    assert (low, high) == pytest.approx((0.072, 3.116), abs=1e-3)


@pytest.mark.parametrize(
    ("status", "error", "outcome"),
    [("ok", 0.05, 0), ("degraded", 0.05, 1), ("degraded", 9.0, 2), ("failed", None, 2), ("ok", 9.0, 3)],
)
def test_a_rate_is_found_or_the_run_says_so(status: str, error: float | None, outcome: int) -> None:
    assert spin_outcome({"status": status, "rate_error_deg_s": error}) == OUTCOMES[outcome]


def row(group: str, name: str, **more: Any) -> dict[str, Any]:
    """A row of the record, of a sound run."""
    checks = {"marks": (0.5, 0.1, False)}
    base = {"case": {"group": group, "name": name}, "status": "ok", "warnings": [], "claims": {}, "wrong": []}
    return base | {"checks": checks, "seconds": 50.0, "checks_seconds": 2.0} | more


def test_the_tables_show_what_holds_and_what_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = drawn(1, 1.0)[0], {"nees": 90.0, "expected": 3.0, "inside": 40, "total": 60}
    doubted = {"status": "degraded", "checks": {"marks": (0.0, 0.1, True)}}
    intervals = {"k1": {"low": 0.0, "high": 1.0, "true": 0.5, "inside": True}}
    second = row("new", "b", consistency={"position": bad}, wrong=["position"])
    mesh = {"within_1_sigma": 0.68, "within_3_sigma": 0.99}
    print_tables(
        [
            row("configs", "a", consistency={"position": good}, intervals=intervals, mesh=mesh),
            second | {"case": {"group": "new", "name": "b", "draw": 2}},
            row("configs", "lost", status="failed"),
            row("revolution", "c", rate_error_deg_s=0.02, rate_sigma_deg_s=None, rate_deg_s=12.0),
            row("revolution", "d", rate_error_deg_s=11.0, rate_sigma_deg_s=0.1, rate_deg_s=12.0, **doubted),
        ]
    )  # fmt: skip
    out = capsys.readouterr().out
    assert "| b 2 | 30.00 (67) | - |" in out and "**all** | **" in out
    assert "| a | ok | - | - | 1 of 1 | 68.0 | 99.0 | 50 | 4.0 |" in out
    assert "1 wrong and confident" in out and "1 failed with a reason" in out
    assert "Checks: 4.0 % of the time of 3 runs" in out
    assert "| d | 12.0 | 11.000 | 0.100 | degraded | not found, and said so | marks |" in out
    assert "1 found, ok, 0 found, but doubted, 1 not found, and said so, 0 not found, and ok" in out


def test_error_models_are_pooled_and_the_worst_quantity_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    entries = {"position": {"nees": 6.0, "expected": 3.0, "inside": 90, "total": 100},
               "rate": {"nees": 3.0, "expected": 3.0, "inside": 100, "total": 100}}  # fmt: skip
    calm = {"position": {"nees": 3.0, "expected": 3.0, "inside": 100, "total": 100}}
    rows: list[dict[str, Any]] = [
        {"case": {"group": "new", "name": "glitter", "draw": 2}, "models": dict.fromkeys(MODELS, entries)},
        {"case": {"group": "configs", "name": "ts38"}, "models": dict.fromkeys(MODELS, calm)},
        {"case": {"group": "configs", "name": "asteroid"}, "models": {}, "failure": "no motion"},
    ]
    print_models(rows)
    printed = capsys.readouterr().out
    assert "No motion is found: asteroid" in printed and "2 scenes" in printed
    assert "| glitter 2 |" in printed and "2.00 position" in printed and "**1.50 to 2.41 (95.0)**" in printed
