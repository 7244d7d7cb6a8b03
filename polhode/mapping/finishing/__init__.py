"""What makes a fused mesh fit for use.

In: the fused surface, images and poses. Out: the surface without small holes, with albedo, in several sizes.

hole_closing.py   small holes closed, their faces flagged
albedo.py         colour without light and shadow
sun_direction.py  direction of the Sun from how the rotating surface brightens and darkens
detail_levels.py  lighter meshes, and how far they are from the full one
"""
