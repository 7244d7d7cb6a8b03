"""Noise from the data: residuals in, noise levels and the observations that agree out.

- ``measurement_noise``: noise of the pixels; removal of observations that contradict the motion.
- ``process_level``: level of the disturbances, by maximum evidence.
- ``systematic``: errors that all frames share, added to the covariances.
"""
