"""Matching. In: ``StereoFeatures`` of all frames. Out: ``PairMatch``: relative poses and inlier matches.

pairs.py       selection of frame pairs, their matching in parallel; two methods together
methods.py     the interface and the registry of match methods
nearest.py     the method ``nearest``: mutual nearest neighbours
matchers.py    the method ``polhode``: dual softmax, motions on which matches agree
earlier_frames.py  with which earlier frames a stream matches a new one
key_frames.py  which of them a long stream keeps
ransac.py      the geometric check: RANSAC on absolute orientation
"""
