"""Matching. In: ``StereoFeatures`` of all frames. Out: ``PairMatch``: relative poses and inlier matches.

pairs.py              all selected frame pairs, in parallel
retrieval.py          selection of the pairs
methods.py            the interface and the registry of match methods
matchers.py           the methods ``nearest`` and ``polhode``
soft_assignment.py    dual softmax and rigid fit, differentiable
consensus.py          motions on which matches of surface features agree
ransac.py             the geometric check: RANSAC on absolute orientation
combined.py           features and matches of two methods together
"""
