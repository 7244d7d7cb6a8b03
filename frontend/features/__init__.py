"""Features. In: a rectified pair. Out: ``StereoFeatures``: positions, disparities, descriptors and their
noise.

methods.py              the interface and the registry of feature methods
stereo.py               ``StereoFeatures``; the method ``rootsift``; gates of its stereo matches
window_fit.py           least squares of the disparity over windows
epipolar_search.py      nearest descriptors near the same row; matches by all rows, which check the rig
keypoints.py            detection of key points, RootSIFT
surface_features.py     the method ``polhode``: features with surface axes from dense disparity; their noise
local_planes.py         planes through the disparity map, for the normals
surface_network.py      landmarks of an image, and the surface there, by the surface network
patches.py              patches in the tangent plane of the surface
patch_descriptors.py    descriptors of patches
"""
