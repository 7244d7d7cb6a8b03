"""Benchmarks: what is measured to choose between methods, and to show how good the results are.

In: simulated sequences and runs of them. Out: tables in Markdown, figures, records of long measurements. They
are not installed with the package. Each folder is a topic. ``python -m lab --list`` shows commands.

    registry       every benchmark: its arguments, the page that quotes it, how long it takes
    __main__       ``python -m lab``: runs them; short_forms runs the short form of each
    pages          whether figures and commands of the pages are those of the records and benchmarks
    record         long measurements that can be interrupted; which commit made a result
    command        the command line of a benchmark
    presentation   tables in Markdown, figures
"""
