"""Intervals of what the motion does not determine, against the truth.

In: measurements without images, and runs of simulated sequences. Out: whether the truth is inside; widths.

    at_rest, flat_spin, two_turns (.yaml)   scenes for `polhode simulate`, beside those of configs/scenes
    truth_inside   by the hull of the run and by the hull of the true body
"""
