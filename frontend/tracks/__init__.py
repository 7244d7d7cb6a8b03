"""Tracks. In: features and pair matches. Out: ``Association`` of features to landmarks, and ``StereoTracks``.

tracks.py              matches joined to landmarks; their map; measurements for the back end
guided_matching.py     matching of unconnected frames at predicted poses
causal_tracks.py       landmarks of a stream, given when the frame arrives
loop_closure.py        landmarks that come back into view are merged with the old ones
track_refinement.py    sub-pixel alignment of observations to the same surface point
"""
