"""Trust: whether sigmas, intervals and verdicts of runs hold, over many scenes.

In: scenes of configs/, new ones. Out: tables of consistency, verdicts and costs (docs/trust.md).

    trust           the command: simulates, runs, judges, prints
    new_scenes      scenes that nothing was tuned on, by a seeded generator
    judgement       one run: verdict, errors, consistency, intervals, mesh, time of the checks
    consistency     normalised squared errors and coverage, of one run and pooled
"""
