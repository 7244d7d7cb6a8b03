"""Tracks. In: features and pair matches. Out: ``Association`` of features to landmarks, and ``StereoTracks``.

tracks.py              matches joined to landmarks; their map; measurements for the back end
guided_matching.py     matching of unconnected frames at predicted poses
duplicates.py          merging of duplicate landmarks
track_refinement.py    sub-pixel alignment of observations to the same surface point
"""
