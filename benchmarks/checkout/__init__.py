"""What ``polhode checkout`` says of sound and of faulty sequences, and the cost of runs that it estimates.

- sequences: values of every check over sequences, and what it says of faults
- faults: faulty sequences, made from a sound one
- run_cost: the constants of the estimate of a run's time
"""
