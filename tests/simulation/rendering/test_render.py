"""Rays, surfaces and pictures: hits, shadows, drawings read back where light meets them, motion blur."""

from functools import cache

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints, exp_so3, make_pose
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.part import SLOPE_STEP, Chart, Part, assemble
from polhode.simulation.bodies.solids import box, flat_facets, revolve
from polhode.simulation.bodies.textures.canvas import Canvas, chart_of_facet, charts_around, code
from polhode.simulation.rendering.appearance import SurfaceAppearance, chart_atlas, look_up
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.rendering.sampling import Stratum, rays_over_disc
from polhode.simulation.stereo_camera import build_cameras
from polhode.simulation.surface.materials import (
    FOIL_GOLD,
    FOIL_SILVER,
    GLASS,
    PAINT_GREY,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
    Surface,
)


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


@pytest.mark.parametrize("subdivisions", [1, 4])
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


TEXEL_M = 0.001
RIGHT, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])


def _chart(**more: object) -> Chart:
    image = np.linspace(0.1, 0.9, 20, dtype=np.float32).reshape(4, 5)
    return Chart(np.array([0.1, 0.2, 0.3]), RIGHT, DOWN, TEXEL_M, image, **more)  # type: ignore[arg-type]


def _at(chart: Chart, row: float, column: float) -> Array:
    return np.asarray(chart.origin_G + TEXEL_M * (column * chart.right_G + row * chart.down_G))[None]


def test_reflectance_relief_and_layers_are_read_from_a_chart() -> None:
    chart = _chart()
    atlas = chart_atlas((chart,))
    read = look_up(np.zeros(1, np.int64), _at(chart, 1.25, 2.5), atlas)[0][0]
    (a, b), (c, d) = chart.image[1:3, 2:4]
    assert read == pytest.approx(0.75 * (0.5 * a + 0.5 * b) + 0.25 * (0.5 * c + 0.5 * d), abs=1e-6)
    slope = np.zeros((4, 5, 2), np.int8)
    slope[..., 0], slope[..., 1] = 30, -20
    atlas = chart_atlas((_chart(slope=slope),))
    _, slope_G, _ = look_up(np.zeros(1, np.int64), _at(_chart(), 1, 1), atlas)
    np.testing.assert_allclose(slope_G[0], SLOPE_STEP * (30 * RIGHT - 20 * DOWN), atol=1e-12)
    layer = np.zeros((4, 5), np.uint8)
    layer[1, 2] = 2
    chart = _chart(layer=layer, materials=(GLASS, FOIL_GOLD))
    points = np.vstack([_at(chart, 1.4, 2.4), _at(chart, 1.6, 2.4), _at(chart, 1.4, 1.4)])
    _, _, layers = look_up(np.array([0, 0, 0]), points, chart_atlas((chart,)))
    np.testing.assert_array_equal(layers, [2, 0, 0])
    reflectance, slope_G, layers = look_up(np.array([-1]), np.zeros((1, 3)), chart_atlas((_chart(),)))
    assert np.isnan(reflectance[0]) and not slope_G.any() and layers[0] == 0


def test_rows_run_along_the_direction_that_is_asked_for() -> None:
    mesh = box([0.1, 0.2, 0.3], bevel=0.0)
    faces = next(f for f in flat_facets(mesh) if mesh.face_normals[f[0], 0] > 0.99)
    chart, _ = chart_of_facet(mesh, faces, 0.005, lambda canvas: None, np.random.default_rng(0), DOWN)
    np.testing.assert_allclose(chart.down_G, DOWN, atol=1e-12)
    # Seen from outside, +x towards the viewer and z up, right is +y.
    np.testing.assert_allclose(chart.right_G, RIGHT, atol=1e-12)


def _ramp(canvas: Canvas) -> None:
    """Brighter to the right, so that any jump between slices would show; a wrap at the end."""
    height, width = canvas.shape
    wave = 0.4 + 0.3 * np.cos(2 * np.pi * (np.arange(width) + 0.5) / width)
    canvas.code[:] = [code(float(value)) for value in wave]
    canvas.code[: height // 2] = (canvas.code[: height // 2] * 0.8).astype(np.uint8)


@pytest.mark.parametrize("top", [0.1, 0.06])
def test_a_drawing_around_a_wall_goes_on_across_its_panels(top: float) -> None:
    """Cylinder and cone: on either side of each edge the two charts read the same."""
    solid = revolve([(0, 0), (0.1, 0), (top, 0.2), (0, 0.2)], 24)
    charts = charts_around(solid, 1, 2, 0.002, _ramp, np.random.default_rng(0))
    atlas = chart_atlas(tuple(chart for chart, _ in charts))
    number = np.arange(24)
    for share in (0.2, 0.45, 0.8):
        edges = solid.mesh.triangles[solid.panels[1, :, 0]][:, 1]
        ends = solid.mesh.triangles[solid.panels[1, :, 0]][:, 2]
        points = edges + share * (ends - edges)
        # The edge at the end of panel k is the start of panel k + 1.
        one, _, _ = look_up(number, points, atlas)
        other, _, _ = look_up((number + 1) % 24, points, atlas)
        np.testing.assert_allclose(one, other, atol=0.02)
        assert np.ptp(one) > 0.2


def test_a_wall_reads_the_right_way_round_from_outside() -> None:
    solid = revolve([(0, 0), (0.1, 0), (0.1, 0.2), (0, 0.2)], 16)
    for chart, faces in charts_around(solid, 1, 2, 0.004, _ramp, np.random.default_rng(0)):
        outward = solid.mesh.face_normals[faces[0]]
        assert np.cross(chart.right_G, chart.down_G) @ -outward == pytest.approx(1.0)
        assert chart.down_G[2] == pytest.approx(-1.0)
        # The lower half of the wall is the lower, brighter half of the drawing.
        assert chart.image[-3].mean() > chart.image[2].mean()


def _hits(face: Ints, p_G: Array, normal_G: Array) -> Hits:
    n = len(face)
    return Hits(np.arange(n), face, np.full((n, 3), 1 / 3), np.zeros(n), p_G, normal_G, normal_G)


def _on_all_faces(body: Body, description: config.TargetBody) -> Surface:
    face = np.arange(len(body.mesh.faces))
    centres, normals = np.asarray(body.mesh.triangles_center), np.asarray(body.mesh.face_normals)
    return SurfaceAppearance(body, description, 0).at(_hits(face, centres, normals))


def test_a_layer_of_a_drawing_brings_its_own_material_and_slope() -> None:
    mesh = trimesh.creation.box([1.0, 1.0, 1.0])
    top = np.flatnonzero(mesh.face_normals[:, 2] > 0.9)
    image, layer = np.full((11, 11), 0.5, np.float32), np.zeros((11, 11), np.uint8)
    layer[:, 6:] = 1
    slope = np.full((11, 11, 2), 10, np.int8)
    corner, right, down = np.array([-0.5, 0.5, 0.5]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    chart = Chart(corner, right, down, 0.1, image, slope, layer, (GLASS,))
    body = assemble([Part(mesh, PAINT_GREY, ((chart, top),))])
    points = np.array([[-0.3, 0.0, 0.5], [0.3, 0.0, 0.5]])
    up = np.tile([0.0, 0.0, 1.0], (2, 1))
    appearance = SurfaceAppearance(body, config.TargetBody(contrast=0.0), 0)
    surface = appearance.at(_hits(top[[0, 0]], points, up))
    np.testing.assert_allclose(surface.specular, [PAINT_GREY.specular, GLASS.specular])
    # Without contrast there is the part's own reflectance everywhere.
    np.testing.assert_allclose(surface.albedo, PAINT_GREY.albedo)
    bent = np.array([-10 * SLOPE_STEP, 10 * SLOPE_STEP, 1.0])
    np.testing.assert_allclose(surface.normal_G[0], bent / np.linalg.norm(bent), atol=1e-9)


@cache
def _bus(material: str) -> tuple[Body, config.TargetBody]:
    description = config.TargetBody.model_validate({"family": "bus", "material": material, "seed": 4})
    return build_body(description, 0), description


def test_a_bus_all_in_foil_keeps_its_cells_and_regolith_covers_everything() -> None:
    body, description = _bus("foil")
    own = {body.materials[m] for m in np.unique(body.face_material)}
    assert own <= {FOIL_SILVER, SOLAR_CELL, GLASS} and FOIL_SILVER in own and SOLAR_CELL in own
    shiny = _on_all_faces(body, description).specular == FOIL_SILVER.specular
    assert body.mesh.area_faces[shiny].sum() > 0.2 * body.mesh.area
    body, _ = _bus("regolith")
    assert body.materials == (REGOLITH,) and body.charts == ()


SCENE = config.Scene(
    rig=config.Rig(width_px=96, height_px=72, focal_px=90.0), render=config.Render(samples=4, bounces=0)
)
LEFT, _ = build_cameras(SCENE.rig)
X_NG = make_pose(np.eye(3), [0.0, 0.0, 0.6])


@cache
def _flyer() -> Body:
    return build_body(SCENE.body, 3)


def test_one_pose_per_sample_averages_the_pictures_and_motion_together_keeps_the_outline() -> None:
    """A body that jumps between two places for half of the samples each covers both, by halves.

    Camera and body move together: the outline stays, only the light turns.
    """
    renderer = Renderer(_flyer(), SCENE, 3)
    shifts = np.array([-0.14, -0.14, 0.14, 0.14])
    moving = np.stack([make_pose(np.eye(3), [x, 0.0, 0.6]) for x in shifts])
    blurred = renderer.picture(LEFT, np.eye(4), moving)
    assert blurred.covered.max() <= 0.5
    ends = [renderer.picture(LEFT, np.eye(4), pose) for pose in moving[::2]]
    expected = [0.5 * picture.covered.sum() for picture in ends]
    assert abs(blurred.covered.sum() / sum(expected) - 1.0) < 0.01
    assert abs(blurred.level.sum() / sum(0.5 * picture.level.sum() for picture in ends) - 1.0) < 0.02
    renderer = Renderer(_flyer(), SCENE, 3)
    repeated = np.broadcast_to(X_NG, (4, 4, 4))
    still, held = renderer.picture(LEFT, np.eye(4), X_NG), renderer.picture(LEFT, np.eye(4), repeated)
    np.testing.assert_array_equal(still.level, held.level)
    renderer = Renderer(_flyer(), SCENE, 3)
    turn = np.stack([make_pose(np.eye(3), [x, 0.0, 0.0]) for x in (-0.3, -0.1, 0.1, 0.3)])
    still, moved = renderer.picture(LEFT, np.eye(4), X_NG), renderer.picture(LEFT, turn, turn @ X_NG)
    np.testing.assert_allclose(moved.covered, still.covered, atol=0.26)
    np.testing.assert_allclose(moved.level.sum(), still.level.sum(), rtol=1e-3)


def test_a_picture_does_not_depend_on_what_was_rendered_before() -> None:
    """Indirect light is kept from picture to picture; the next picture must not show it."""
    scene = SCENE.model_copy(update={"render": config.Render(samples=4, bounces=1)})
    used, fresh = (Renderer(_flyer(), scene, 3) for _ in range(2))
    turned = make_pose(exp_so3([0.0, 0.002, 0.0]), [0.0, 0.0, 0.6])
    used.picture(LEFT, np.eye(4), turned)
    for renderer in (used, used, fresh):
        picture = renderer.picture(LEFT, np.eye(4), X_NG)
        assert picture.level.tobytes() == fresh.picture(LEFT, np.eye(4), X_NG).level.tobytes()


def test_scattered_rays_show_the_same_body_and_the_same_picture_twice() -> None:
    rows = SCENE.model_copy(update={"render": config.Render(samples=4, bounces=0, scattered=False)})
    body = _flyer()
    regular = Renderer(body, rows, 3).picture(LEFT, np.eye(4), X_NG)
    first, again = (Renderer(body, SCENE, 3).picture(LEFT, np.eye(4), X_NG) for _ in range(2))
    np.testing.assert_array_equal(first.level, again.level)
    assert abs(first.covered.sum() / regular.covered.sum() - 1.0) < 0.02
    inside = (first.covered == 1.0) & (regular.covered == 1.0)
    assert np.median(np.abs(first.level - regular.level)[inside]) < 0.02
    assert (first.level != regular.level).any()
