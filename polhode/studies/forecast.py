"""What a study will take, before it is computed: points, sequences, rows and columns, disk space."""

import math
from dataclasses import dataclass
from pathlib import Path

from polhode.config import Scene
from polhode.files.foreign_files import amount
from polhode.studies.store import RUNS, SEQUENCES
from polhode.studies.study import OpenStudy, setting_of

COLUMNS = {"simulate": 0, "run": 80, "evaluate": 55, "plan": 15, "compare": 60, "measure": 5}
"""Of the table, by step; of a study without steps"""
RECORD_BYTES = {"simulate": 0, "run": 3000, "evaluate": 2000, "plan": 700, "compare": 3000, "measure": 500}
BLOCK_BYTES = 4096
"""Of the file system, which a small file takes up wholly"""
KEPT_BYTES = {"whole": 25_000_000, "summary": 41_000, "nothing": 0}
"""Of what is kept of a run"""


@dataclass(frozen=True)
class Forecast:
    """What a study will take."""

    points: int
    factors: dict[str, int]
    """Axis or design -> its values"""
    steps: tuple[str, ...]
    sequences: int
    """That are rendered, each once"""
    pairs: int
    """Stereo pairs of all of them"""
    rows: int
    columns: int
    table_bytes: int
    disk_bytes: int
    """Estimate of the most that is in the folder: at the end, before its records are packed"""
    measured: bool
    """Whether sequences and runs that are there already have been measured for that"""


def forecast(study: OpenStudy, folder: Path) -> Forecast:
    """What a study will take. Sizes are those of what ``folder`` holds already, where it holds something."""
    settings, steps = study.settings, study.settings.steps
    columns = 14 + len(study.columns) + sum(COLUMNS[step] for step in steps)
    record = 1200 + sum(RECORD_BYTES[step] for step in steps)
    records = study.count * BLOCK_BYTES * math.ceil(record / BLOCK_BYTES)
    # compressed, a cell takes 3 bytes
    table = int(study.count * columns * 3.0)
    pairs, sequence = 0.0, 0
    if study.sequences:
        pairs = _mean_product(study, "scene.frames")
        pixels = _mean_product(study, "scene.frames", "scene.rig.width_px", "scene.rig.height_px")
        # half a byte a pixel before a dark sky, compressed; and the truth with its mesh
        sequence = int(2 * pixels * 0.5) + 200_000
    kept = KEPT_BYTES[settings.keep] if "run" in steps or "compare" in steps else 0
    found = [_mean_bytes(folder / part) for part in (SEQUENCES, RUNS)]
    sequence, kept = found[0] or sequence, found[1] or kept
    return Forecast(
        points=study.count,
        factors={", ".join(factor.columns): len(factor) for factor in study.factors},
        steps=steps,
        sequences=study.sequences,
        pairs=round(study.sequences * pairs),
        rows=study.count,
        columns=columns,
        table_bytes=table,
        disk_bytes=records
        + table
        + study.count * kept
        + (study.sequences * sequence if settings.keep_sequences else 0),
        measured=any(found),
    )


def format_forecast(found: Forecast) -> str:
    """The same as lines for people."""
    factors = " x ".join(f"{name} {count}" for name, count in found.factors.items()) or "the base alone"
    lines = [
        f"points      {found.points:,} ({factors})",
        f"each        {', '.join(found.steps) or 'nothing: the table has the settings alone'}",
    ]
    if found.sequences:
        lines.append(f"rendered    {found.sequences:,} sequences, each once; {found.pairs:,} stereo pairs")
    basis = "from what is in the folder" if found.measured else "estimated"
    lines += [
        f"table       {found.rows:,} rows, about {found.columns} columns, {amount(found.table_bytes)}",
        f"disk        {amount(found.disk_bytes)} ({basis})",
    ]
    return "\n".join(lines)


def _mean_product(study: OpenStudy, *settings: str) -> float:
    """Mean over the points of the product of settings, of which each is set by one factor at most."""
    # the scenes of a base without one leave settings at their defaults
    defaults = {"scene": Scene().model_dump()}
    known = {each: setting_of(study.base, each) or setting_of(defaults, each) for each in settings}
    mean, free = 1.0, set(settings)
    for factor in study.factors:
        if own := free & factor.settings:
            products = [math.prod((known | changes)[each] for each in own) for changes in factor.changes]
            mean, free = mean * sum(products) / len(products), free - own
    return float(mean * math.prod(known[each] for each in free))


def _mean_bytes(folder: Path, most: int = 20) -> int:
    """Of the folders in it, at most so many; 0: there are none."""
    found = [each for each in sorted(folder.glob("*"))[:most] if each.is_dir()]
    sizes = [sum(file.stat().st_size for file in each.rglob("*") if file.is_file()) for each in found]
    return sum(sizes) // len(sizes) if sizes else 0
