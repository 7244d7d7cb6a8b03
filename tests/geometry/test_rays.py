"""Rays against triangles: embree against closed forms."""

import numpy as np
import trimesh

from polhode.geometry.rays import RayScene


def test_no_ray_slips_through_between_triangles() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    outward = np.asarray(ball.vertices)
    hits = RayScene(ball.triangles).first_hits(3.0 * outward, -outward)
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.distance, 2.0, atol=1e-5)


def test_weights_give_the_point_of_the_hit() -> None:
    triangle = np.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 1.5], [0.0, 1.0, 0.5]]])
    start, direction = np.zeros((1, 3)), np.array([[0.3, 0.2, 0.9]]) / np.linalg.norm([0.3, 0.2, 0.9])
    hits = RayScene(triangle).first_hits(start, direction)
    weights = np.array([1.0 - hits.u[0] - hits.v[0], hits.u[0], hits.v[0]])
    np.testing.assert_allclose(weights @ triangle[0], hits.distance[0] * direction[0], atol=1e-6)


def test_blocked_within_reach_only() -> None:
    scene = RayScene([[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]]])
    start, direction = np.zeros((2, 3)), np.tile([0.0, 0.0, 1.0], (2, 1))
    assert scene.blocked(start, direction, np.array([2.0, 0.5])).tolist() == [True, False]
    assert scene.blocked(start, direction).all()
    assert not RayScene(np.zeros((0, 3, 3))).blocked(start, direction).any()


def test_faces_of_vertices_are_the_same_triangles() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    direction = -np.asarray(ball.vertices)
    both = (RayScene(ball.triangles), RayScene(ball.vertices, np.asarray(ball.faces)))
    first, second = (scene.first_hits(-3.0 * direction, direction) for scene in both)
    for one, other in zip(vars(first).values(), vars(second).values(), strict=True):
        np.testing.assert_array_equal(one, other)
    none = RayScene(ball.vertices, np.zeros((0, 3), dtype=np.int64))
    assert not none.blocked(-3.0 * direction, direction).any()
