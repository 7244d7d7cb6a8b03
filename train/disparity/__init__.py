"""Training of the disparity network. In: the corpus. Out: batches of image crops, loss and scores.

task.py       the task ``depth`` and its loss
samples.py    samples with their true disparities, cached; augmented batches
"""
