"""What a planner asks of the keep-out volume, against closed forms, SciPy and other programs."""

import io
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import exp_so3
from polhode.planning.keep_out.queries import KeepOut, surface_points
from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out, keep_out_of_all
from polhode.planning.plan_files import field_npz, volume_files
from polhode.planning.prediction import nominal_motion
from polhode.runtime.errors import InputError
from tests.planning.bodies import ball, box, estimate, measured

CENTRE_N = np.array([0.1, 0.0, 0.6])
"""Of the body at the start"""


@pytest.fixture(scope="module")
def drifting() -> KeepOut:
    """A ball of 0.1 m that drifts along x at 3 cm/s, known to a millimetre."""
    target = estimate((0.0, 0.0, 0.1), (0.03, 0.0, 0.0), size=0.3)
    return keep_out(ball(), target, KeepOutOptions(10.0, 0.99, members=120, cells=40))


def test_clearance_at_times_follows_the_ball(drifting: KeepOut) -> None:
    rng = np.random.default_rng(1)
    p_N, time = CENTRE_N + rng.uniform(-0.4, 0.6, (400, 3)), rng.uniform(0.0, 10.0, 400)
    centres = CENTRE_N + np.outer(time, [0.03, 0.0, 0.0])
    exact = np.linalg.norm(p_N - centres, axis=1) - 0.1
    found = drifting.clearance(p_N, time)
    outside = exact > 0.02
    off = exact[outside] - found.distance_m[outside]
    assert off.min() > -1e-4 and np.median(off) < 0.01, "less than there is, by the margin"
    outwards = (p_N - centres) / np.linalg.norm(p_N - centres, axis=1, keepdims=True)
    assert np.einsum("nk,nk->n", outwards, found.gradient_N)[outside].min() > 0.97
    np.testing.assert_allclose(np.linalg.norm(found.gradient_N[outside], axis=1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(drifting.contains(p_N, time), found.distance_m <= 0.0)
    sphere = drifting.clearance(p_N, time, radius_m=0.05)
    np.testing.assert_allclose(sphere.distance_m, found.distance_m - 0.05)
    # what is clear of the swept volume is clear at each instant
    swept = drifting.clearance(p_N)
    assert (swept.distance_m[~drifting.contains(p_N)] > 0.0).all()
    assert not drifting.contains(p_N, time)[~drifting.contains(p_N)].any()


def test_a_part_that_is_farther_away_but_less_certain_bounds_the_clearance() -> None:
    """Beside the hub of a body that turns by uncertain angles about z, before the tip of its wing."""
    hub = trimesh.creation.box((0.1, 0.1, 0.1)).subdivide_to_size(0.02)
    wing = trimesh.creation.box((0.2, 0.04, 0.04)).subdivide_to_size(0.02)
    wing.apply_translation((0.5, 0.3, 0.0))
    target = estimate((0.0, 0.0, 0.01), size=1e-3)
    sigma = np.sqrt(np.diag(target.last.covariance))
    sigma[8] = 0.2
    turning = replace(target, last=replace(target.last, covariance=np.diag(sigma**2)))
    found = keep_out(measured(hub + wing), turning, KeepOutOptions(1.0, 0.97, members=200, cells=24)).instant
    R, p = turning.last.R_NG, turning.last.r_N
    place_G = np.array([[0.0, 0.5, 0.0]])
    claimed = float(found.signed_distance(0, place_G @ R.T + p)[0])
    tips = [
        trimesh.proximity.closest_point_naive(wing, place_G @ exp_so3([0.0, 0.0, angle]))[1][0]
        for angle in np.random.default_rng(3).normal(0.0, 0.2, 300)
    ]
    # the hub is at 0.45 m
    assert 0.2 < claimed < np.quantile(tips, 0.05) < 0.4


def test_the_gradient_is_the_derivative_of_the_distance(drifting: KeepOut) -> None:
    rng = np.random.default_rng(2)
    p_N = CENTRE_N + rng.uniform(-0.5, 0.7, (200, 3))
    step, along = 1e-5, rng.normal(size=(200, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    ask = drifting.clearance
    slope = (ask(p_N + step * along).distance_m - ask(p_N - step * along).distance_m) / (2.0 * step)
    expected = np.einsum("nk,nk->n", ask(p_N).gradient_N, along)
    # but where the nearest triangle changes
    assert np.mean(np.abs(slope - expected) < 1e-3) > 0.9


def test_a_body_of_the_users_own_is_no_nearer_than_its_points(drifting: KeepOut) -> None:
    chaser = trimesh.creation.box((0.2, 0.1, 0.1))
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = CENTRE_N + np.array([[0.9, 0.0, 0.0], [0.45, 0.0, 0.0], [0.1, 0.0, 0.0]])
    time = np.array([0.0, 5.0, 0.0])
    found = drifting.clearance_of_body(chaser, poses, time)
    # gaps of 0.7, 0.1 and none between ball and box
    exact = np.array([0.9 - 0.1 - 0.1, 0.45 - 0.15 - 0.1 - 0.1, -0.1])
    assert (found.distance_m <= exact + 1e-4).all() and (found.distance_m > exact - 0.06)[:2].all()
    assert found.gradient_N[0, 0] > 0.9
    points, apart_m = surface_points(chaser)
    dense = np.asarray(trimesh.sample.sample_surface(chaser, 20_000, seed=0)[0])
    assert cKDTree(points).query(dense)[0].max() <= apart_m
    swept = drifting.clearance_of_body(chaser, poses)
    assert swept.distance_m[0] < found.distance_m[0]


def test_a_contact_has_a_time_and_a_probability(drifting: KeepOut) -> None:
    """The ball moves along x, and meets a sphere at rest at 5 s; one that is far away, never."""
    time = np.linspace(0.1, 10.0, 60)
    here = np.tile(CENTRE_N + np.array([0.03 * 5.0 + 0.1 + 0.05, 0.0, 0.0]), (60, 1))
    met = drifting.contact(here, time, radius_m=0.05)
    assert met.first_s is not None and 3.0 < met.first_s <= 5.1 and met.probability > 0.99
    assert (np.diff(met.probability_by) >= -1e-12).all()
    # a margin of millimetres for the surface makes it a tenth of a second earlier
    assert 4.7 < np.interp(0.5, met.probability_by, time) < 5.05
    away = drifting.contact(here + np.array([0.0, 0.5, 0.0]), time, radius_m=0.05)
    assert away.first_s is None and away.probability < 1e-3
    # as a mesh it is met no later
    sphere = trimesh.creation.icosphere(3, 0.05)
    by_mesh = drifting.contact(here, time, mesh_B=sphere)
    assert by_mesh.first_s is not None and by_mesh.first_s <= met.first_s


def test_what_does_not_fit_is_one_line(drifting: KeepOut) -> None:
    p_N, time = np.zeros((3, 3)), np.array([1.0, 2.0, 3.0])
    for ask, words in (
        (partial(drifting.contains, np.zeros(3)), r"points of shape \(3,\)"),
        (partial(drifting.clearance, p_N, time[:2]), "give one, or one for each of the 3"),
        (partial(drifting.clearance, p_N, 11.0), "times must be from 0 to 10 s"),
        (partial(drifting.contact, p_N, time[::-1]), "times: give 3 that increase"),
        (partial(drifting.contact, np.zeros((3, 4)), time), r"poses of shape \(3, 4\)"),
        (partial(drifting.clearance_of_body, trimesh.Trimesh(), p_N), "the mesh has no faces"),
    ):
        with pytest.raises(InputError, match=words):
            ask()


def test_the_volume_of_an_instant_is_closed_and_holds_the_body_of_all_hypotheses() -> None:
    hypotheses = [estimate((0.0, 0.0, w), (0.0, 0.0, 0.0), size=1e-2) for w in (0.5, -0.4)]
    surface = box(0.02)
    found = keep_out_of_all(surface, hypotheses, KeepOutOptions(4.0, 0.97, members=80, cells=24))
    for time_s in (0.0, 2.2, 4.0):
        mesh = found.instant.level(time_s).mesh()
        assert mesh.is_watertight and mesh.is_winding_consistent
        for each in hypotheses:
            there = nominal_motion(each, np.array([time_s])) if time_s else nominal_motion(each, np.zeros(1))
            places = surface.mesh.vertices @ there.R_NG[-1].T + there.p_NG[-1]
            assert found.contains(places, time_s).all() and mesh.contains(places[::7]).all()


def test_its_files_are_read_by_trimesh_numpy_and_fcl(drifting: KeepOut) -> None:
    files = volume_files("keepout", drifting.swept.mesh, drifting.swept_reasons)
    mesh = trimesh.load_mesh(io.BytesIO(files["keepout.ply"]), file_type="ply")
    assert isinstance(mesh, trimesh.Trimesh)
    assert mesh.is_watertight and set(np.unique(mesh.metadata["_ply_raw"]["vertex"]["data"]["reason"])) <= {
        0,
        1,
        2,
    }
    scene = trimesh.load_scene(io.BytesIO(files["keepout.glb"]), file_type="glb")
    assert next(iter(scene.geometry.values())).is_watertight
    with np.load(io.BytesIO(field_npz(drifting.swept.field()))) as field:
        origin, step, distance = field["origin_N"], float(field["step_m"]), field["distance_m"]
    rng = np.random.default_rng(4)
    index = np.stack([rng.integers(0, n, 300) for n in distance.shape], axis=1)
    places = origin + step * index
    exact = drifting.swept.signed_distance(places)
    assert (distance[tuple(index.T)] <= exact + 1e-6).all(), "never more than there is"
    fcl = pytest.importorskip("fcl")
    bvh = fcl.BVHModel()
    bvh.beginModel(len(mesh.vertices), len(mesh.faces))
    bvh.addSubModel(mesh.vertices, mesh.faces)
    bvh.endModel()
    volume = fcl.CollisionObject(bvh)
    for place in places[np.abs(exact) > 0.02][:40]:
        request, result = fcl.DistanceRequest(), fcl.DistanceResult()
        sphere = fcl.CollisionObject(fcl.Sphere(0.005), fcl.Transform(place))
        fcl.distance(sphere, volume, request, result)
        own = drifting.clearance(place[None], radius_m=0.005).distance_m[0]
        if own > 0.0:
            assert own <= result.min_distance + 1e-4
