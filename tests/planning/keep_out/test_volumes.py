"""Keep-out volumes against closed forms, and their promise against independent draws."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array
from polhode.planning.keep_out import volumes
from polhode.planning.keep_out.measured_body import ScalarGrid, continuous_sigma, grown_body
from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out, keep_out_of_all
from polhode.planning.prediction import draw_ensemble, nominal_motion
from polhode.records.mesh_metrics import encloses
from polhode.records.occupancy import EMPTY, FREE, OUTLINED, POSSIBLE, Occupancy
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError
from tests.planning.bodies import SIGMA_M, ball, box, estimate, measured


def quick(horizon_s: float, cells: int = 48) -> KeepOutOptions:
    return KeepOutOptions(horizon_s, 0.97, members=120, cells=cells)


def capsule_distance(p: Array, a: Array, b: Array, radius: float) -> Array:
    along = np.clip((p - a) @ (b - a) / np.sum((b - a) ** 2), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - along[:, None] * (b - a), axis=1) - radius)


def test_a_ball_along_a_line_sweeps_a_capsule() -> None:
    target = estimate((0.0, 0.0, 0.1), (0.03, 0.01, 0.0), size=1e-4)
    found = keep_out(ball(), target, quick(10.0))
    radius = 0.1 + found.body.sigmas * SIGMA_M
    a = target.last.r_N
    b = a + 10.0 * target.last.v_N
    cell = found.swept.level.step_m
    p = a + np.random.default_rng(0).uniform(-0.25, 0.45, (3000, 3))
    exact = capsule_distance(p, a, b, radius)
    near = np.abs(exact) < 0.12
    off = found.swept.signed_distance(p[near]) - exact[near]
    # the volume may be larger than the capsule by what the grids cannot tell, hardly smaller
    assert off.max() < 0.25 * cell and off.min() > -1.5 * cell
    exact_volume = np.pi * radius**2 * np.linalg.norm(b - a) + 4.0 / 3.0 * np.pi * radius**3
    assert found.swept.mesh.is_watertight
    assert exact_volume < 1.005 * found.swept.volume_m3 < 1.2 * exact_volume


def inside(surface: SurfaceModel, found_level: object, R: Array, p: Array, noise: Array) -> bool:
    V = np.asarray(surface.mesh.vertices) + (surface.sigma_m * noise)[:, None] * surface.mesh.vertex_normals
    return all(float(found_level.at(V @ A.T + b).max()) <= 0.0 for A, b in zip(R, p, strict=True))  # type: ignore[attr-defined]


def test_independent_draws_stay_inside_as_often_as_promised() -> None:
    surface, target = box(0.02), estimate((0.05, 0.6, 0.1), (0.005, 0.0, 0.0), psd=1e-9)
    found = keep_out(surface, target, KeepOutOptions(15.0, 0.97, members=400, cells=48))
    times = np.linspace(0.11, 15.0, 30)
    members = draw_ensemble(target, times, 200, 77)
    rng = np.random.default_rng(5)
    swept, instants = 0, 0
    motion = found.instant.motion
    rows = np.unique(np.linspace(0, len(motion.time_s) - 1, 4).round().astype(int))
    at_rows = draw_ensemble(target, motion.time_s[rows], 200, 78)
    for n in range(200):
        noise = rng.normal(size=len(surface.sigma_m))
        swept += inside(surface, found.swept.level, members.R_NG[n], members.p_NG[n], noise)
        V = np.asarray(surface.mesh.vertices)[::15]
        gaps = [
            found.instant.signed_distance(int(k), V @ at_rows.R_NG[n, i].T + at_rows.p_NG[n, i]).max()
            for i, k in enumerate(rows)
        ]
        instants += max(gaps) <= 0.0
    # 97 % promised: of 200 independent draws at least 188 with a probability of 99.6 %
    assert swept >= 188 and instants >= 188
    bare = keep_out(
        measured(surface.mesh, 1e-9), estimate((0.05, 0.6, 0.1), (0.005, 0.0, 0.0), size=1e-4),
        quick(15.0),
    )  # fmt: skip
    assert bare.swept.volume_m3 < found.swept.volume_m3 < 1.5 * bare.swept.volume_m3


@pytest.mark.parametrize(("size", "psd"), [(1e3, 0.0), (1.0, 1e-2)])
def test_a_volume_of_any_size_is_closed_or_refused(
    size: float, psd: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = estimate((0.0, 0.3, 0.1), (0.01, 0.0, 0.0), size, psd=psd)
    assert keep_out(ball(), target, quick(20.0, 24)).swept.mesh.is_watertight
    monkeypatch.setattr(volumes, "MAX_CELLS", 1000)
    with pytest.raises(InputError, match="--horizon 20: too uncertain for a volume"):
        keep_out(ball(), target, quick(20.0, 24))


def test_a_surface_that_touches_itself_at_a_corner_of_the_grid_stays_closed() -> None:
    """Vertices on several edges of one corner then nearly coincide."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        values = rng.normal(size=(9, 9, 9)).astype(np.float32)
        for axis in range(3):
            np.moveaxis(values, axis, 0)[[0, -1]] = 1.0
        values[tuple(rng.integers(2, 7, 3))] = 1e-9
        mesh = ScalarGrid(np.zeros(3), 0.04, values).mesh()
        assert mesh.is_watertight and mesh.is_winding_consistent


@pytest.mark.parametrize("seed", range(8))
def test_a_volume_is_closed_and_never_claims_more_clearance_than_there_is(seed: int) -> None:
    """Bodies, motions and sigmas at random, against the distance to all triangles and the winding number."""
    rng = np.random.default_rng(seed)
    sides = 0.3 * rng.uniform(0.05, 1.0, 3)
    body = ball() if seed % 4 == 3 else measured(trimesh.creation.box(sides).subdivide_to_size(0.03), 1e-3)
    spin, drift = rng.normal(size=3) * rng.uniform(0.0, 0.5), 0.03 * rng.normal(size=3)
    size, psd = 10.0 ** rng.uniform([-2.0, -9.0], [1.0, -5.0])
    target = estimate(tuple(spin), tuple(drift), size, psd=psd)
    found = keep_out(body, target, quick(float(rng.uniform(2.0, 20.0)), 20)).swept
    mesh = found.mesh
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
    low, high = mesh.bounds
    near = mesh.vertices[rng.integers(len(mesh.vertices), size=60)] + 0.3 * found.level.step_m * rng.normal(
        size=(60, 3)
    )
    points = np.concatenate([near, rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, (60, 3))])
    distance = np.concatenate([trimesh.proximity.closest_point_naive(mesh, each[None])[1] for each in points])
    exact = np.where([encloses(mesh, each) for each in points], -distance, distance)
    claimed = found.signed_distance(points)
    assert (claimed <= exact + 1e-9).all()
    np.testing.assert_allclose(claimed, exact, rtol=0.02, atol=0.1 * found.level.step_m)


def test_a_body_whose_attitude_is_unknown_stays_in_its_sphere() -> None:
    target = estimate((0.0, 0.3, 0.1), size=1e-3)
    sigma = np.sqrt(np.diag(target.last.covariance))
    sigma[6:9] = 1.5
    unknown = replace(target, last=replace(target.last, covariance=np.diag(sigma**2)))
    found = keep_out(box(0.02), unknown, quick(5.0, 40))
    most = np.linalg.norm(found.swept.mesh.vertices - target.last.r_N, axis=1).max()
    radius = np.linalg.norm(found.body.points_G, axis=1).max()
    assert radius < most + found.swept.level.step_m and most < radius + 2.0 * found.swept.level.step_m


def test_an_uncertain_surface_grows_no_farther_than_the_sky_is_seen_and_one_unknown_is_refused() -> None:
    surface = ball()
    V = np.asarray(surface.mesh.vertices)
    vague = replace(surface, sigma_m=np.where(V[:, 2] > 0.0, 0.01, SIGMA_M))
    corner, step_m = np.full(3, -0.2), 0.005
    centres = np.stack(np.meshgrid(*[corner[0] + step_m * np.arange(81)] * 3, indexing="ij"), -1)
    beyond = np.linalg.norm(centres, axis=-1) > 0.11
    occupied = Occupancy(corner, step_m, np.where(beyond, EMPTY, FREE).astype(np.uint8))
    places = np.array([[0.0, 0.0, z] for z in (0.113, 0.119, 0.125)])
    grown = grown_body(vague, 0.01).grid.at(places)
    cut = grown_body(vague, 0.01, occupied=occupied).grid.at(places)
    assert (grown < 0.0).all()
    # two sigmas remain
    assert cut[0] < 0.0 and cut[1] < 0.0 and cut[2] > 0.0
    # nothing is known beyond the grid
    small = Occupancy(np.full(3, -0.105), step_m, np.full((43, 43, 43), FREE, dtype=np.uint8))
    np.testing.assert_allclose(grown_body(vague, 0.01, occupied=small).grid.at(places), grown, atol=1e-3)
    with pytest.raises(InputError, match=r"known to within .* m only: no keep-out volume"):
        grown_body(measured(surface.mesh, 1.0), 0.01)


def test_less_is_known_more_is_kept_out() -> None:
    motion = (0.0, 0.3, 0.0)
    volumes = [
        keep_out(box(0.02), estimate(motion, size=size), quick(5.0, 24)).swept.volume_m3
        for size in (0.1, 1.0, 3.0)
    ]
    assert volumes[0] < volumes[1] < volumes[2]
    again = keep_out(box(0.02), estimate(motion, size=3.0), quick(5.0, 24)).swept.volume_m3
    assert again == volumes[2], "the same seed gives the same volume"


def test_an_open_mesh_is_kept_out_of_by_its_hull_and_says_so() -> None:
    full = trimesh.creation.icosphere(4, 0.1)
    half = full.submesh([np.flatnonzero(full.triangles_center[:, 2] > 0.0)], append=True)
    assert grown_body(measured(full), 0.01).covers == "surface"
    body = grown_body(measured(half), 0.01)
    assert body.covers == "hull" and body.open_share > 0.3
    # the middle of the dent that was not seen
    assert float(body.grid.at(np.array([[0.0, 0.0, 0.05]]))[0]) < -0.03
    shell = grown_body(measured(half), 0.01, cover="surface")
    assert float(shell.grid.at(np.array([[0.0, 0.0, 0.05]]))[0]) > 0.03


def test_what_outlines_show_and_no_frame_excludes_is_in_it_and_told_apart() -> None:
    """A boom beside a ball whose other half was never seen: each place knows why it is there."""
    full = trimesh.creation.icosphere(4, 0.1)
    half = measured(full.submesh([np.flatnonzero(full.triangles_center[:, 2] > 0.0)], append=True))
    corner, step_m = np.full(3, -0.2), 0.01
    centres = np.stack(np.meshgrid(*[corner[0] + step_m * np.arange(41)] * 3, indexing="ij"), -1)
    boom = (np.abs(centres[..., :2]) < 0.005).all(-1) & (centres[..., 2] > 0.1)
    below = (np.linalg.norm(centres, axis=-1) < 0.1) & (centres[..., 2] < 0.0)
    state = np.where(boom, OUTLINED, np.where(below, POSSIBLE, 0)).astype(np.uint8)
    occupied = Occupancy(corner, step_m, state)
    target, options = estimate((0.0, 0.0, 0.3), size=1e-2), quick(2.0, 40)
    found = keep_out(half, target, options, occupied)
    assert found.body.covers == "possible"
    R, p = target.last.R_NG, target.last.r_N
    tip, bottom, side = (p + R @ np.array(each) for each in ((0, 0, 0.19), (0, 0, -0.09), (0.07, 0, 0.07)))
    assert found.contains(np.array([tip, bottom, side])).all()
    V = np.asarray(found.swept.mesh.vertices)
    why = found.reasons(V)
    nearest = [why[np.linalg.norm(V - each, axis=1).argmin()] for each in (side, tip, bottom)]
    assert nearest == [0, 1, 2]
    outlines, surface = (
        keep_out(half, target, replace(options, cover=cover), occupied) for cover in ("outlines", "surface")
    )
    assert outlines.contains(tip[None])[0] and not outlines.contains(p[None] - R[:, 2] * 0.05)[0]
    assert not surface.contains(tip[None])[0]
    assert surface.swept.volume_m3 < outlines.swept.volume_m3 < found.swept.volume_m3
    with pytest.raises(InputError, match=r"--cover outlines: the run has no occupancy\.npz"):
        keep_out(half, target, replace(options, cover="outlines"))


def test_the_instant_volume_moves_with_the_body_and_what_does_not_fit_is_refused() -> None:
    target = estimate((0.0, 0.5, 0.0), size=0.01)
    volume = keep_out(box(), target, quick(4.0, 32))
    found = volume.instant
    states = nominal_motion(target, found.motion.time_s)
    for k in (0, len(states.time_s) - 1):
        tip = states.p_NG[k] + states.R_NG[k] @ np.array([[0.20, 0.0, 0.0], [0.0, 0.0, 0.0]]).T.T[0]
        distance = float(found.signed_distance(k, tip[None])[0])
        assert distance == pytest.approx(0.05, abs=2.0 * found.body.grid.step_m) and distance < 0.05
    for distances in (volume.swept.signed_distance, partial(found.signed_distance, 0)):
        with pytest.raises(InputError, match=r"points of shape \(3,\): give coordinates \(n, 3\) in N"):
            distances(np.zeros(3))
    with pytest.raises(InputError, match="instant 1000000: give 0 to"):
        found.signed_distance(10**6, np.zeros((1, 3)))
    assert repr(volume).startswith("KeepOut(") and len(repr(volume)) < 80


def test_a_lone_sigma_is_held_by_its_neighbours() -> None:
    surface = ball()
    sigma, V = surface.sigma_m.copy(), np.asarray(surface.mesh.vertices)
    sigma[7], sigma[11] = 0.02, np.inf
    found = continuous_sigma(replace(surface, sigma_m=sigma))
    edges = surface.mesh.edges_unique
    around = edges[(edges == 7).any(axis=1)]
    nearest = float(np.linalg.norm(V[around[:, 0]] - V[around[:, 1]], axis=1).min())
    assert found[7] == pytest.approx(SIGMA_M + nearest, rel=1e-9) and found[7] < 0.25 * sigma[7]
    # no measurement: the 99th percentile of the others
    assert found[11] == pytest.approx(SIGMA_M, rel=1e-9)
    rest = np.delete(np.arange(len(V)), [7, 11])
    np.testing.assert_array_equal(found[rest], surface.sigma_m[rest])
    # a whole patch that is badly known stays so
    patch = V[:, 2] > 0.0
    wide = continuous_sigma(replace(surface, sigma_m=np.where(patch, 0.02, SIGMA_M)))
    assert wide[V[:, 2].argmax()] == 0.02


def test_the_volume_of_several_hypotheses_holds_each() -> None:
    hypotheses = [
        estimate(w_G, v_N, size=1e-4)
        for w_G, v_N in (((0.0, 0.0, 0.1), (0.03, 0.01, 0.0)), ((0.0, 0.0, -0.7), (-0.02, 0.0, 0.04)))
    ]
    surface, options = box(0.03), quick(10.0, cells=32)
    both = keep_out_of_all(surface, hypotheses, options)
    found = [keep_out(surface, each, options) for each in hypotheses]
    for each, alone in zip(hypotheses, found, strict=True):
        inside = alone.swept.level.corners()[alone.swept.level.values.ravel() <= 0.0]
        assert (both.swept.signed_distance(inside) <= 0.0).all()
        # the body itself at an instant
        k = len(both.instant.motion.time_s) // 2
        there = nominal_motion(each, both.instant.motion.time_s)
        places = surface.mesh.vertices @ there.R_NG[k].T + there.p_NG[k]
        assert (both.instant.signed_distance(k, places) <= 0.0).all()
    volumes = [each.swept.volume_m3 for each in found]
    assert max(volumes) < both.swept.volume_m3 < 1.4 * sum(volumes)
    assert both.swept.mesh.is_watertight and found[0].united_with([]) is found[0]
