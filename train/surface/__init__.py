"""Training of the surface network. In: the corpus. Out: batches of image pairs, loss and scores.

task.py         the task ``surface`` and its loss
lit_bodies.py   images of one body from several poses under several Suns
landmarks.py    marks of the surface that other images show again; the bodies with them, stored
batches.py      pairs of images with their landmarks
scores.py       scores on held-out bodies
"""
