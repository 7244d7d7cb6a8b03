"""``polhode export``: a run in the formats of other programs, whose writers are in ``planning/exports``.

In: a run directory and the options. Out: mesh, robot description, ephemeris or JSON; what the run lacks is
left out with a warning.

- export_run: the content of each format
- options: the options, checked
- own_files: where the files go, and which there are of an earlier export
- job: what the run has, in the frame of the file, and what is left out; where each mass property comes from
- placement: the frame of the file, also that of a CAD model
"""
