"""The benchmark of trust: scenes are what they say, errors are counted as they should be."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.robustness.judge import Errors
from benchmarks.trust.cases import CONFIGS, GROUPS, SHORT, scene_of
from benchmarks.trust.consistency import band, entry_of, holds, pooled
from benchmarks.trust.judgement import OUTCOMES, spin_outcome
from benchmarks.trust.new_scenes import KINDS, new_scene
from benchmarks.trust.revolution import BODIES, SHAPES, SURFACES, body_scene, painted, turned
from polhode.simulation.dataset.plan import plan_sequence


def test_there_are_enough_scenes() -> None:
    assert len(CONFIGS) == 16 and len(KINDS) >= 8 and len(BODIES) >= 20
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
