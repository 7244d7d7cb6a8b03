"""Points that stand clear of other edges and of faces seen edge-on."""

import numpy as np
import trimesh

from polhode.lie import exp_so3, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.visible_edges import (
    SPACING_PX,
    beside_edge_on_face,
    clear_points,
    control_points,
    is_separated,
)
from tests.planning.edges.pictures import POSE, RIG


def test_the_rims_of_a_thin_plate_do_not_count() -> None:
    plate = edge_model(trimesh.creation.box((0.8, 0.6, 0.012)))
    X = make_pose(exp_so3([0.6, 0.5, 0.0]), [0.0, 0.0, 2.5])
    points = control_points(plate, RIG, X)
    assert len(points) > 60
    # twelve millimetres are 3 px here
    assert is_separated(points, 4.0).mean() < 0.9
    assert is_separated(points, 1e-6).all()


def test_a_box_from_aside_loses_only_corners() -> None:
    box = edge_model(trimesh.creation.box((0.8, 0.55, 0.35)))
    points = control_points(box, RIG, POSE)
    assert len(clear_points(box, RIG, POSE, SPACING_PX)) > 0.9 * len(points)


def test_a_face_seen_edge_on_takes_its_edges_with_it() -> None:
    box = edge_model(trimesh.creation.box((0.8, 0.5, 0.4)))
    # 0.25 m above the optical axis: the eye is in the plane of the lower face
    X = make_pose(np.eye(3), [0.0, -0.25, 2.5])
    points = control_points(box, RIG, X)
    edge_on = beside_edge_on_face(points, box, X)
    low = points.p_G[:, 1] > 0.249
    assert low.sum() > 10 and edge_on[low].all()
    assert not edge_on[points.p_G[:, 1] < -0.249].any()
