"""Training of the disparity network. In: the corpus. Out: batches of image crops, loss and scores.

task.py       the task ``depth``
truth.py      true disparities of simulated pairs
samples.py    samples with their truth, cached; augmented batches
loss.py       density of the true disparity, visibility
"""
