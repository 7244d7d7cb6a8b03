"""Noise from the data: residuals in, noise levels and the observations that agree out.

- ``noise_and_outliers``: removal of observations that contradict the motion; noise of the pixels.
- ``correlated_noise``: errors that landmarks keep over a turn, and that neighbours share.
- ``process_level``: level of the disturbances, by maximum evidence.
- ``inspector_swing``: slow errors of the inspector's attitude, against disturbances of the target.
- ``systematic``: errors that all frames share, added to the covariances.
"""
