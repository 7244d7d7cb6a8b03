"""The bodies of a training with their landmarks, which are found once and stored beside the images.

    python -m polhode.train.surface.known_bodies CONFIG [--more K] [--workers N] [--chance 20 | --each]

makes what is missing and prints, for each family, the median number of landmarks of a body, the share of the
key points that show one, and the share of the landmarks that chance explains (of so many bodies). ``--more``
takes the K-th further corpus of the configuration, ``--each`` prints a row for each body instead.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from polhode.config.loader import load_config
from polhode.config.train_settings import Corpus, SurfaceTraining, Train
from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress, Silent
from polhode.train.corpus import required_train
from polhode.train.surface.batches import KnownBody
from polhode.train.surface.landmarks import GATHER_PX, Landmarks, chance_share, find_landmarks
from polhode.train.surface.lit_bodies import lit_body_path, on_target, read_lit_body, render_lit_bodies

VERSION = 2
"""Version of the files of landmarks; those of another version are not used."""
NEXT_ALBEDO = 100_000
"""Added to the numbers of bodies for each further albedo of their shapes."""
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

    The bodies of the first albedo have their numbers in the corpus, those of the next one ``NEXT_ALBEDO``
    more.

    Raises InputError: a folder belongs to another corpus, or a file is damaged.
    """
    numbers = range(config.bodies)
    render_lit_bodies(corpus, config, progress, workers, numbers)
    albedos = range(config.albedos)
    wanted = [(i, albedo) for i in numbers for albedo in albedos]
    missing = [each for each in wanted if not landmarks_path(corpus, config, *each).is_file()]
    if missing:
        with progress.stage("finding landmarks", len(missing)) as advance:
            for _ in in_order(_make, [(corpus, config, *each) for each in missing], workers):
                advance()
    known: dict[int, KnownBody] = {}
    for i in numbers:
        bodies = [read_lit_body(lit_body_path(corpus, config, i, albedo)) for albedo in albedos]
        for albedo, body in enumerate(bodies):
            landmarks = read_landmarks(landmarks_path(corpus, config, i, albedo))
            others = tuple(bodies[:albedo] + bodies[albedo + 1 :])
            known[i + albedo * NEXT_ALBEDO] = KnownBody(body, landmarks, others)
    return known


def corpus_of(train: Train, more: int) -> tuple[Corpus, SurfaceTraining]:
    """The corpus of a training (0), or one of its further ones, counted from 1, and what is made of it.

    Raises InputError: there is no such corpus.
    """
    config = train.surface
    if more == 0:
        return train.corpus, config
    if not 1 <= more <= len(config.more):
        raise InputError(f"train.surface.more has {len(config.more)} entries, and no number {more}")
    entry = config.more[more - 1]
    return entry.corpus, config.model_copy(update={"bodies": entry.bodies, "albedos": entry.albedos})


def landmarks_path(corpus: Corpus, config: SurfaceTraining, index: int, albedo: int = 0) -> Path:
    """File of the landmarks of one body with one albedo."""
    own = lit_body_path(corpus, config, index, albedo)
    return own.parent.parent / "landmarks" / f"{own.stem}-v{VERSION}.npz"


def read_landmarks(path: Path) -> Landmarks:
    """Read a file of landmarks. Raises InputError for anything else."""
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, _DIMENSIONS)
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return Landmarks(**{name: arrays[name] for name in _DIMENSIONS})


def _make(work: tuple[Corpus, SurfaceTraining, int, int]) -> None:
    found = find_landmarks(read_lit_body(lit_body_path(*work)))
    path = landmarks_path(*work)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as partial:
        np.savez_compressed(partial, **{name: getattr(found, name) for name in _DIMENSIONS})


def table(bodies: dict[int, KnownBody], families: Sequence[str], chance_of: int) -> str:
    """Markdown table: a row for each family, and one of all.

    Bodies are counted with each of their albedos; if they have several, a column says how many landmarks of
    the first one are landmarks under another one, too.
    """
    several = max(bodies) >= NEXT_ALBEDO
    columns = ["family", "bodies", "landmarks of a body", "key points that show one [%]", "by chance"]
    columns += ["under another albedo too [%]"] * several
    rows = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    family = {k: families[k % NEXT_ALBEDO % len(families)] for k in bodies}
    groups = {name: [k for k in bodies if family[k] == name] for name in families}
    for name, numbers in {**groups, "all": list(bodies)}.items():
        found = [bodies[k].landmarks for k in numbers]
        if not found:
            continue
        count = np.median([np.sum(~each.is_weak) for each in found])
        shown = np.concatenate([each.landmark >= 0 for each in found])
        # at random: the families follow each other in a fixed order
        chosen = np.random.default_rng(0).permutation(numbers)[:chance_of]
        chance = chance_share([bodies[int(k)].body for k in chosen])
        row = f"| {name} | {len(found)} | {count:.0f} | {100 * shown.mean():.0f} | {chance:.2f} |"
        if several:
            row += f" {100 * share_of_shape(bodies, numbers):.0f} |"
        rows.append(row)
    return "\n".join(rows)


def rows_of(bodies: dict[int, KnownBody], families: Sequence[str]) -> str:
    """Markdown table: a row for each body and albedo, the smallest ones first."""
    rows = []
    for k, known in bodies.items():
        mask = on_target(known.body, 0)
        across = max(int(np.sum(mask.any(axis=axis))) for axis in (0, 1))
        number, albedo = k % NEXT_ALBEDO, k // NEXT_ALBEDO
        count, weak = int(np.sum(~known.landmarks.is_weak)), int(np.sum(known.landmarks.is_weak))
        rows.append((across, number, albedo, families[number % len(families)], count, weak))
    lines = [
        f"| {number} | {albedo} | {family} | {across} | {count} | {weak} |"
        for across, number, albedo, family, count, weak in sorted(rows)
    ]
    head = "| body | albedo | family | across in the first image [px] | landmarks | weak ones |"
    return "\n".join([head, "|---|---|---|---|---|---|", *lines])


def share_of_shape(bodies: dict[int, KnownBody], numbers: Sequence[int]) -> float:
    """Share of the landmarks of first albedos that are landmarks under another albedo of the shape, too.

    Those belong to the shape and its shading, or coincide by chance.
    """
    both, count = 0, 0
    for k in numbers:
        if k >= NEXT_ALBEDO:
            continue
        first, *others = (
            bodies[each].landmarks.p_G[~bodies[each].landmarks.is_weak]
            for each in range(k, max(bodies) + 1, NEXT_ALBEDO)
            if each in bodies
        )
        body = bodies[k].body
        px_m = float(np.nanmedian(body.depth_m)) / float(body.focal_px)
        there = np.concatenate(others)
        count += len(first)
        if len(there):
            both += int(np.sum(cKDTree(there).query(first)[0] < GATHER_PX * px_m))
    return both / max(count, 1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make what is missing, and print what was found."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.train.surface.known_bodies", description=main.__doc__
    )
    parser.add_argument("config", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--chance", type=int, default=20, help="bodies of a family for the share of chance")
    parser.add_argument("--more", type=int, default=0, metavar="K", help="of the K-th entry of surface.more")
    parser.add_argument("--each", action="store_true", help="a row for each body")
    options = parser.parse_args(arguments)
    try:
        train = required_train(load_config(options.config).train, options.config)
        corpus, config = corpus_of(train, options.more)
        bodies = prepare_bodies(corpus, config, Silent(), options.workers)
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    print(
        rows_of(bodies, corpus.families) if options.each else table(bodies, corpus.families, options.chance)
    )


if __name__ == "__main__":
    main()
