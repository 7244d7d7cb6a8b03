"""Noise from the data: residuals in, noise levels and the observations that agree out.

- ``noise_and_outliers``: removal of observations that contradict the motion; noise of the pixels.
- ``correlated_noise``: errors that landmarks keep over a turn, and that neighbours share.
- ``process_level``: the evidence of levels of the disturbances.
- ``level_posterior``: from prior and evidence to each level and its uncertainty.
- ``inspector_swing``: slow errors of the inspector's attitude, against disturbances of the target.
- ``systematic``: errors that all frames share, added to the covariances.
"""
