"""Dense stereo. In: a rectified pair and the target's mask. Out: disparity or depth with standard deviations.

depth.py        depth map of a pair, by either method
sgbm.py         the target's crop; whole-pixel disparities by semi-global matching
classical.py    the method ``sgbm``: least squares, piecewise planar smoothing
measured.py     disparity and depth from range images, which need no stereo
learned.py      the method ``network``: its input, and its result refined
"""
