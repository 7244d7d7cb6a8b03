"""The target's motion ahead as a free rigid body.

In: the last state, inertia and centre of mass with their joint covariance. Out: states and covariances at
later times.

    prediction   mean states and covariances
    ensemble     draws of the whole motion, disturbances included
"""
