"""Edges to use when there is room for few.

In: information per view and feature. Out: sets of features.

    selection      the best under a budget, with an upper bound
    smallest_set   the fewest that determine the pose nearly as well as all
"""
