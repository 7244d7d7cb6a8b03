"""The keep-out volume of a stream: the motion as it is known live, and the surface so far."""

import numpy as np

from polhode.backend.problem.inertia import principal_axes
from polhode.backend.window import BodyState
from polhode.planning.keep_out.queries import KeepOut
from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out
from polhode.planning.plan import require_options
from polhode.planning.prediction import FinalEstimate, FinalState
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError

MOST_PAST = 20
"""Frames whose attitudes bound an inertia that is not determined"""


def live_keep_out(body: BodyState, surface: SurfaceModel, options: KeepOutOptions) -> KeepOut:
    """The volume from the latest pair on. Raises InputError: an empty surface, or options that do not fit."""
    if len(surface.mesh.faces) == 0:
        raise InputError("the live surface is empty yet: a keep-out volume needs more pairs")
    estimate = live_estimate(body)
    require_options(options, estimate)
    return keep_out(surface, estimate, options)


def live_estimate(body: BodyState) -> FinalEstimate:
    """The end of the motion so far, with the level of the disturbances that the window allows.

    Where the inertia is not determined, the attitudes of the frames that the window keeps bound it.
    """
    chosen = np.unique(np.linspace(0, len(body.past_s) - 1, MOST_PAST).astype(int))
    past = (body.past_s[chosen], body.past_R_NG[chosen]) if len(body.past_s) else ()
    state = body.r_N, body.v_N, body.R_NG, body.w_G, body.J_G, principal_axes(body.J_G)[1]
    last = FinalState(*state, body.J_jacobian, body.covariance, *past)
    return FinalEstimate(last, body.com_G, body.accel_psd, body.torque_psd)
