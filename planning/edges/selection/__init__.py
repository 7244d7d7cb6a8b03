"""Selection of edges when their number is limited.

In: information per view and feature. Out: sets of features.

    selection      the best under a budget, with an upper bound
    smallest_set   the smallest set that determines the pose nearly as well as all edges
"""
