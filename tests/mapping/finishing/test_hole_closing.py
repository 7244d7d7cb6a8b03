"""Small holes are closed with what closed forms say, flagged; large ones, and windows, stay open."""

import numpy as np
import pytest
import trimesh

from polhode.mapping.finishing.hole_closing import boundary_loops, close_small_holes, fill_loop
from polhode.mapping.visibility import FrameView
from polhode.records.surface import SurfaceModel
from tests.mapping.rendered_views import RIG, rendered, tumbling

SUN = np.array([0.3, -0.4, -0.866])


def surface_of(mesh: trimesh.Trimesh) -> SurfaceModel:
    rgba = np.tile(np.array([90, 90, 90, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)
    n = len(mesh.vertices)
    return SurfaceModel(coloured, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


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
