"""The target's masks before a background that is not dark: Earth, clouds, the wall of a laboratory.

In: rectified pairs and the inspector's poses. Out: ``FoundMasks``. The background is what lies in a far plane
at rest; the target stands before it, and its outline follows the edges of the images.

find_masks.py     the background of a sequence, and the masks of its pairs
range_layer.py    both by range images
near_layer.py     the two layers of one pair: what fits the background's plane, and what stands before it
background_image.py   what is behind the target, from frames in which it is elsewhere
still_background.py   the background of a camera at rest: what stays the same in all images
far_plane.py      the background's plane: found in one pair, moved from pair to pair
"""
