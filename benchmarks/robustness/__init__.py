"""Robustness: what faults in the data and in the machine do to a run.

leaks         memory and open files over thousands of runs in one process
small_data    the small sequence of these benchmarks
"""
