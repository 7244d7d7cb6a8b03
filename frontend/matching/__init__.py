"""Matching. In: ``StereoFeatures`` of all frames. Out: ``PairMatch``: relative poses and inlier matches.

pairs.py       selection of frame pairs, their matching in parallel; two methods together
methods.py     the interface and the registry of match methods
nearest.py     the method ``nearest``: mutual nearest neighbours
matchers.py    the method ``polhode``: dual softmax, motions on which matches agree
frame_choice.py  with which earlier frames a stream matches a new one, and which of them it keeps
ransac.py      the geometric check: RANSAC on absolute orientation
"""
