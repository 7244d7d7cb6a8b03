"""Missions: whether sigmas, intervals, predictions, verdicts and keep-out volumes hold, over one seeded set.

In: missions that are drawn, half of their bodies held back from every choice. Out: tables of docs/trust.md.

    missions             the command: flies, judges, prints
    draw                 the set: bodies, motions, lights, rigs, inspectors
    judgement            one run: verdict, errors, consistency, intervals, mesh, time of the checks
    predictions          its predictions against what came
    consistency          normalised squared errors and coverage, of one run and pooled
    keep_out             the command for the keep-out volumes of the same missions
    keep_out_judgement   one volume: whether it holds the true body, its surface, size and clearances
    smallest_sweep       the smallest space that such a volume could be
"""
