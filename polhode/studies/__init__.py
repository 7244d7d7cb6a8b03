"""Studies: many points of settings, computed by many processes, as one table.

In: a study (YAML): base, axes, steps. Out: a folder with the records of the points, table.parquet and a page.

- sweep: the flow: what is missing, a window of tasks, the table
- page: what the table says, as one page: study.html
- rules: what accuracy to expect, fitted to the runs of a study
- forecast: what a study will take, before it is computed
- cluster: workers by Dask distributed, and whether those of others can compute here
- table: records as a Parquet table and as a data frame
- steps: what a worker does for a sequence and for a point
- store: the folder: records, sequences, runs that are kept
- study: base, points by their numbers, the address of each
- factors: lists, ranges, draws, Latin hypercubes, Sobol's sequence
"""
