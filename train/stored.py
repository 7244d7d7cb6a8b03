"""Records of arrays beside the corpus: made once, written whole, checked when they are read."""

from collections.abc import Callable, Mapping
from dataclasses import field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress

Item = TypeVar("Item")


def array(kinds: str, dimensions: int) -> Any:
    """A field of a record: kinds of its dtype, as "f" or "iu", and number of its dimensions."""
    return field(metadata={"array": (kinds, dimensions)})


def write_record(path: Path, record: Any, made_from: str = "") -> None:
    """Write the whole file or nothing; ``made_from``: digest of what the record was made from."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {each.name: getattr(record, each.name) for each in fields(record)}
    with replaced(path) as partial:
        np.savez_compressed(partial, **arrays | {"made_from": np.array(made_from)})


def read_record(path: Path, kind: type[Item]) -> tuple[Item, str]:
    """Read what ``write_record`` wrote, and what it was made from. Raises InputError for anything else."""
    expected = {each.name: each.metadata["array"] for each in fields(kind)}  # type: ignore[arg-type]
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, expected)
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return kind(**{name: arrays[name] for name in expected}), str(arrays.get("made_from", ""))


def make_missing(
    title: str,
    make: Callable[[Item], object],
    paths: Mapping[Item, Path],
    progress: Progress,
    workers: int,
) -> None:
    """Call ``make`` in parallel processes for the items whose files are missing."""
    missing = [item for item, path in paths.items() if not path.is_file()]
    if missing:
        with progress.stage(f"{title} ({len(paths) - len(missing)} were there)", len(missing)) as advance:
            for _ in in_order(make, missing, workers):
                advance()
