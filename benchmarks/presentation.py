"""Tables in Markdown and figures as PNG."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def table_row(cells: Iterable[object]) -> str:
    """One row of a table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def table_head(columns: Sequence[str], right_from: int | None = None) -> str:
    """The first two lines of a table; columns from the number ``right_from`` on are aligned to the right."""
    left = len(columns) if right_from is None else right_from
    return table_row(columns) + "\n|" + "---|" * left + "---:|" * (len(columns) - left)


def markdown_table(
    columns: Sequence[str], rows: Iterable[Iterable[object]], right_from: int | None = None
) -> str:
    """A whole table."""
    return "\n".join([table_head(columns, right_from), *(table_row(row) for row in rows)])


def save_figure(figure: Any, path: Path, dpi: int) -> None:
    """Write a PNG and close the figure."""
    from matplotlib import pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
