"""Bodies: shape, mass and surface."""

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.bodies.solids import smooth_corner_normals
from polhode.simulation.rendering.appearance import SurfaceAppearance, chart_atlas, look_up
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.surface.materials import PAINT_WHITE, Surface

FAMILIES = ["free_flyer", "bus", "asteroid"]


def _build(family: str, seed: int = 1, **more: object) -> Body:
    return build_body(config.TargetBody.model_validate({"family": family, **more}), seed)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_seed_gives_the_same_body_and_another_seed_another(family: str) -> None:
    one, same, other = _build(family, 1), _build(family, 1), _build(family, 2)
    np.testing.assert_array_equal(one.mesh.vertices, same.mesh.vertices)
    drawings = [[chart.image for chart in body.charts] for body in (one, same, other)]
    assert all((a == b).all() for a, b in zip(drawings[0], drawings[1], strict=True))
    moved = (
        one.mesh.vertices.shape != other.mesh.vertices.shape
        or (one.mesh.vertices != other.mesh.vertices).any()
    )
    redrawn = any(
        a.shape != b.shape or (a != b).any() for a, b in zip(drawings[0], drawings[2], strict=False)
    )
    assert moved or redrawn


def test_the_bodys_own_seed_stands_above_the_configs() -> None:
    own = config.TargetBody(family="bus", seed=9)
    np.testing.assert_array_equal(build_body(own, 1).mesh.vertices, build_body(own, 2).mesh.vertices)


def _seen(texture_seed: int | None) -> tuple[Body, Surface]:
    """A body, and its surface where rays along z meet it."""
    described = config.TargetBody(family="bus", seed=5, texture_seed=texture_seed)
    body = build_body(described, 1)
    middle, reach = body.mesh.vertices.mean(axis=0), 3.0 * body.radius_m
    across = np.linspace(-0.2, 0.2, 12) * body.radius_m
    start = middle + np.stack([*np.meshgrid(across, across), np.full((12, 12), -reach)], axis=2).reshape(
        -1, 3
    )
    caster = RayCaster(body)
    hits = [caster.first_hits(each, np.array([[0.0, 0.0, 1.0]])) for each in start]
    table = SurfaceAppearance(body, described, 1)
    surfaces = [table.at(each) for each in hits]
    return body, Surface(
        *(
            np.concatenate([getattr(each, name) for each in surfaces])
            for name in ("albedo", "specular", "roughness", "normal_G")
        )
    )


def test_a_texture_seed_changes_the_surface_and_not_the_shape() -> None:
    (body, surface), (same, same_surface), (other, other_surface) = _seen(None), _seen(5), _seen(6)
    for each in (same, other):
        np.testing.assert_array_equal(each.mesh.vertices, body.mesh.vertices)
        np.testing.assert_array_equal(each.mesh.faces, body.mesh.faces)
    np.testing.assert_array_equal(same_surface.albedo, surface.albedo)
    np.testing.assert_array_equal(same_surface.normal_G, surface.normal_G)
    assert len(surface.albedo) > 50
    assert np.mean(other_surface.albedo != surface.albedo) > 0.5
    drawings = [[chart.image for chart in each.charts] for each in (body, same, other)]
    assert all((a == b).all() for a, b in zip(drawings[0], drawings[1], strict=True))
    assert [a.shape for a in drawings[0]] == [c.shape for c in drawings[2]]
    assert any((a != c).any() for a, c in zip(drawings[0], drawings[2], strict=True))


def test_the_free_flyers_shell_has_18_faces_with_different_drawings() -> None:
    body = _build("free_flyer", size_m=0.22)
    shell_charts = body.charts[:18]
    normals = np.array([np.cross(chart.right_G, -chart.down_G) for chart in shell_charts])
    distances = np.einsum("nk,nk->n", normals, [chart.origin_G for chart in shell_charts])
    np.testing.assert_allclose(np.sort(np.abs(distances)), [0.11] * 6 + [0.545 * 0.22] * 12)
    assert len(np.unique(np.round(normals, 6), axis=0)) == 18
    images = [chart.image for chart in _build("free_flyer").charts]
    same = [a.shape == b.shape and (a == b).all() for i, a in enumerate(images) for b in images[:i]]
    assert not any(same)


def test_the_asteroid_has_the_volume_of_a_sphere_of_its_size() -> None:
    body = _build("asteroid", size_m=0.3)
    assert body.mesh.volume == pytest.approx(np.pi / 6 * 0.3**3)
    assert body.mesh.is_watertight


def test_mass_of_joined_parts_is_that_of_the_closed_form() -> None:
    """Two boxes end to end are one long box."""
    halves = []
    for x in (-0.1, 0.1):
        box = trimesh.creation.box([0.2, 0.1, 0.05])
        box.apply_translation([x + 0.03, 0, 0])
        halves.append(Part(box, PAINT_WHITE))
    body = assemble(halves)
    m = 0.4 * 0.1 * 0.05
    a2, b2, c2 = 0.4**2, 0.1**2, 0.05**2
    assert body.volume_m3 == pytest.approx(m)
    np.testing.assert_allclose(body.com_G, [0.03, 0, 0], atol=1e-12)
    np.testing.assert_allclose(
        body.inertia_per_density, m / 12 * np.diag([b2 + c2, a2 + c2, a2 + b2]), atol=1e-15
    )


def test_masses_of_the_names_add_up_to_the_bodys() -> None:
    body = _build("free_flyer")
    assert len({part.name for part in body.parts}) == len(body.parts)
    assert {"shell", "tank", "thruster"} <= {part.name for part in body.parts}
    weights = np.array([part.volume_m3 * part.density_factor for part in body.parts])
    assert weights.sum() == pytest.approx(body.volume_m3)
    np.testing.assert_allclose(weights @ [part.com_G for part in body.parts] / weights.sum(), body.com_G)
    about_origin = np.zeros((3, 3))
    for weight, part in zip(weights, body.parts, strict=True):
        p = part.com_G
        about_origin += part.density_factor * part.inertia_per_density
        about_origin += weight * (p @ p * np.eye(3) - np.outer(p, p))
    p = body.com_G
    whole = body.inertia_per_density + body.volume_m3 * (p @ p * np.eye(3) - np.outer(p, p))
    np.testing.assert_allclose(about_origin, whole, atol=1e-12 * np.abs(whole).max())


def test_normals_are_smooth_on_a_ball_and_flat_on_a_box() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners = smooth_corner_normals(ball)
    assert np.einsum("fck,fck->fc", corners, ball.vertices[ball.faces]).min() > np.cos(np.deg2rad(1.0))
    box = trimesh.creation.box()
    np.testing.assert_allclose(smooth_corner_normals(box), np.repeat(box.face_normals[:, None], 3, axis=1))


def test_charts_are_read_where_and_as_they_were_drawn() -> None:
    body = _build("free_flyer")
    atlas = chart_atlas(body.charts)
    for index in (0, 7, 20):
        chart = body.charts[index]
        row, column = (size // 2 for size in chart.image.shape)
        p_G = chart.origin_G + chart.texel_m * (column * chart.right_G + row * chart.down_G)
        read, _, _ = look_up(np.array([index, -1]), np.stack([p_G, p_G]), atlas)
        assert read[0] == pytest.approx(chart.image[row, column], abs=1e-6)
        assert np.isnan(read[1])
    body = _build("free_flyer")
    for index, chart in enumerate(body.charts):
        outward = body.mesh.face_normals[np.flatnonzero(body.face_chart == index)[0]]
        # Right, down and the viewing direction (inwards) are right-handed, as in an image.
        assert np.cross(chart.right_G, chart.down_G) @ -outward == pytest.approx(1.0)
