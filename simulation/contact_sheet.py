"""A contact sheet of a sequence: ``python -m simulation.contact_sheet SEQ -o SHEET.png``."""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from polhode.dataset import open_sequence
from polhode.records import Bools

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


def main() -> None:
    """Write the sheet that the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m simulation.contact_sheet", description=__doc__)
    parser.add_argument("sequence", type=Path, metavar="SEQ")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SHEET.png")
    arguments = parser.parse_args()
    Image.fromarray(contact_sheet(arguments.sequence)).save(arguments.output, optimize=True)


if __name__ == "__main__":
    main()
