"""What the project's studies found, and the rules of thumb of ``polhode expect``.

In: tables of docs/study_results. Out: findings with intervals; rules, fitted and checked.

    findings         tables of lab/studies/README.md
    study_results    points, settings and errors of a study
    confidence       numbers with intervals of 95 %
    rules_of_thumb   random scenes, run and fitted: the rules
    random_scenes    those scenes
    expectations     whether the rules hold for the runs of other studies
"""
