"""A run against the truth of its dataset. Nothing else reads the truth.

In: a run directory and the folder of its sequence. Out: metrics.json and a table.

- evaluate: errors of motion, mass properties, prediction and mesh, and their consistency with the sigmas
- seen_surface: the part of the true surface that was seen and lit, on which completeness is measured
"""
