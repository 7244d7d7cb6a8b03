"""Uncertainty of a solution: its information in, covariances and what the motion determines out.

- ``covariance``: joint covariance of states, constants and landmarks.
- ``calibration_response``: how errors of the calibration move the solution.
- ``self_calibration``: which of them the data determine, and how well.
- ``principal_axes``: moments and principal axes with derivatives, covariance at nearly equal moments.
- ``identifiability``: which of inertia and centre of mass the motion determines.
- ``ambiguity``: two motions that fit equally well and rotate in opposite directions.
"""
