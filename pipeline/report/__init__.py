"""report.html: one self-contained page, made from what a run stored; and one page for several runs."""

from polhode.pipeline.report.comparison import write_comparison
from polhode.pipeline.report.page import refresh_report, write_report
from polhode.pipeline.report.wording import finding

__all__ = ["finding", "refresh_report", "write_comparison", "write_report"]
