"""Recordings of others, imported: the same run, and offsets of clocks.

- recordings: a dataset written as bags, videos and folders with calibrations, for benchmarks and tests
- same_run: the sample through each format and back, and its run
- clock_offset: offsets that the images show, over scenes and known offsets
"""
