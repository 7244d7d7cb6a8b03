"""The back end: feature tracks in; motion, mass properties and their covariances out.

- ``estimate``: full smoothing over the sequence; ``result``: what is reported of a solution.
- ``between_key_frames``: all frames of a long sequence, from the estimate of its key frames.
- ``subset_solution``: some of the measurements solved by themselves, for checks.
- ``window``: the causal estimate by a sliding window.
- ``wrenches``: known and unknown forces and torques.
- ``outliers_and_noise``: removal of outliers, and noise levels from the data.
- ``uncertainty``: covariances, and what the motion determines.
- ``initialization``: initial poses, rates and inertias.
- ``solvers``: Gauss-Newton and IPOPT.
- ``dynamics``: the rigid body between frames.
- ``problem``: measurements and unknowns.
"""

from polhode.backend.estimate import estimate_motion, with_calibration
from polhode.backend.initialization.hypotheses import contrast_of_links, links_of_the_body, rotation_errors
from polhode.backend.initialization.initialize import consistent_links, initialize_motion
from polhode.backend.window.estimator import align_online_estimate, estimate_online, window_warnings

__all__ = [
    "align_online_estimate",
    "consistent_links",
    "contrast_of_links",
    "estimate_motion",
    "estimate_online",
    "initialize_motion",
    "links_of_the_body",
    "rotation_errors",
    "window_warnings",
    "with_calibration",
]
