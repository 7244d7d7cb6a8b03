"""Tracks. In: features and pair matches. Out: ``Association`` of features to landmarks, and ``StereoTracks``.

tracks.py              matches joined to landmarks; measurements for the back end
guided.py              matching of unconnected frames at predicted poses
duplicates.py          merging of duplicate landmarks
landmark_map.py        landmarks located by a known motion
track_refinement.py    observations aligned to the same surface point
patch_alignment.py     sub-pixel alignment of patches
"""
