"""The figures of the report. In: a stored run. Out: plain data for plotly.js.

- motion: centre of mass, attitude, angular velocity
- rotation: polhode, inertia ratios, energy and angular momentum
- convergence: the causal estimate after each frame
- residuals: residuals against their noise, observations per frame and landmark
- shape: sparse map and surface
- plot: axes, traces and colours that the figures share
"""
