"""The Sun and the albedo are found from renderings whose Sun and albedo are known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from trimesh.visual import ColorVisuals

from polhode.geometry.lie import Array, Bools
from polhode.mapping.finishing.albedo import divide_shading
from polhode.mapping.visibility import FrameView
from polhode.records.surface import SurfaceModel
from tests.mapping.rendered_views import RIG, rendered, tumbling

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


def surface_of(mesh: trimesh.Trimesh) -> SurfaceModel:
    rgba = np.tile(np.array([50, 50, 50, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False)
    n = len(mesh.vertices)
    return SurfaceModel(coloured, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


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
    visual = found.surface.mesh.visual
    assert isinstance(visual, ColorVisuals)
    grey = np.asarray(visual.vertex_colors)[:, 0] / found.grey_per_albedo
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
