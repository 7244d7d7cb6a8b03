"""Depth and fusion alone, with true poses or those of runs.

In: sequences with truth. Out: distances to the true surface, time.

    mesh_quality   distances and cost on several sequences
    lengths        eight lengths of the free flyer
    fusion_peers   our fusion against Open3D's
"""
