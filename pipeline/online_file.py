"""online.npz: the causal estimate with whole covariances, and what was known of the mass, frame by frame."""

from dataclasses import fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from polhode.atomic import replaced
from polhode.errors import InputError
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
    try:
        with np.load(file, allow_pickle=False) as archive:
            return OnlineEstimate(**{f.name: archive[f.name] for f in fields(OnlineEstimate)})
    except (BadZipFile, KeyError, ValueError, OSError, EOFError) as error:
        raise InputError(f"{file}: not a causal estimate ({error}); run 'polhode run' again") from error
