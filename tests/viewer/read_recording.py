"""Recordings read back by Rerun's own reader."""

from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

Row = tuple[int, dict[str, Any]]
"""Number of the frame, -1 for static data, and the values by component"""


def rows_of(path: Path) -> dict[str, list[Row]]:
    """All that was logged, by entity in the order of frames; without the numbers that Rerun gives to rows."""
    found: dict[str, list[Row]] = {}
    for chunk in RrdReader(path).stream():
        for row in chunk.to_record_batch().to_pylist():
            values = {name: value for name, value in row.items() if name != "rerun.controls.RowId"}
            frame = int(values.pop("frame", -1))
            kept = {name: value for name, value in values.items() if value is not None}
            found.setdefault(chunk.entity_path, []).append((frame, kept))
    return {
        entity: sorted(rows, key=lambda row: (row[0], sorted(row[1])))
        for entity, rows in sorted(found.items())
    }


def values_of(path: Path, entity: str, component: str) -> dict[int, Any]:
    """One component of an entity by frame; -1: static."""
    return {frame: row[component] for frame, row in rows_of(path)[entity] if component in row}
