"""Points on segments, from which distances are measured."""

import numpy as np

from benchmarks.navigation.refined_edges import points_on


def test_points_are_evenly_on_the_segments() -> None:
    ends = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.05, 0.0]]])
    points = points_on(ends, 0.1)
    assert len(points) == 11
    assert np.allclose(points[:10, 0], np.arange(0.05, 1.0, 0.1)) and not points[:10, 1:].any()
    assert np.allclose(points[10], [0.0, 0.025, 0.0])
