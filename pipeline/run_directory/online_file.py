"""online.npz: the causal estimate with whole covariances, and what was known of the mass, frame by frame."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from polhode.atomic import replaced
from polhode.pipeline.run_directory.archive_file import load_archive
from polhode.records import OnlineEstimate


def write_online(online: OnlineEstimate, path: Path) -> None:
    """Keys: the fields of OnlineEstimate. The same bytes for the same content."""
    arrays = {f.name: np.asarray(getattr(online, f.name)) for f in fields(online)}
    with replaced(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def read_online(path: Path) -> OnlineEstimate | None:
    """Read online.npz (the file, or the run folder that holds it); None when the run has none.

    Raises InputError, one line, when it cannot be read.
    """
    file = path / "online.npz" if path.is_dir() else path
    if not file.is_file():
        return None
    archive = load_archive(file, "online.npz")
    count = len(archive.times("timestamps_ns"))
    found: dict[str, Any] = {}
    for name in (field.name for field in fields(OnlineEstimate)):
        values = archive.arrays.get(name)
        if values is None or values.shape[:1] != (count,):
            raise archive.wrong(f"{name} has not one row for each of {count} frames")
        found[name] = (
            archive.numbers(name, *values.shape, infinite=True) if values.dtype.kind == "f" else values
        )
    return OnlineEstimate(**found)
