"""report.html: one self-contained page, made from what a run stored."""

from pathlib import Path

from pipeline.atomic import write_text
from pipeline.summary import read_summary


def write_report(folder: Path) -> None:
    """Write report.html of the run in ``folder``."""
    summary = read_summary(folder)
    write_text(folder / "report.html", f"<!doctype html><title>polhode</title><p>{summary.status}</p>\n")
