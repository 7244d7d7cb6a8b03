"""The front end: a stereo sequence to features, tracks and depth maps.

In: images, masks and calibration of a ``polhode.records.dataset.StereoSequence``. Out: ``StereoTracks`` and
relative poses for the back end, and depth maps for the mapping.

extract.py          features and depth maps of every pair, in parallel processes
rectification.py    images of any rig as those of an ideal one
calibration_effects.py   what errors of the calibration do to rectified measurements
segmentation.py     the target's mask before a dark sky
found_masks.py      masks that were found before another background
background/         how they are found: the background's plane, and what stands before it
networks/           the networks trained here, and their weights
disparity/          dense disparity and depth of a pair
features/           key points, descriptors and stereo measurements of a pair
matching/           matches and relative poses of frame pairs
tracks/             landmarks over the whole sequence
weights/            the shipped weights
"""
