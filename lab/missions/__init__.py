"""Missions: whether sigmas, intervals, predictions and verdicts of runs hold, over one seeded set.

In: missions that are drawn, half of their bodies held back from every choice. Out: tables of docs/trust.md.

    missions        the command: flies, judges, prints
    draw            the set: bodies, motions, lights, rigs, inspectors
    judgement       one run: verdict, errors, consistency, intervals, mesh, time of the checks
    predictions     its predictions against what came
    consistency     normalised squared errors and coverage, of one run and pooled
"""
