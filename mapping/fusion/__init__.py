"""Depth maps fused in a truncated signed distance field on sparse blocks.

In: depth maps and poses, one by one. Out: the surface, and the poses that were aligned to it.

    fuse                 all frames of a run to one surface
    field                frames added, moved, aligned, removed; the surface so far
    depth_frame          one depth map, cropped, with the weight of each pixel
    block_grid           the voxels: blocks in a hash table
    integration          one frame into the voxels that it sees
    interpolation        distance, gradient and variance between the voxels
    frame_alignment      a frame's pose from the surface that the other frames show
    surface_extraction   the mesh with its standard deviations
"""
