"""Training of the surface network. In: bodies of the corpus. Out: the task ``surface``.

lit_bodies.py      images of bodies from several poses under several Suns, with the truth of their pixels
landmarks.py       marks of the surface that are found again whatever the light
known_bodies.py    both for all bodies, stored beside the corpus
batches.py         pairs of images, targets of the network, and patches
task.py            the loss
scores.py          scores on held-out bodies
"""
