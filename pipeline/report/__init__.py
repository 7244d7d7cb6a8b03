"""report.html: one self-contained page, made from what a run stored."""

from pipeline.report.page import refresh_report, write_report
from pipeline.report.words import finding

__all__ = ["finding", "refresh_report", "write_report"]
