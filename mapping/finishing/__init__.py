"""What makes a fused mesh fit for use.

In: the fused surface, images and poses. Out: the surface without small holes, with albedo, in several sizes.

    hole_closing    small holes closed, their faces flagged
    albedo          colour without light and shadow
    sun_direction   direction of the Sun from how the turning surface brightens and darkens
    detail_levels   lighter meshes, and how far they are from the full one
"""
