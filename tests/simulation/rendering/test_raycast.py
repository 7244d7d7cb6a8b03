"""Hits against closed forms."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array
from polhode.simulation.bodies import Body
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.sampling import Stratum, rays_over_disc
from polhode.simulation.surface.materials import PAINT_WHITE


def _sphere_body(radius_m: float, subdivisions: int = 5) -> Body:
    return assemble(
        [Part(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m), PAINT_WHITE)]
    )


def test_distance_to_a_sphere_is_that_of_the_closed_form() -> None:
    caster = RayCaster(_sphere_body(0.1, 6))
    directions = np.random.default_rng(0).normal((0, 0, 1), 0.05, (400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = caster.first_hits(np.array([0.0, 0.0, -0.6]), directions)
    along = 0.6 * directions[hits.ray, 2]
    exact = along - np.sqrt(0.1**2 - 0.6**2 + along**2)
    central = directions[hits.ray, 2] > np.cos(0.13)
    assert np.abs(hits.distance_m - exact)[central].max() < 5e-5  # the facets' sagitta
    radial = hits.p_G / np.linalg.norm(hits.p_G, axis=1, keepdims=True)
    assert np.einsum("nk,nk->n", hits.normal_G, radial).min() > np.cos(np.deg2rad(0.2))


def test_normals_face_the_viewer_on_a_mesh_wound_inside_out() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    mesh.invert()
    hits = RayCaster(assemble([Part(mesh, PAINT_WHITE)])).first_hits(
        np.array([0, 0, -0.6]), np.array([[0, 0, 1.0]])
    )
    assert hits.flat_normal_G[0, 2] < -0.99
    assert hits.normal_G[0, 2] < -0.99


def test_a_ball_or_a_roof_shades_what_is_behind_it_and_nothing_else() -> None:
    plate = trimesh.creation.box([1.0, 1.0, 0.01])
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    ball.apply_translation([0, 0, 0.3])
    caster = RayCaster(assemble([Part(plate, PAINT_WHITE), Part(ball, PAINT_WHITE)]))
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    for radius, shaded in [(0.097, True), (0.103, False)]:
        origin = np.array([0.0, 0.0, 0.1])
        rays = ring * radius + [0, 0, 0.005] - origin
        hits = caster.first_hits(origin, rays / np.linalg.norm(rays, axis=1, keepdims=True))
        assert len(hits.ray) == 60
        assert (caster.lit(hits, np.array([0.0, 0.0, 1.0])) != shaded).all()
    plate = trimesh.creation.box([1.0, 1.0, 0.01])
    roof = trimesh.creation.box([1.0, 1.0, 0.01])
    roof.apply_translation([0, 0, 0.5])
    caster = RayCaster(assemble([Part(plate, PAINT_WHITE), Part(roof, PAINT_WHITE)]))
    hits = caster.first_hits(np.array([0.0, 0.0, 0.2]), np.array([[0.0, 0.0, -1.0]]))
    up = np.array([0.0, 0.0, 1.0])
    assert caster.lit(hits, up, np.array([0.3])).all()
    assert not caster.lit(hits, up, np.array([0.7])).any()


def _beam_hits(caster: RayCaster, from_G: Array, width_m: float) -> Hits:
    """Hits of a pencil of rays that spreads from a point towards the origin."""
    rng = np.random.default_rng(3)
    toward = -from_G + rng.uniform(-width_m, width_m, (4000, 3))
    return caster.first_hits(from_G, toward / np.linalg.norm(toward, axis=1, keepdims=True))


@pytest.mark.parametrize("subdivisions", [1, 2, 4])
@pytest.mark.parametrize("turned_inside_out", [False, True])
def test_the_terminator_of_a_smooth_ball_follows_its_normals(
    subdivisions: int, turned_inside_out: bool
) -> None:
    """However few faces stand for the ball, it is lit where its interpolated normals face the Sun."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    if turned_inside_out:
        mesh.invert()
    caster = RayCaster(assemble([Part(mesh, PAINT_WHITE)]))
    hits = _beam_hits(caster, np.array([0.5, 0.1, 0.2]), 0.1)
    for sun in np.array([[0.0, 0.0, 1.0], [-0.6, 0.0, 0.8], [0.3, -0.95, 0.08]]):
        sun /= np.linalg.norm(sun)
        faces_sun = hits.normal_G @ sun
        lit = caster.lit(hits, sun)
        assert not lit[faces_sun <= 0].any()
        assert lit[faces_sun > 0.02].mean() > 0.998


def test_a_neighbour_shades_a_smooth_ball_up_to_its_terminator() -> None:
    """Faces that turn away early are lit by way of the round surface, but not through other parts."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    roof = trimesh.creation.box([0.6, 0.6, 0.01])
    roof.apply_translation([0, 0, 0.3])
    caster = RayCaster(assemble([Part(ball, PAINT_WHITE), Part(roof, PAINT_WHITE)]))
    hits = _beam_hits(caster, np.array([0.5, 0.1, 0.02]), 0.1)
    assert not caster.lit(hits[hits.p_G[:, 2] < 0.2], np.array([0.0, 0.0, 1.0])).any()


def test_the_penumbra_of_an_edge_holds_the_visible_share_of_the_suns_disc() -> None:
    """A roof 0.4 m above a floor, its edge at x = 0, under a Sun of 4 degrees: 28 mm of half shadow."""
    roof = trimesh.creation.box([1.0, 4.0, 1e-4])
    roof.apply_translation([-0.5, 0.0, 0.4])
    floor = trimesh.creation.box([2.0, 2.0, 0.01])
    floor.apply_translation([0.0, 0.0, -0.005])
    caster = RayCaster(assemble([Part(floor, PAINT_WHITE), Part(roof, PAINT_WHITE)]))
    radius_rad, up = np.deg2rad(2.0), np.array([0.0, 0.0, 1.0])
    width_m = 0.4 * np.tan(radius_rad)
    places = np.linspace(-1.2, 1.2, 25)
    x = np.repeat(places * width_m, 200)
    rays = np.stack([x, np.zeros_like(x), np.full_like(x, -0.3)], axis=1)
    hits = caster.first_hits(np.array([0.0, 0.0, 0.3]), rays / np.linalg.norm(rays, axis=1, keepdims=True))
    strata = [Stratum(np.arange(len(x)), i, 16) for i in range(16)]
    lit = np.mean([caster.lit(hits, rays_over_disc(up, radius_rad, stratum)) for stratum in strata], axis=0)
    clipped = np.clip(places, -1.0, 1.0)
    share = 1.0 - (np.arccos(clipped) - clipped * np.sqrt(1.0 - clipped**2)) / np.pi
    np.testing.assert_allclose(lit.reshape(25, 200).mean(axis=1), share, atol=0.015)
