"""Coverage of bodies whose visible share has a closed form."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.optimize import brentq

from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.mapping.visibility import MIN_COSINE, Caster, FrameView
from polhode.pipeline.coverage import coverage_of, describe_direction, warnings_of, with_classes
from polhode.records.surface import SEEN_LIT, SEEN_UNLIT, UNSEEN, SurfaceModel
from tests.mapping.rendered_views import DISTANCE_M, RIG, rendered

RADIUS_M = 0.08
BALL = trimesh.creation.icosphere(5, RADIUS_M)
AHEAD, LEFT = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])


def view(sun_R: Array = AHEAD, R: Array | None = None, ambient: float = 0.5) -> FrameView:
    X_RG = make_pose(np.eye(3) if R is None else R, [0.0, 0.0, DISTANCE_M])
    return rendered(BALL, X_RG, sun_R, lambda p: np.full(len(p), 200.0), ambient)


def visible_share() -> float:
    """Of a sphere's area, seen from one point at no more than the steepest angle that counts."""

    def excess(polar: float) -> float:
        away = DISTANCE_M * np.cos(polar) - RADIUS_M
        length = np.sqrt(DISTANCE_M**2 + RADIUS_M**2 - 2.0 * DISTANCE_M * RADIUS_M * np.cos(polar))
        return float(away / length - MIN_COSINE)

    return float(0.5 * (1.0 - np.cos(brentq(excess, 0.0, np.pi / 2))))


def test_a_sphere_seen_from_one_side_is_covered_by_its_visible_share() -> None:
    found = coverage_of(BALL, [view()], RIG)
    assert found.of == "mesh" and found.seen == pytest.approx(visible_share(), abs=0.015)
    assert found.seen_unlit == 0.0 and found.unseen == pytest.approx(1.0 - found.seen, abs=1e-9)
    # the camera stands on the side of -z
    assert found.unseen_direction_G is not None and found.unseen_direction_G[2] > 0.99
    assert found.words.endswith("of the surface was never seen, mostly around +z of G")
    assert warnings_of(found) == [found.words]
    # an open mesh is measured on its hull, whose flat side is a third of the area
    half = trimesh.Trimesh(BALL.vertices, BALL.faces[BALL.triangles_center[:, 2] < 0.0], process=False)
    found = coverage_of(half, [view()], RIG)
    assert found.of == "hull" and "mesh is open" in found.words and found.unseen > 1.0 / 3.0 - 0.02
    turns = [exp_so3([0.0, 1.2 * k, 0.0]) for k in range(6)] + [exp_so3([a, 0.0, 0.0]) for a in (1.5, -1.5)]
    found = coverage_of(BALL, [view(R=R) for R in turns], RIG)
    assert found.seen == 1.0 and found.words == "all of the surface was seen in light"
    assert warnings_of(found) == []


def test_the_dark_side_is_seen_but_never_lit_and_vertices_get_their_class() -> None:
    dim = view(LEFT, ambient=0.0)
    found = coverage_of(BALL, [dim], RIG)
    assert found.seen + found.seen_unlit == pytest.approx(visible_share(), abs=0.015)
    # a little more than half of it lies in the dark: dim light along the terminator shows nothing
    assert found.seen_unlit == pytest.approx(0.5 * visible_share(), abs=0.05)
    assert "seen but never lit, mostly around" in found.words and "+x" in found.words.split(";")[1]
    n = len(BALL.vertices)
    surface = SurfaceModel(BALL, np.full(n, np.inf), np.zeros(n, dtype=np.int64))
    classes = with_classes(surface, [dim], RIG, Caster(BALL))
    x, z = BALL.vertices[:, 0] / RADIUS_M, BALL.vertices[:, 2] / RADIUS_M
    assert np.all(classes[(z < -0.6) & (x < -0.25)] == SEEN_LIT)
    assert np.all(classes[(z < -0.6) & (x > 0.1)] == SEEN_UNLIT)
    assert np.all(classes[z > 0.0] == UNSEEN)
    measured = replace(surface, views=np.ones(n, dtype=np.int64))
    assert np.all(with_classes(measured, [dim], RIG, Caster(BALL)) == SEEN_LIT)


def test_directions_are_named_by_their_axes() -> None:
    assert describe_direction(np.array([0.1, 0.0, -3.0])) == "-z"
    assert describe_direction(np.array([-0.7, 0.0, 0.71])) == "+z and -x"
