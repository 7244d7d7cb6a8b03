"""Training of the descriptor network. In: the corpus. Out: batches of patch pairs, loss and scores.

task.py                    the task ``descriptor``
surface_points.py          key points of a scene and their true correspondences
patch_correspondence.py    rotation and similarity of corresponding patches
batches.py                 batches of patch pairs and distractors
loss.py                    contrast, reliability, direction, matches and motion
scores.py                  scores on held-out bodies, or on any simulated sequences
"""
