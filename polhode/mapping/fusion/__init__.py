"""Depth maps fused in a truncated signed distance field on sparse blocks.

In: depth maps and poses, one by one. Out: the surface, and the poses that were aligned to it.

field.py               all frames of a run to one surface: frames added, moved, aligned, removed
depth_frame.py         one depth map, cropped, with the weight of each pixel
block_grid.py          the voxels: blocks in a hash table
integration.py         one frame into the voxels that it sees
frame_alignment.py     a frame's pose from the surface that the other frames show
vertex_views.py        what each frame says about each vertex
vertex_sigma.py        the standard deviation of each vertex
surface_extraction.py  the mesh with its standard deviations
"""
