"""Share of the relative poses of frame pairs, from matching alone, that contradict the motion found.

Each was found by RANSAC among the matches of two frames, without the others. Where landmarks that do not
belong to the motion outnumber the rest in some pairs, as the skin that turns under a still outline, these
pairs keep their own opinion.
"""

import numpy as np

from polhode.lie import Array, inverse_pose
from polhode.metrics import angle_deg
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import RelativePoses

CONTRADICTING_DEG = 5.0
"""Rotation between the two; below, few inliers on one side of the body explain it."""
MIN_LINKS = 20
MAX_SHARE = 0.15
"""Sound scenes of configs/scenes have 0 to 4 %, axisymmetric 10 %, minor_axis 20 %."""


def links_check(links: RelativePoses, X_RG: Array) -> Check:
    """X_RG (F, 4, 4): the target in the camera, as found."""
    check = Check(name="links of frames that contradict the motion", limit=100.0 * MAX_SHARE, unit="%")
    if len(links.i) < MIN_LINKS:
        return check
    moved = X_RG[links.i] @ inverse_pose(X_RG[links.j])
    apart_deg = angle_deg(np.swapaxes(moved[:, :3, :3], 1, 2) @ links.X_RiRj[:, :3, :3])
    share = 100.0 * float(np.mean(apart_deg > CONTRADICTING_DEG))
    return check.judged(
        share,
        f"{share:.0f}% of the links between frames, by matching alone, contradict the motion by more than "
        f"{CONTRADICTING_DEG:.0f} deg (usual: below 5%): in these pairs most features move otherwise",
    )
