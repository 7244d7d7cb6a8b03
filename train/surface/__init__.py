"""The network that judges places of an image: whether a point there is found again, and by how much its place
scatters, when the light and the view change.

lit_views.py   images of one body from several poses under several Suns, with the truth of their points
batches.py     batches of such images
task.py        the network as a task of the training loop; its loss
scores.py      scores on bodies outside the training set
"""
