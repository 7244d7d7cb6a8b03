"""Dense stereo. In: a rectified pair and the target's mask. Out: disparity or depth with standard deviations.

depth.py            depth map of a pair, by either method
crop.py             the target's part of the pair
sgbm.py             whole-pixel disparities by semi-global matching
classical.py        the method ``sgbm``: least squares and planes
planes.py           piecewise planar smoothing
learned.py          the method ``network``
network_input.py    hypotheses and channels for the network
"""
