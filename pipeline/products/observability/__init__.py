"""``polhode observability``: the edge metric along a trajectory, as tables and pictures."""
