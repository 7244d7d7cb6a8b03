"""Tables in Markdown and figures as PNG."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

Columns = str | Sequence[str]
"""Names of columns; a string is split at its bars."""
Row = str | Iterable[object]
"""Cells; a string is a finished row without its outer bars."""


def table_head(columns: Columns, right_from: int | None = None) -> str:
    """The first two lines of a table; columns from the number ``right_from`` on are aligned to the right."""
    names = columns.split(" | ") if isinstance(columns, str) else columns
    left = len(names) if right_from is None else right_from
    return _line(names) + "\n|" + "---|" * left + "---:|" * (len(names) - left)


def markdown_table(columns: Columns, rows: Iterable[Row], right_from: int | None = None) -> str:
    """A whole table."""
    return "\n".join([table_head(columns, right_from), *map(_line, rows)])


def print_table(columns: Columns, rows: Iterable[Row], right_from: int | None = None) -> None:
    """A table, each row as soon as the iterator gives it."""
    print(table_head(columns, right_from), flush=True)
    for row in rows:
        print(_line(row), flush=True)


def numbers(values: Iterable[Any], form: str) -> list[str]:
    """Cells of numbers that have one format."""
    return [format(value, form) for value in values]


def _line(row: Row) -> str:
    return f"| {row if isinstance(row, str) else ' | '.join(map(str, row))} |"


def subplots(rows: int, columns: int, size: tuple[float, float], **more: Any) -> tuple[Any, Any]:
    """A figure of so many inches and its axes, drawn without a display."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    return plt.subplots(rows, columns, figsize=size, **more)


def save_figure(figure: Any, path: Path, dpi: int) -> None:
    """Write a PNG and close the figure."""
    from matplotlib import pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
