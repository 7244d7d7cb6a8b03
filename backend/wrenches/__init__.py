"""Forces and torques on the target: a fitted motion in, the motion with its disturbances out.

- ``known_wrench``: fit with a known wrench; absolute mass and inertia.
- ``unknown_wrench``: steps in which something unknown acts, and its impulses.
"""
