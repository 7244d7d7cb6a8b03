"""What the engine of ``polhode sweep`` costs.

- engine: time per point, share of real work, memory over the number of points
- kills: a study that is killed, and one on another scheduler, beside an undisturbed one
- scheduler: 100,000 points on paper, and where the limit is
"""
