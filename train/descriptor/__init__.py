"""Training of the descriptor network. In: the corpus. Out: batches of patch pairs, loss and scores.

task.py              the task ``descriptor`` and its loss
surface_points.py    key points of a scene and their true correspondences
batches.py           batches of patch pairs and distractors; similarity of patches
scores.py            scores on held-out bodies
"""
