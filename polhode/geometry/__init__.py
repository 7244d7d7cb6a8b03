"""Frames, cameras, rigid bodies and rays: the mathematics that every room shares.

- lie: rotations, rigid transforms, quaternions: exponential, logarithm, conversions
- rigid_body: Euler's equations, energy, momentum, integration; half-turns of the principal axes
- rigid_fit: least-squares rotations and rigid transforms
- camera: the rectified stereo camera: projection, triangulation
- fisheye: the equidistant fisheye lens: rays to pixels and back
- rays: rays against triangles
- small_systems: symmetric systems of a few unknowns, in compiled loops
"""
