"""Support of a pose by the image: at the right pose, at wrong ones, without any edge."""

import numpy as np
import trimesh

from benchmarks.edges.tracking.residual import probability, support
from benchmarks.edges.tracking.tracker import TrackerOptions, track
from polhode.lie import exp_so3, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.observability_metric import moved
from tests.planning.edges.pictures import BOX, POSE, RIG, drawn

MODEL = edge_model(trimesh.creation.box(BOX))
IMAGE = drawn(MODEL.surface, POSE)
STILL = TrackerOptions(iterations=0, restarts=0)
"""measures at the guess"""


def test_the_right_pose_is_supported_by_nearly_all_edges() -> None:
    shown = support(track(MODEL, RIG, IMAGE, POSE), IMAGE)
    assert min(shown.found, shown.close, shown.supported, shown.whole, shown.limb) > 0.9
    assert shown.chance < 0.2 and shown.beyond_chance > 0.9


def test_a_pose_moved_aside_is_not() -> None:
    aside = moved(POSE, np.array([0.06, 0.03, 0.0, 0.0, 0.0, 0.0]), MODEL.centre_G)
    shown = support(track(MODEL, RIG, IMAGE, aside, STILL), IMAGE)
    assert shown.supported < 0.4 and shown.whole < 0.4 and shown.limb < 0.4


def test_a_wrong_pose_that_the_tracker_settles_at_is_told_by_support_not_by_the_covariance() -> None:
    # A quarter turn about the longest axis: another box to the eye, the same to the metric.
    turned = POSE @ make_pose(exp_so3([np.pi / 2, 0.0, 0.0]), np.zeros(3))
    right, wrong = track(MODEL, RIG, IMAGE, POSE), track(MODEL, RIG, IMAGE, turned)
    assert wrong.converged and (wrong.information.sigma < 10.0 * right.information.sigma).all()
    of_right, of_wrong = support(right, IMAGE).as_features, support(wrong, IMAGE).as_features
    assert probability(of_right[None])[0] > 0.5 > probability(of_wrong[None])[0]


def test_without_edges_there_is_no_support() -> None:
    shown = support(track(MODEL, RIG, IMAGE, make_pose(np.eye(3), [9.0, 0.0, 2.0])), IMAGE)
    assert (shown.as_features[:5] == 0.0).all() and np.isinf(shown.sigma_px)
    assert probability(shown.as_features[None])[0] < 0.5
