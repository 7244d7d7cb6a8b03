"""Sequences without images. In: body, motion and noise. Out: the records that the front end would give.

measurements.py      landmarks seen by a stereo camera, and relative poses between frames
disturbed_motion.py  a rigid body under white disturbances
pair_poses.py        relative poses by absolute orientation
"""
