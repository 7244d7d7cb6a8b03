"""What the engine of ``polhode sweep`` costs.

- engine: time per point, share of real work, memory over the number of points
"""
