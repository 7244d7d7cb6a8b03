"""Monte Carlo on measurements without images: errors against the bound, consistency, convergence.

In: sequences of polhode/simulation/monte_carlo.py. Out: tables (docs/accuracy.md, docs/live.md,
docs/backend.md).

    bound         the Cramer-Rao bound; cold starts and their errors, which the others use
    accuracy      errors against the bound, and consistency of the sigmas
    convergence   random bodies and spins: does a cold start end at the truth
    robustness    outliers, a gap, an inspector that jitters
    disturbances  known forces, and unknown ones that are found
    window        the sliding window against full smoothing, and its time
"""
