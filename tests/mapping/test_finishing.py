"""The finished mesh: Sun and albedo of renderings, lighter meshes, and holes closed as closed forms say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from polhode.geometry.lie import Array, Bools
from polhode.mapping.finishing.albedo import divide_shading
from polhode.mapping.finishing.detail_levels import levels_of
from polhode.mapping.finishing.hole_closing import boundary_loops, close_small_holes, fill_loop
from polhode.mapping.mesh_files import read_ply, write_glb, write_ply
from polhode.mapping.visibility import FrameView
from polhode.records.surface import SurfaceModel
from tests.mapping.rendered_views import RIG, rendered, tumbling


def colours_of(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    assert isinstance(mesh.visual, ColorVisuals)
    return np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)


def surface_of(mesh: trimesh.Trimesh) -> SurfaceModel:
    rgba = np.tile(np.array([90, 90, 90, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)
    n = len(mesh.vertices)
    return SurfaceModel(coloured, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


# --- albedo and Sun ---


SUN = np.array([0.55, -0.5, -0.67]) / np.linalg.norm([0.55, -0.5, -0.67])
FRAMES = 24


def albedo(p_G: Array) -> Array:
    return np.asarray(140.0 + 60.0 * np.sin(70.0 * p_G[:, 0]) * np.cos(50.0 * p_G[:, 1] + 40.0 * p_G[:, 2]))


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(4, 0.09)
    return mesh


@pytest.fixture(scope="module")
def views(ball: trimesh.Trimesh) -> list[FrameView]:
    return [rendered(ball, X_RG, SUN, albedo, ambient=0.08) for X_RG in tumbling(FRAMES)]


def lit_and_seen(ball: trimesh.Trimesh, views: list[FrameView]) -> Bools:
    """(V,) vertices that some frame saw well in good light."""
    normal = np.asarray(ball.vertex_normals)
    found = np.zeros(len(normal), dtype=bool)
    for view in views:
        to_eye = view.eye_G - ball.vertices
        cosine = np.einsum("nk,nk->n", normal, to_eye) / np.linalg.norm(to_eye, axis=1)
        found |= (cosine > 0.35) & (normal @ view.X_RG[:3, :3].T @ SUN > 0.35)
    return found


def degrees_between(a: Array, b: Array) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def test_sun_and_texture_of_a_lambert_sphere_are_recovered(
    ball: trimesh.Trimesh, views: list[FrameView]
) -> None:
    found = divide_shading(surface_of(ball), views, RIG)
    assert found.divided and found.sun is not None
    assert degrees_between(found.sun.direction_N, SUN) < 2.0
    assert degrees_between(found.sun.direction_N, SUN) < 3.0 * np.rad2deg(found.sun.sigma_rad)
    assert found.sun.explained > 0.8 and found.sun.ambient[0] == pytest.approx(0.08, abs=0.04)
    grey = colours_of(found.surface.mesh)[:, 0] / found.grey_per_albedo
    # facing the Sun there was the light from around too
    error = grey / (1.08 * albedo(np.asarray(ball.vertices))) - 1.0
    errors = np.abs(error[lit_and_seen(ball, views)])
    assert len(errors) > 0.5 * len(error)
    assert np.median(errors) < 0.01 and np.percentile(errors, 95) < 0.05


def test_frames_in_a_planets_shadow_do_not_count(ball: trimesh.Trimesh, views: list[FrameView]) -> None:
    dark = [k % 4 == 3 for k in range(FRAMES)]
    eclipsed = [
        replace(view, image=(view.image * 0.07).astype(np.uint8)) if out else view
        for view, out in zip(views, dark, strict=True)
    ]
    found = divide_shading(surface_of(ball), eclipsed, RIG)
    assert found.divided and found.sun is not None
    assert found.sun.sunny.tolist() == [not out for out in dark]
    assert degrees_between(found.sun.direction_N, SUN) < 2.0


def test_colours_stay_where_no_sun_explains_them(ball: trimesh.Trimesh, views: list[FrameView]) -> None:
    random = np.random.default_rng(3)
    odd = [replace(view, image=random.integers(20, 220, view.image.shape, dtype=np.uint8)) for view in views]
    given = surface_of(ball)
    found = divide_shading(given, odd, RIG)
    assert not found.divided and found.surface is given and found.grey_per_albedo == 1.0
    # few frames or no surface determine nothing
    assert divide_shading(surface_of(ball), views[:1], RIG).sun is None
    empty = SurfaceModel(trimesh.Trimesh(), np.zeros(0), np.zeros(0, dtype=np.int64))
    assert divide_shading(empty, views, RIG).sun is None


# --- detail levels ---


RADIUS_M = 0.1


@pytest.fixture(scope="module")
def surface() -> SurfaceModel:
    ball = trimesh.creation.icosphere(5, RADIUS_M)
    n = len(ball.vertices)
    grey = np.round(127.0 + 1000.0 * ball.vertices[:, 2]).astype(np.uint8)
    rgba = np.column_stack([grey, grey, grey, np.full(n, 255, dtype=np.uint8)])
    mesh = trimesh.Trimesh(ball.vertices, ball.faces, vertex_colors=rgba, process=False)
    invented = mesh.triangles_center[:, 2] > 0.09
    sigma_m = np.where(ball.vertices[:, 2] > 0.092, np.inf, 1e-3)
    return SurfaceModel(mesh, sigma_m, np.full(n, 5, dtype=np.int64), invented)


def test_a_sphere_keeps_its_shape_with_fewer_faces(surface: SurfaceModel, tmp_path: Path) -> None:
    levels = levels_of(surface, (0.25, 0.0625))
    assert [len(level.surface.mesh.faces) for level in levels] == [5120, 1280]
    for level in levels:
        mesh = level.surface.mesh
        # a chord of a sphere is off by its edge squared over eight radii
        sagitta_m = float(np.max(mesh.edges_unique_length)) ** 2 / (8.0 * RADIUS_M)
        assert 0.0 < level.mean_m < level.largest_m < 3.0 * sagitta_m
        assert mesh.is_volume and mesh.volume == pytest.approx(surface.mesh.volume, rel=0.01)
    assert levels[0].mean_m < levels[1].mean_m
    # colours sigma and invention come along
    light = levels_of(surface, (0.25,))[0].surface
    z = light.mesh.vertices[:, 2]
    grey = colours_of(light.mesh)[:, 0].astype(float)
    assert np.abs(grey - (127.0 + 1000.0 * z)).max() < 6.0
    assert np.all(np.isinf(light.sigma_m[z > 0.096])) and np.all(np.isfinite(light.sigma_m[z < 0.088]))
    middle = light.mesh.triangles_center[:, 2]
    assert np.all(light.is_invented[middle > 0.094]) and not np.any(light.is_invented[middle < 0.086])
    # a level that would be too light is left out
    assert len(levels_of(surface, (0.5, 0.001))) == 1
    assert levels_of(surface, ()) == []
    # the same mesh gives the same bytes
    for name in ("a", "b"):
        write_glb(levels_of(surface, (0.25,))[0].surface, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_mesh_read_from_its_file_has_the_same_levels(surface: SurfaceModel, tmp_path: Path) -> None:
    noise = np.random.default_rng(4).normal(scale=1e-4, size=surface.mesh.vertices.shape)
    rough = surface.mesh.copy()
    rough.vertices = rough.vertices + noise
    whole = SurfaceModel(rough, surface.sigma_m, surface.views, surface.invented)
    write_ply(whole, tmp_path / "mesh.ply")
    for ours, theirs in zip(
        levels_of(whole, (0.25, 0.0625)),
        levels_of(read_ply(tmp_path / "mesh.ply"), (0.25, 0.0625)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours.surface.mesh.vertices, theirs.surface.mesh.vertices)
        np.testing.assert_array_equal(ours.surface.mesh.faces, theirs.surface.mesh.faces)


# --- holes ---


def box() -> trimesh.Trimesh:
    solid: trimesh.Trimesh = trimesh.creation.box((0.1, 0.1, 0.1))
    for _ in range(4):
        solid = solid.subdivide()
    return solid


def without(mesh: trimesh.Trimesh, middle: tuple[float, float, float], radius_m: float) -> trimesh.Trimesh:
    """The mesh with a hole: faces whose middle is that near are gone, and vertices without a face."""
    kept = np.linalg.norm(mesh.triangles_center - np.array(middle), axis=1) > radius_m
    used, faces = np.unique(np.asarray(mesh.faces)[kept], return_inverse=True)
    return trimesh.Trimesh(mesh.vertices[used], faces.reshape(-1, 3), process=False)


def test_a_hole_in_a_flat_side_is_closed_to_the_area_that_was_cut() -> None:
    whole, opened = box(), without(box(), (0.05, 0.01, 0.0), 0.015)
    found = close_small_holes(surface_of(opened), 0.04)
    mesh, invented = found.surface.mesh, found.surface.is_invented
    assert (found.closed, found.left_open) == (1, 0)
    assert mesh.is_volume and mesh.volume == pytest.approx(whole.volume, rel=1e-9)
    assert mesh.area_faces[invented].sum() == pytest.approx(whole.area - opened.area, rel=1e-9)
    # what was measured stays as it is, and is distinguished
    assert not invented[: len(opened.faces)].any() and invented[len(opened.faces) :].all()
    new = np.arange(len(mesh.vertices)) >= len(opened.vertices)
    assert new.any()
    assert np.all(found.surface.views[new] == 0) and np.all(np.isinf(found.surface.sigma_m[new]))
    assert np.all(found.surface.views[~new] == 5) and np.all(found.surface.sigma_m[~new] == 1e-3)


def test_small_holes_over_edges_and_corners_are_closed_and_large_ones_are_not() -> None:
    for middle in ((0.05, 0.05, 0.01), (0.05, 0.05, 0.05)):
        opened = without(box(), middle, 0.014)
        found = close_small_holes(surface_of(opened), 0.05)
        assert found.closed == 1 and found.surface.mesh.is_volume
        assert found.surface.mesh.volume == pytest.approx(1e-3, rel=0.01)
    # a large hole stays open
    large = surface_of(without(box(), (0.05, 0.0, 0.0), 0.035))
    found = close_small_holes(large, 0.04)
    assert found.closed == 0 and len(found.surface.mesh.faces) == len(large.mesh.faces)
    assert not found.surface.is_invented.any()
    # a sphere gets its volume back
    ball = trimesh.creation.icosphere(5, 0.05)
    found = close_small_holes(surface_of(without(ball, (0.05, 0.0, 0.0), 0.01)), 0.03)
    assert found.surface.mesh.is_volume
    assert found.surface.mesh.volume == pytest.approx(ball.volume, rel=2e-3)


def test_holes_that_touch_in_a_point_are_two() -> None:
    grid = box()
    corner = int(np.argmin(np.linalg.norm(grid.vertices - np.array([0.05, 0.0, 0.0]), axis=1)))
    around = np.flatnonzero((np.asarray(grid.faces) == corner).any(axis=1))
    side = np.sign(grid.triangles_center[around][:, 1:])
    gone = around[(side[:, 0] == side[:, 1])]
    opened = trimesh.Trimesh(grid.vertices, np.delete(np.asarray(grid.faces), gone, axis=0), process=False)
    assert len(boundary_loops(np.asarray(opened.faces))) == 2
    found = close_small_holes(surface_of(opened), 0.05)
    assert found.closed == 2 and found.surface.mesh.is_volume


def test_the_outline_of_a_scrap_or_of_a_face_that_hangs_by_a_corner_is_no_hole() -> None:
    scrap = trimesh.creation.box((0.02, 0.02, 0.02)).subdivide()
    scrap = trimesh.Trimesh(scrap.vertices, scrap.faces[scrap.triangles_center[:, 0] > 0.009], process=False)
    scrap.apply_translation([0.2, 0.0, 0.0])
    both = trimesh.util.concatenate([box(), scrap])
    assert isinstance(both, trimesh.Trimesh)
    found = close_small_holes(surface_of(both), 0.05)
    assert found.closed == 0 and found.left_open == 1
    # a face that hangs by a corner is no hole
    whole = box()
    n = len(whole.vertices)
    tip = whole.vertices[0]
    more = np.vstack([whole.vertices, tip + np.array([4e-3, 0.0, 4e-3]), tip + np.array([0.0, 4e-3, 4e-3])])
    hanging = trimesh.Trimesh(more, np.vstack([whole.faces, [0, n, n + 1]]), process=False)
    found = close_small_holes(surface_of(hanging), 0.04)
    assert (found.closed, found.left_open) == (0, 0)
    assert not found.surface.is_invented.any()


def test_a_window_that_frames_look_through_stays_open() -> None:
    # The front of a thin frame alone: its inner outline is small, but behind it is the sky.
    plate = trimesh.creation.box((0.1, 0.1, 0.002))
    for _ in range(5):
        plate = plate.subdivide()
    front = plate.triangles_center[:, 2] < -0.00099
    framed = without(
        trimesh.Trimesh(plate.vertices, plate.faces[front], process=False), (0.0, 0.0, -0.001), 0.015
    )
    X_RG = tumbling(1)[0]
    seen = rendered(framed, X_RG, SUN, lambda p: np.full(len(p), 200.0))
    assert seen.silhouette.any()
    found = close_small_holes(surface_of(framed), 0.05, [seen], RIG)
    assert (found.closed, found.left_open) == (0, 1)
    # the same hole before a dark, solid body: nothing says that it is a window
    filled = FrameView(seen.image, np.ones_like(seen.silhouette), X_RG, np.eye(3))
    assert close_small_holes(surface_of(framed), 0.05, [filled], RIG).closed == 1


def test_a_loop_that_overlaps_in_its_plane_is_spanned_by_the_least_area() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    saddle = np.column_stack([np.cos(turn), np.sin(turn), 3.0 * np.cos(2.0 * turn)])
    saddle[:, 0] += 0.9 * np.cos(2.0 * turn)
    found = fill_loop(saddle, set())
    assert found is not None
    points, faces = found
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    outer = [(a, b) for a, b in edges.tolist() if (b, a) not in set(map(tuple, edges.tolist()))]
    assert sorted(outer) == sorted((k, (k + 1) % 24) for k in range(24))
    assert len(points) + 24 > faces.max()
