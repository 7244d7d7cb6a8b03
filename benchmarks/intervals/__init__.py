"""Intervals of what the motion does not determine, against the truth.

In: measurements without images, and runs of simulated sequences. Out: whether the truth is inside; widths.

    truth_inside   by the hull of the run and by the hull of the true body
"""
