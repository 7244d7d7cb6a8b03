"""Training of the networks that the front end ships. In: a configuration. Out: weights, scores and curves.

run.py              ``polhode train``: corpus, task, loop, weights
training_loop.py    the training loop, and curves in TensorBoard's format
checkpoint.py       the state of a training on disk
task.py             the interface and the registry of tasks
corpus.py           the simulated training sequences, of random scenes
stored.py           records of arrays beside the corpus
descriptor/         the descriptor of surface patches
disparity/          the refinement of disparities
surface/            the surface network: bodies under several Suns, their landmarks, the loss, scores
"""
