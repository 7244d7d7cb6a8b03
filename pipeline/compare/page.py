"""compare.html: one self-contained page."""

from pathlib import Path

from pipeline.compare.rows import Comparison


def write_page(comparison: Comparison, path: Path) -> None:
    """Cost against time, performance profiles, growth, the tables."""
    del comparison, path
