"""From a scene to a dataset on disk. In: scene and seed. Out: images, calibration and truth in a folder.

sequence.py        the whole way: plan, render, write
plan.py            all that is decided before the first ray is traced
view_check.py      refuses scenes in which the target cannot be seen
frame_renderer.py  renders the pairs of a plan, in one process or several
products.py        truth of every pixel: depth, normals, masks, albedo
correspondence.py  where a pixel of one view lies in another
staging.py         the dataset is complete or not there; an interrupted one is resumed
"""
