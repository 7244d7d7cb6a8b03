"""Motion over time: the truth of a sequence. In: scene and mass properties. Out: poses, rates, forces.

target.py     the target's states
inspector.py  the camera's path, the jitter of its control, and the poses that the inspector reports
mass.py       mass properties, by density or by hand
forces.py     known and white forces and torques, loss of rotational energy
integrate.py  the rigid body under discontinuous forces
"""
