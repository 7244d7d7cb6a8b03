"""The stereo camera. In: rig and sensor of a scene. Out: rays of pixels, and images from light.

cameras.py  intrinsics, poses, rays
sensor.py   lens blur, noise, quantization
"""
