"""Rigid-body dynamics between frames: states in, whitened residuals and their derivatives out.

- ``residuals``: residuals and Jacobians of all steps, compiled.
- ``kernels``: the same residuals, and the weak priors, as CasADi kernels.
- ``propagation``: attitude and rate over a step by Taylor series, with derivatives.
- ``process_noise``: covariance of the process noise over a step.
- ``so3_exp``: exponential and logarithm of many rotations at once, compiled.
"""
