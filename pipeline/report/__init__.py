"""The report: one self-contained HTML page, made from what a run stored; or one page for several runs.

In: a run directory. Out: report.html.

- page: fills the template with tables and figures; finish_run writes the summary and the report of a run
- comparison: the page about several runs
- tables: the finding in a sentence, and the rows of every table
- figures/: the figures, one topic a file
- templates/: the pages, Jinja
"""

from polhode.pipeline.report.comparison import write_comparison
from polhode.pipeline.report.page import finish_run, write_report
from polhode.pipeline.report.tables import finding

__all__ = ["finding", "finish_run", "write_comparison", "write_report"]
