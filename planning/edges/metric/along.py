"""The metric at each place of a trajectory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.planning.edges.metric.edge_motion import edge_motion
from polhode.planning.edges.metric.metric import Observability, observability
from polhode.planning.edges.model.edge_model import EdgeModel
from polhode.planning.edges.model.light import in_sunlight
from polhode.planning.edges.model.seen_edges import SPACING_PX, ControlPoints, control_points


@dataclass(frozen=True)
class EdgeView:
    """What the camera sees of the edges from one place, and what that tells of the pose."""

    X_RG: Array
    """(4, 4) the target in the camera"""
    points: ControlPoints
    f: Array
    """(m, 6) motion across the edges [px per m, px per rad]"""
    found: Observability
    length_px: float
    """of all visible edges in the image"""
    o_G: Array
    """(3,) the point that turns are about and whose shifts are told [m]"""

    @property
    def range_m(self) -> float:
        """From the camera to o."""
        return float(np.linalg.norm(self.X_RG[:3, :3] @ self.o_G + self.X_RG[:3, 3]))

    @property
    def expected_edges(self) -> int:
        """Features in sight: what the binary metric, edges found against expected, expects."""
        return len(np.unique(self.points.feature))


def look_along(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    o_G: Array,
    spacing_px: float = SPACING_PX,
    sun_G: Array | None = None,
) -> Iterator[EdgeView]:
    """The views from a trajectory X_RG (k, 4, 4), about o_G (3,), one by one.

    With sun_G (k, 3), towards the Sun, edges count by their contrast.
    """
    for k, X in enumerate(X_RG):
        points = control_points(model, rig, X, spacing_px)
        if sun_G is not None:
            points = in_sunlight(model, points, inverse_pose(X)[:3, 3], sun_G[k])
        f = edge_motion(points, rig, X, o_G)
        found = observability(f, points.weight, model.radius_m)
        yield EdgeView(X, points, f, found, spacing_px * float(points.weight.sum()), o_G)
