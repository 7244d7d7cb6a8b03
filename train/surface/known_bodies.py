"""The bodies of a training with their landmarks, which are found once and stored beside the images."""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.array_files import read_arrays, require_arrays
from polhode.atomic import replaced
from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.errors import InputError
from polhode.processes import in_order
from polhode.progress import Progress
from polhode.train.surface.batches import KnownBody
from polhode.train.surface.landmarks import Landmarks, find_landmarks
from polhode.train.surface.lit_bodies import lit_body_path, read_lit_body, render_lit_bodies

VERSION = 1
"""Version of the files of landmarks; those of another version are not used."""
_DIMENSIONS = {
    "p_G": ("f", 2),
    "normal_G": ("f", 2),
    "share": ("f", 1),
    "is_weak": ("b", 1),
    "view": ("iu", 1),
    "uv_px": ("f", 2),
    "landmark": ("iu", 1),
}
"""Kind of dtype and number of dimensions of each field of Landmarks."""


def prepare_bodies(
    corpus: Corpus, config: SurfaceTraining, progress: Progress, workers: int
) -> dict[int, KnownBody]:
    """The bodies by their numbers; what is missing is rendered, found, and stored.

    Raises InputError: a folder belongs to another corpus, or a file is damaged.
    """
    numbers = range(config.bodies)
    render_lit_bodies(corpus, config, progress, workers, numbers)
    missing = [i for i in numbers if not landmarks_path(corpus, config, i).is_file()]
    if missing:
        with progress.stage("finding landmarks", len(missing)) as advance:
            for _ in in_order(_make, [(corpus, config, i) for i in missing], workers):
                advance()
    return {
        i: KnownBody(
            read_lit_body(lit_body_path(corpus, config, i)), read_landmarks(landmarks_path(corpus, config, i))
        )
        for i in numbers
    }


def landmarks_path(corpus: Corpus, config: SurfaceTraining, index: int) -> Path:
    """File of one body's landmarks."""
    own = lit_body_path(corpus, config, index)
    return own.parent.parent / "landmarks" / f"{own.stem}-v{VERSION}.npz"


def read_landmarks(path: Path) -> Landmarks:
    """Read a file of landmarks. Raises InputError for anything else."""
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, _DIMENSIONS)
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return Landmarks(**{name: arrays[name] for name in _DIMENSIONS})


def _make(work: tuple[Corpus, SurfaceTraining, int]) -> None:
    corpus, config, index = work
    found = find_landmarks(read_lit_body(lit_body_path(corpus, config, index)))
    path = landmarks_path(corpus, config, index)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as partial:
        np.savez_compressed(partial, **{name: getattr(found, name) for name in _DIMENSIONS})
