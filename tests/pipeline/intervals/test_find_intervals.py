"""Intervals of estimates from measurements: the truth is inside, and a switch turns them off."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.config.backend_settings import Backend, Bounds
from polhode.geometry.lie import Array, exp_so3
from polhode.pipeline.intervals import find_intervals as module
from polhode.pipeline.intervals.find_intervals import find_intervals, intervals_in
from polhode.pipeline.intervals.hull_and_limits import PAIRS, motion_limits
from polhode.records.estimate import MotionEstimate
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Intervals
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.pipeline.intervals.test_hull_and_limits import BOX, no_limits

CONFIG = Backend(process_noise="given", accel_psd=1e-8, torque_psd=1e-8, max_iterations=40)
"""Along what a pure spin hides the solver would walk on without an end."""
COM_G, RADIUS_M = (0.01, -0.02, 0.015), 0.11


@pytest.fixture(autouse=True)
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarser filling of the hull is fast, and enough here."""
    monkeypatch.setattr(module, "POINTS", 100)


@pytest.fixture(scope="module")
def spin() -> tuple[MotionEstimate, Array]:
    """10 s of a sphere that is seen well, and the true centre of mass in the estimate's G."""
    scene = SyntheticScene(
        frames=20, landmarks=120, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.1, com_G=COM_G,
        J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.0, 0.0, 0.8), accel_psd=1e-8, torque_psd=1e-8,
    )  # fmt: skip
    sequence = generate(scene, 0)
    initial = initialize_motion(sequence.tracks, sequence.relative, CONFIG)
    estimate = estimate_motion(sequence.tracks, initial, CONFIG, Silent())
    true, found = sequence.X_NG[0], estimate.X_NG[0]
    com_N = true[:3, :3] @ np.array(COM_G) + true[:3, 3]
    return estimate, found[:3, :3].T @ (com_N - found[:3, 3])


@pytest.fixture(scope="module")
def sphere(spin: tuple[MotionEstimate, Array]) -> SurfaceModel:
    """The surface on which the landmarks lie."""
    p_G = spin[0].landmarks.p_G
    columns = np.concatenate([2.0 * p_G, np.ones((len(p_G), 1))], axis=1)
    mesh = trimesh.creation.icosphere(3, RADIUS_M)
    mesh.apply_translation(np.linalg.lstsq(columns, np.sum(p_G**2, axis=1), rcond=None)[0][:3])
    n = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


def found_in(estimate: MotionEstimate, surface: SurfaceModel, **bounds: Any) -> Intervals:
    config = CONFIG.model_copy(update={"bounds": Bounds.model_validate(bounds)})
    found, doubts = find_intervals(estimate, surface, None, config)
    assert found is not None and not doubts
    return found


def test_a_pure_spin_has_the_truth_inside_every_interval_unless_they_are_switched_off(
    spin: tuple[MotionEstimate, Array], sphere: SurfaceModel
) -> None:
    estimate, com_G = spin
    found = found_in(estimate, sphere)
    assert found.com_G is not None and found.com_shift_P is not None
    low, high = np.array(found.com_G)
    assert np.all(low < com_G) and np.all(com_G < high)
    free = ~estimate.mass.identifiable.com_P
    assert [part is not None for part in found.com_shift_P] == free.tolist() and free.sum() == 1
    shift = estimate.mass.R_GP.T @ (com_G - estimate.mass.com_G)
    for part, moved in zip(found.com_shift_P, shift, strict=True):
        assert part is None or part[0] < moved < part[1]
    # the chord of the sphere through the centre of mass, and the surface's three sigmas
    length = 2.0 * np.sqrt(RADIUS_M**2 - 0.01**2 - 0.02**2)
    part = next(part for part in found.com_shift_P if part is not None)
    assert length < part[1] - part[0] < 1.1 * length
    assert found.k1 is not None and found.k2 is not None
    assert found.k1[0] <= np.log(1.5 / 1.2) <= found.k1[1] and found.k2[0] <= np.log(1.2 / 0.9) <= found.k2[1]
    assert len(found.bounds) == 2 and "convex hull" in found.bounds[0] and "8 times" in found.bounds[1]
    assert found.k1[0] < found.k1[1] and found.k2[0] < found.k2[1]
    off = CONFIG.model_copy(update={"bounds": Bounds(intervals=False)})
    assert find_intervals(estimate, sphere, None, off) == (None, [])
    # what is determined has none
    mass, known = estimate.mass, replace(estimate.mass.identifiable, k1=True, k2=True, com=True)
    whole = replace(estimate, mass=replace(mass, identifiable=known))
    assert find_intervals(whole, sphere, None, CONFIG) == (None, [])
    found = found_in(replace(estimate, mass=replace(mass, identifiable=replace(known, k2=False))), sphere)
    assert found.com_G is None and found.k1 is None and found.k2 is not None


def test_without_a_hull_or_with_a_hull_elsewhere_a_warning_says_so(
    spin: tuple[MotionEstimate, Array], sphere: SurfaceModel
) -> None:
    estimate, marks = spin[0], spin[0].landmarks
    estimate = replace(estimate, landmarks=replace(marks, observations=np.zeros_like(marks.observations)))
    nothing = SurfaceModel(trimesh.Trimesh(), np.zeros(0), np.zeros(0, dtype=np.int64))
    away = sphere.mesh.copy()
    away.apply_translation([1.0, 0.0, 0.0])
    for surface, words in ((nothing, "no hull"), (replace(sphere, mesh=away), "outside the hull")):
        found, doubts = find_intervals(estimate, surface, None, CONFIG)
        assert found is None and words in doubts[0]
    # limits that no mass fits leave the ratios open: a moment about z larger than the others together
    impossible = replace(no_limits(), inertia_rows=np.array([[1.1, 1.1, -1.0, 0.0, 0.0, 0.0]]))
    found, doubts = intervals_in(BOX, impossible, estimate.mass.identifiable, Bounds())
    assert found is not None and found.k1 is None and found.com_G is not None
    assert "no mass inside the hull" in doubts[0]


def test_a_spin_admits_every_inertia_with_that_principal_axis(spin: tuple[MotionEstimate, Array]) -> None:
    """However far from the estimate: the limits are linear in J, whatever its scale."""
    estimate, _ = spin
    assert estimate.covariance_last_body is not None
    J, by_parameters = inertia_by_parameters(estimate.mass.J_G, FORMS[CONFIG.inertia])
    w_G = estimate.mass.R_GP @ estimate.w_P.mean(axis=0)
    limits = motion_limits(
        *(estimate.mass.com_G, estimate.mass.R_GP, J, by_parameters),
        *(estimate.covariance_last_body, w_G, 0.2),
    )
    axis = w_G / np.linalg.norm(w_G)
    across = np.linalg.svd(axis[None])[2][1:].T
    basis = np.column_stack([across, axis])
    for moments in ((1.5, 1.2, 0.9), (1.0, 0.7, 1.5), (1.2, 1.0, 0.4)):
        body = basis @ np.diag(moments) @ basis.T
        tilted = exp_so3(0.2 * across[:, 0]) @ body @ exp_so3(0.2 * across[:, 0]).T
        for scale in (0.01, 1.0, 50.0):
            assert np.all(limits.inertia_rows @ [scale * body[pair] for pair in PAIRS] <= 0.0)
            assert np.any(limits.inertia_rows @ [scale * tilted[pair] for pair in PAIRS] > 0.0)


def test_a_given_box_and_equal_moments_narrow_them(
    spin: tuple[MotionEstimate, Array], sphere: SurfaceModel
) -> None:
    free = found_in(spin[0], sphere)
    assert free.com_G is not None
    low, high = np.array(free.com_G)
    middle = 0.5 * (low + high)
    box = ((low - 1.0).tolist(), [*(high[:2] + 1.0), middle[2]])
    found = found_in(spin[0], sphere, com_box_G=box, equal_moments="largest")
    assert found.com_G is not None
    assert found.com_G[1][2] == pytest.approx(middle[2]) and found.k1 == (0.0, 0.0)
    assert found.k2 is not None and found.k2[1] > 0.5
    assert any("given box" in words for words in found.bounds)
