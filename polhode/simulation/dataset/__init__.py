"""From a scene to a dataset on disk. In: scene and seed. Out: images, calibration and truth in a folder.

sequence.py           all steps: plan, render, write
plan.py               all that is decided before the first ray is traced; scenes without a view are refused
frame_renderer.py     renders the pairs of a plan, in one process or several, with the truth of every pixel
range_images.py       what a range sensor beside the left camera measures, with its faults
correspondence.py     where a pixel of one view lies in another
resumable_dataset.py  the dataset on its way to the disk; which folders polhode simulate made
"""
