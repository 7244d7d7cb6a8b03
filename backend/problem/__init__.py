"""The estimation problem as data: measurements and noise in, unknowns and their parametrizations out.

- ``motion_data``: measurements sorted by landmark, camera poses and noise levels.
- ``iterate``: the unknowns, their layout as a vector, and how a correction changes them.
- ``inertia``: the inertia up to scale as five unconstrained numbers.
- ``level_prior``: what is known of the level of the disturbances beforehand.
- ``wrench``: known forces and torques over the steps between frames, and the unknowns that come with them.
"""
