"""Training of the networks that the front end ships. In: a configuration. Out: weights, scores and curves.

run.py              ``polhode train``: corpus, task, loop, weights
training_loop.py    the training loop
checkpoint.py       the state of a training on disk
task.py             the interface and the registry of tasks
curves.py           curves in TensorBoard's format, and plots of them
corpus.py           the simulated training sequences, of random scenes
feature_noise.py    constants of the front end's noise model
descriptor/         the descriptor of surface patches
disparity/          the refinement of disparities
light/              what other light does to features: bodies under several Suns
surface/            the surface network: bodies under several Suns, their landmarks, the loss, scores
"""
