"""A contact sheet of one sequence, or of scenes that are rendered for it.

``python -m polhode.simulation.figures.contact_sheet SEQ -o SHEET.png``
``python -m polhode.simulation.figures.contact_sheet configs/ts38.yaml configs/scenes -o SHEET.png``
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rich.progress import Progress as RichProgress

from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.records import Bools
from polhode.simulation.figures.scene_sheet import draw_sheet, scene_files, strips_of

Grey = NDArray[np.uint8]


def contact_sheet(folder: Path, columns: int = 4, rows: int = 2, width_px: int = 240) -> Grey:
    """Left images evenly over the sequence, cropped to where anything is seen, row by row (h, w).

    Raises InputError: the folder is no sequence.
    """
    sequence = open_sequence(folder)
    chosen = np.linspace(0, len(sequence.timestamps_ns) - 1, columns * rows).round().astype(int)
    images = np.stack([sequence.read_pair(int(k)).left for k in chosen])
    top, bottom, left, right = _lit_box(images)
    height_px = round(width_px * (bottom - top) / (right - left))
    tiles = [
        np.asarray(Image.fromarray(image[top:bottom, left:right]).resize((width_px, height_px)))
        for image in images
    ]
    return np.vstack([np.hstack(tiles[r * columns : (r + 1) * columns]) for r in range(rows)])


def _lit_box(images: Grey, above_dn: int = 20, margin_px: int = 8) -> tuple[int, int, int, int]:
    """Rows and columns (top, bottom, left, right) that hold all lit pixels of all images (n, h, w)."""
    lit: Bools = np.max(images, axis=0) > above_dn
    height, width = lit.shape
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    if len(rows) == 0:
        return 0, height, 0, width
    return (
        max(int(rows[0]) - margin_px, 0),
        min(int(rows[-1]) + 1 + margin_px, height),
        max(int(columns[0]) - margin_px, 0),
        min(int(columns[-1]) + 1 + margin_px, width),
    )


def main(words: Sequence[str] | None = None) -> int:
    """Write the sheet that the command line asks for; 2 for a mistake in it."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.simulation.figures.contact_sheet", description=__doc__
    )
    what = "a dataset; or configurations with a scene, and folders of them"
    parser.add_argument("sources", type=Path, nargs="+", metavar="SOURCE", help=what)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SHEET.png")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="parallel processes")
    arguments = parser.parse_args(words)
    try:
        # Before the work, so that none is lost.
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        draw(arguments.sources, arguments.workers).save(arguments.output, optimize=True)
    except InputError as error:
        print(f"contact_sheet: error: {error}", file=sys.stderr)
        return 2
    return 0


def draw(sources: list[Path], workers: int = 1) -> Image.Image:
    """The sheet of one dataset, or of scenes. Raises InputError."""
    if len(sources) == 1 and (sources[0] / "mav0").is_dir():
        return Image.fromarray(contact_sheet(sources[0]))
    files = scene_files(sources)
    with RichProgress() as progress:
        task = progress.add_task("scenes", total=len(files))
        strips = strips_of(files, workers, lambda: progress.advance(task))
    return draw_sheet(strips)


if __name__ == "__main__":
    sys.exit(main())
