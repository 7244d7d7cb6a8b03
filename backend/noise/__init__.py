"""Noise from the data: residuals in, noise levels and the observations that agree out.

- ``outlier_observations``: removal of observations that contradict the motion.
- ``measurement_noise``: noise of the pixels, from the residuals.
- ``process_level``: level of the disturbances, by maximum evidence.
- ``systematic``: errors that all frames share, added to the covariances.
"""
