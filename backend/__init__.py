"""The back end: feature tracks in; motion, mass properties and their covariances out.

- ``estimate``: full smoothing over the sequence; ``fit``: noise levels and disturbances; ``result``: what is
  reported of a solution.
- ``window``: the causal estimate by a sliding window.
- ``disturbances``: known and unknown forces and torques.
- ``noise``: noise levels and outliers, from the data.
- ``uncertainty``: covariances, and what the motion determines.
- ``initialization``: initial poses, rates and inertias.
- ``solvers``: Gauss-Newton and IPOPT.
- ``dynamics``: the rigid body between frames.
- ``problem``: measurements and unknowns.
"""

from polhode.backend.estimate import estimate_motion
from polhode.backend.initialization.initialize import initialize_motion, undisputed_links
from polhode.backend.window.online import estimate_online, in_words_of, window_warnings

__all__ = [
    "estimate_motion",
    "estimate_online",
    "in_words_of",
    "initialize_motion",
    "undisputed_links",
    "window_warnings",
]
