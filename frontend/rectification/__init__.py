"""Rectification. In: raw images and calibration. Out: a rectified pair with the target's masks.

rectify.py    the ideal rig of a calibration, and rectified pairs
target.py     segmentation of the target, and its bounding box
"""
