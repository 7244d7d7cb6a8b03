"""The table of a study: a row for each point, as Parquet; and the same as a data frame.

Columns: number and address of the point, the settings of the axes, status, reason and verdict, the metrics of
the steps, times, versions, digests. Records are read twice, for the columns and for the rows, so that a table
of a million points takes the memory of a thousand.
"""

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from polhode.files.atomic import replaced
from polhode.files.output.marked_folder import read_mark
from polhode.geometry.lie import Ints
from polhode.runtime.errors import InputError
from polhode.studies.store import PACKED, Record, Store, batches
from polhode.studies.study import OpenStudy, open_study

if TYPE_CHECKING:
    import pandas as pd

COMMAND = "sweep"
TABLE, STUDY, PAGE = "table.parquet", "study.yaml", "study.html"
FILES = (STUDY, TABLE, PAGE, PACKED)
ROWS_AT_ONCE = 1000
TIME = "time."
"""Columns that begin so differ between two computations of the same study; no others do."""
Row = dict[str, Any]


def row_of(number: int, record: Record) -> Row:
    """A record as a row: columns in their order."""
    return {
        "point": number,
        **record["settings"],
        "status": record["status"],
        "reason": record["reason"],
        "verdict": record["verdict"],
        "doubts": record["doubts"],
        **record["metrics"],
        **{f"{TIME}{name}": value for name, value in record["times"].items()},
        **{f"version.{name}": value for name, value in record["versions"].items()},
        "digest.code": record["code"],
        "digest.sequence": record["sequence"],
        "digest.point": record["address"],
    }


def stored_rows(study: OpenStudy, store: Store) -> Iterator[Row]:
    """A row for each point that is stored, in the order of the points."""
    for number in range(study.count):
        record = store.read(study.point(number).address)
        if record is not None:
            yield row_of(number, record)


def write_table(study: OpenStudy, store: Store, path: Path) -> int:
    """Write the table of what is stored. Returns the number of rows. Raises RunFailure."""
    schema, count = schema_of(stored_rows(study, store)), 0
    with replaced(path) as partial, pq.ParquetWriter(partial, schema, compression="zstd") as writer:
        for rows in batches(stored_rows(study, store), ROWS_AT_ONCE):
            writer.write_table(_table(rows, schema))
            count += len(rows)
    return count


def read_table(folder: Path, most: int | None = None) -> pa.Table:
    """The table of a study; of one that is not finished, the rows that are stored.

    ``most``: at most so many rows, chosen at random. Raises InputError: the folder is that of no study.
    """
    if COMMAND not in (read_mark(folder) or {}):
        raise InputError(f"{folder}: no study of polhode sweep; give the folder that -o named")
    path = folder / TABLE
    if not path.is_file():
        study, store = open_study(folder / STUDY, check=False), Store(folder)
        rows = list(stored_rows(study, store))
        return _table([rows[k] for k in chosen_rows(len(rows), most)], schema_of(rows))
    try:
        table = pq.read_table(path)
        return table.take(pa.array(chosen_rows(table.num_rows, most)))
    except (pa.ArrowException, OSError) as error:
        said = str(error).partition("\n")[0][:120]
        raise InputError(f"{path} cannot be read ({said}); repeat the sweep") from None


def chosen_rows(count: int, most: int | None) -> Ints:
    """Indices (m,), ascending: all of ``count`` rows, or ``most`` of them at random."""
    if most is None or count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def load_study(folder: Path) -> "pd.DataFrame":
    """The same as a data frame of pandas. Raises InputError."""
    table = read_table(folder)
    try:
        return table.to_pandas()
    except ImportError:
        raise InputError("pandas is not installed: pip install 'polhode[pandas]'") from None


RESULTS = ("run.", "evaluate.", "plan.", "compare.")
"""Beginnings of columns, one for each step"""


def schema_of(rows: Iterable[Row]) -> pa.Schema:
    """The columns of all rows and their types, in an order that does not depend on that of the rows' making:
    settings first, then results, then what they were made with."""
    kinds: dict[str, set[type]] = defaultdict(set)
    for row in rows:
        for name, value in row.items():
            kinds[name].add(type(value))
    groups = (*RESULTS, TIME, "version.", "digest.")
    # texts, even where all rows have none
    texts = {"status", "reason", "verdict", "doubts", "digest.sequence"}

    def rank(name: str) -> int:
        return next((k for k, prefix in enumerate(groups) if name.startswith(prefix)), -1)

    def kind(name: str) -> pa.DataType:
        own = kinds[name] - {type(None)}
        if own in ({bool}, {int}):
            return pa.bool_() if own == {bool} else pa.int64()
        return pa.float64() if own <= {int, float} and name not in texts else pa.string()

    # sorting is stable
    return pa.schema([(name, kind(name)) for name in sorted(kinds, key=rank)])


def _table(rows: list[Row], schema: pa.Schema) -> pa.Table:
    """Lists and sections are JSON; numbers and truths among texts likewise."""
    columns = []
    for field in schema:
        cells = [row.get(field.name) for row in rows]
        if pa.types.is_string(field.type):
            cells = [each if each is None or isinstance(each, str) else json.dumps(each) for each in cells]
        columns.append(pa.array(cells, type=field.type))
    return pa.Table.from_arrays(columns, schema=schema)
