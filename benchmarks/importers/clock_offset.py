"""Offsets between the cameras' exposures that images show, over simulated scenes and known offsets.

    python -m benchmarks.importers.clock_offset            every scene
    python -m benchmarks.importers.clock_offset --short    two scenes

Each scene is rendered with five times its frame rate, at half its resolution. Left images are every fifth
one; the right images of an offset of n fifths of a frame are those n images later.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from benchmarks.command import Short, command
from polhode.config.loader import load_config
from polhode.dataset_writer import image_path
from polhode.images import Grey
from polhode.importers.calibrations.read_rig import read_rig
from polhode.importers.image_checks import ClockOffset, clock_offset
from polhode.importers.stereo_matches import match_pair
from polhode.progress import Silent
from polhode.simulation import simulate
from polhode.tables import read_listing

SCENES = (
    "asteroid",
    "axisymmetric",
    "fast_20rpm",
    "flat_spin",
    "hard_light",
    "major_axis",
    "minor_axis",
    "pure_spin",
    "slow_tumble_5deg_s",
    "specular_mli",
    "unrectified_rig",
)
STEPS = 5
"""Images in a frame interval."""
FRAMES = 36
ANCHORS = range(2 * STEPS, FRAMES - 2 * STEPS + 1, STEPS)
OFFSETS = (-2, -1, 0, 1, 2)
"""In steps."""


def render(name: str, folder: Path) -> float:
    """Render a scene; returns the interval between frames [s]."""
    scene = load_config(Path("configs/scenes") / f"{name}.yaml").scene
    assert scene is not None
    rig = scene.rig
    small = rig.model_copy(
        update={
            "width_px": rig.width_px // 2,
            "height_px": rig.height_px // 2,
            "focal_px": rig.focal_px / 2.0,
        }
    )
    fast = scene.model_copy(
        update={
            "frames": FRAMES,
            "interval_s": scene.interval_s / STEPS,
            "truth_horizon_s": 0.0,
            "rig": small,
            "render": scene.render.model_copy(update={"samples": 4, "bounces": 0, "products": ()}),
        }
    )
    simulate(fast, 1, folder, Silent())
    return scene.interval_s


def estimates(folder: Path, interval_s: float) -> dict[int, ClockOffset | None]:
    """What the images show, for each true offset in steps."""
    stamps = list(read_listing(folder / "mav0" / "cam0" / "data.csv"))
    rig = read_rig([folder])

    def image(camera: int, k: int) -> Grey:
        return np.asarray(Image.open(image_path(folder / "mav0" / f"cam{camera}", stamps[k])).convert("L"))

    found = {}
    for offset in OFFSETS:
        matches = [
            match_pair(
                image(0, k),
                *(image(1, k + offset + step) for step in (0, -STEPS, STEPS)),
                -interval_s,
                interval_s,
            )
            for k in ANCHORS
        ]
        found[offset] = clock_offset(matches, rig, interval_s)
    return found


def table(names: Sequence[str]) -> str:
    """A row a scene: estimates in frames, and what is reported."""
    head = " | ".join(f"{offset / STEPS:+.1f}" for offset in OFFSETS)
    lines = [f"| scene | {head} |", "|" + "---|" * (len(OFFSETS) + 1)]
    errors, zeros = [], []
    for name in names:
        with TemporaryDirectory() as temporary:
            folder = Path(temporary) / "sequence"
            interval_s = render(name, folder)
            found = estimates(folder, interval_s)
        cells = []
        for offset, each in found.items():
            if each is None or not each.is_observable:
                cells.append("not observable")
                continue
            frames, sigma = each.dt_s / interval_s, each.sigma_s / interval_s
            cells.append(f"{frames:+.3f} +- {sigma:.3f}{', reported' if each.is_apart else ''}")
            errors.append((frames - offset / STEPS) / sigma)
            if offset == 0:
                zeros.append(abs(frames))
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if errors:
        lines.append(
            f"\nErrors over sigma: rms {np.sqrt(np.mean(np.square(errors))):.2f}, largest "
            f"{np.abs(errors).max():.2f}; largest of {len(zeros)} without an offset: "
            f"{max(zeros, default=0.0):.4f} frames"
        )
    return "\n".join(lines)


def main(scenes: tuple[str, ...] = SCENES, short: Short = False) -> None:
    """Print the table."""
    print(table(scenes[:2] if short else scenes))


if __name__ == "__main__":
    command(main)
