"""Trust: whether sigmas, intervals and verdicts of runs hold, over many scenes.

In: scenes of configs/, new ones, bodies of revolution. Out: tables of consistency, verdicts and costs.

trust           the command: simulates, runs, judges, prints
cases           the scenes by group and name
new_scenes      scenes that nothing was tuned on, by a seeded generator
revolution      bodies of revolution that spin about their axis of symmetry, by a seeded generator
judgement       one run: verdict, errors, consistency, intervals, mesh, time of the checks
picture         a contact sheet of new scenes and bodies of revolution
consistency     normalised squared errors and coverage, of one run and pooled
"""
