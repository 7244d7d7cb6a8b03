"""Masks found before Earth and wall, against the truth, on scenes whose background is not dark.

    python -m lab.frontend.masks [CONFIG ...] [--pairs N] [--short] [-o JPG]

The first pairs of each scene are rendered; masks are found from the images as ``polhode run`` finds them,
and compared with the share of each pixel that the target covers. Columns: where the background was found;
intersection over union of the masks of left and right images (mean), of both (median, smallest, share that
is at least 0.95), and of what is brighter than a dark sky, for comparison; pairs whose masks are doubtful;
seconds of a core for a pair.
"""

from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Annotated

import cv2
import numpy as np
from tyro.conf import Positional, arg

from lab.command import QUICK, ROOT, Short, command, polhode
from lab.presentation import print_table
from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.rectification import Rectifier, make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Bools
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.report.pictures.mask_strip import mask_strip

SCENES = tuple(
    ROOT / "configs" / f"{name}.yaml"
    for name in ("scenes/earth_behind", "scenes/wall_behind", "scenes/specular_mli", "backgrounds/limb",
                 "backgrounds/posters")
)  # fmt: skip
HEAD = (
    "scene | pairs | background | IoU left | IoU right | median | smallest | at least 0.95 | by brightness | "
    "doubtful | seconds a pair"
)


def main(
    configs: Positional[Annotated[tuple[Path, ...], arg(help="Configurations of scenes.")]] = (),
    pairs: Annotated[int, arg(help="Successive pairs of each scene.")] = 48,
    short: Short = False,
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="JPG", help="Picture of the masks.")] = None,
) -> None:
    """Print the table; draw the masks, a picture for each scene."""
    rows = []
    for config in configs or SCENES[: 1 if short else None]:
        folder = rendered(config, 3 if short else pairs, QUICK if short else ())
        rows.append(
            measure(folder, None if output is None else output.with_stem(f"{output.stem}_{config.stem}"))
        )
    print_table(HEAD, rows)


def rendered(config: Path, pairs: int, options: tuple[str, ...]) -> Path:
    """The first pairs of a scene in data/masks; the true masks are set aside, so that none are found."""
    folder = ROOT / "data/masks" / f"{config.stem}_{pairs}"
    if not (folder / "truth1").is_dir():
        options = (*options, "--scene.frames", str(pairs), "--scene.render.masks", "True")
        polhode("simulate", config, "-o", folder, "--overwrite", *options)
        for side in (0, 1):
            (folder / "mav0" / f"masks{side}").rename(folder / f"truth{side}")
    return folder


def measure(folder: Path, picture: Path | None) -> list[str]:
    """Find the masks and compare them: a row of the table."""
    sequence = open_sequence(folder)
    rectifier, count = make_rectifier(sequence.calibration), len(sequence)
    truth = [[true_mask(folder, sequence, rectifier, k, side) for side in (0, 1)] for k in range(count)]
    bright = [
        intersection_over_union(target_mask(rectifier(sequence.read_left(k)[0], 0)), truth[k][0])
        for k in range(count)
    ]
    background, begin, found = find_background(sequence, rectifier), process_time(), None
    if background is not None:
        found = find_masks(sequence, rectifier, background, range(count), 1, lambda: None)
    seconds = (process_time() - begin) / count
    overlap = np.zeros((count, 2))
    for k, both in enumerate(truth):
        masks = None if found is None else found.masks(k)
        if masks is not None:
            overlap[k] = [intersection_over_union(mask, true) for mask, true in zip(masks, both, strict=True)]
    if picture is not None and found is not None:
        strip = mask_strip(sequence, replace(rectifier, found=found))
        if strip is not None:
            picture.write_bytes(strip[0])
    return [
        folder.name.rpartition("_")[0],
        str(count),
        "none" if background is None else background.description,
        *(f"{value:.3f}" for value in (*overlap.mean(axis=0), np.median(overlap), overlap.min())),
        f"{100 * (overlap >= 0.95).mean():.0f} %",
        f"{np.mean(bright):.3f}",
        str(0 if found is None else len(doubtful_frames(found))),
        f"{seconds:.2f}",
    ]


def true_mask(folder: Path, sequence: StereoSequence, rectifier: Rectifier, k: int, side: int) -> Bools:
    """Rectified, where the target covers at least half of a pixel (H, W)."""
    path = folder / f"truth{side}" / f"{sequence.timestamps_ns[k]}.png"
    raw = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if raw is None:
        raise SystemExit(f"{path}: not an image; remove {folder}, and it is simulated again")
    return np.asarray(rectifier(np.where(raw > 0, 255, 0).astype(np.uint8), side, cv2.INTER_LINEAR) > 127)


def intersection_over_union(found: Bools, truth: Bools) -> float:
    """Of two masks (H, W); 1 if both are empty."""
    union = int((found | truth).sum())
    return 1.0 if union == 0 else float((found & truth).sum() / union)


if __name__ == "__main__":
    command(main)
