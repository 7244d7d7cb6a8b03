"""Masks found before Earth and wall, against the truth, on scenes whose background is not dark.

    python -m benchmarks.frontend.masks [CONFIG ...] [--pairs N] [--short] [-o PNG]

The first pairs of each scene are rendered; masks are found from the images as ``polhode run`` finds them,
and compared with the share of each pixel that the target covers. Columns: where the background was found;
intersection over union of the masks of left and right images (mean), of both (median, smallest, share that
is at least 0.95), and of what is brighter than a dark sky, for comparison; pairs whose masks are doubtful;
seconds of a core for a pair.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Annotated, cast

import cv2
import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import ROOT, Png, Short, command
from benchmarks.presentation import print_table
from polhode.dataset import StereoCalibration, StereoImages, StereoSequence
from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.found_masks import FoundMasks
from polhode.frontend.rectification import Image, Rectifier, make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.images import to_grey
from polhode.lie import Array
from polhode.pipeline.pictures.mask_strip import mask_strip
from polhode.records import Bools
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, load_scene, plan_sequence
from polhode.simulation.stereo_camera import mount_pose

SCENES = tuple(
    ROOT / "configs" / f"{name}.yaml"
    for name in (
        *("scenes/earth_behind", "scenes/wall_behind", "scenes/specular_mli"),
        *("backgrounds/limb", "backgrounds/posters"),
    )
)
HEAD = (
    "scene | pairs | background | IoU left | IoU right | median | smallest | at least 0.95 | by brightness | "
    "doubtful | seconds a pair"
)


@dataclass(frozen=True)
class RenderedPairs:
    """Some pairs of a scene, in memory: what is read of a ``StereoSequence``, and the true masks."""

    calibration: StereoCalibration
    X_NC: Array
    """(F, 4, 4)"""
    images: tuple[tuple[Image, Image], ...]
    masks: tuple[tuple[Bools, Bools], ...]
    has_ranges: bool = False

    def __len__(self) -> int:
        return len(self.images)

    def read_pair(self, k: int) -> StereoImages:
        """Pair k, without masks."""
        return StereoImages(*self.images[k], None, None)

    def read_left(self, k: int) -> tuple[Image, None]:
        """The left image of pair k."""
        return self.images[k][0], None


def rendered(config: Path, pairs: int, quick: bool = False) -> RenderedPairs:
    """The first pairs of a scene; ``quick``: one ray a pixel, no indirect light."""
    scene, seed = load_scene(config)
    if quick:
        render = scene.render.model_copy(update={"samples": 1, "bounces": 0})
        scene = scene.model_copy(update={"render": render})
    plan = plan_sequence(scene, seed)
    frames = list(range(min(pairs, scene.frames)))
    renderer = FrameRenderer(plan)
    images, masks = [], []
    for k in frames:
        (left, of_left), (right, of_right) = (renderer.render_image(k, side) for side in (0, 1))
        bits = scene.sensor.bits
        images.append((to_grey(left, bits), to_grey(right, bits)))
        masks.append((of_left.covered >= 0.5, of_right.covered >= 0.5))
    return RenderedPairs(calibration_of(plan), plan.X_NC[frames], tuple(images), tuple(masks))


def calibration_of(plan: SequencePlan) -> StereoCalibration:
    """The rig of a plan."""
    left, right = plan.cameras
    X_BC = mount_pose(plan.scene.rig)
    return StereoCalibration(
        left.K,
        right.K,
        left.dist,
        right.dist,
        X_BC @ left.X_CK,
        X_BC @ right.X_CK,
        left.width_px,
        left.height_px,
        fisheye0=left.fisheye,
        fisheye1=right.fisheye,
        right_size_px=(right.width_px, right.height_px),
    )


@dataclass(frozen=True)
class MaskErrors:
    """Of the masks of one scene."""

    background: str
    overlap: Array
    """(F, 2) intersection over union in left and right images"""
    by_brightness: float
    """Of what is brighter than a dark sky, in the left images"""
    doubtful: int
    seconds: float
    found: FoundMasks | None
    rectifier: Rectifier


def measure(pairs: RenderedPairs) -> MaskErrors:
    """Find the masks and compare them."""
    sequence, rectifier = cast(StereoSequence, pairs), make_rectifier(pairs.calibration)
    truth = [
        tuple(
            rectifier(mask.astype(np.uint8) * np.uint8(255), side, cv2.INTER_LINEAR) > 127
            for side, mask in enumerate(both)
        )
        for both in pairs.masks
    ]
    bright = [
        intersection_over_union(target_mask(rectifier(left, 0)), mask[0])
        for (left, _), mask in zip(pairs.images, truth, strict=True)
    ]
    background = find_background(sequence, rectifier)
    begin = process_time()
    found = (
        None
        if background is None
        else find_masks(sequence, rectifier, background, range(len(pairs)), 1, lambda: None)
    )
    seconds = (process_time() - begin) / len(pairs)
    overlap = np.zeros((len(pairs), 2))
    for k, true in enumerate(truth):
        masks = None if found is None else found.masks(k)
        if masks is not None:
            overlap[k] = [intersection_over_union(mask, t) for mask, t in zip(masks, true, strict=True)]
    return MaskErrors(
        "none" if background is None else background.description,
        overlap,
        float(np.mean(bright)),
        0 if found is None else len(doubtful_frames(found)),
        seconds,
        found,
        rectifier,
    )


def intersection_over_union(found: Bools, truth: Bools) -> float:
    """Of two masks (H, W); 1 if both are empty."""
    union = int((found | truth).sum())
    return 1.0 if union == 0 else float((found & truth).sum() / union)


def main(
    configs: Positional[Annotated[tuple[Path, ...], arg(help="Configurations of scenes.")]] = (),
    pairs: Annotated[int, arg(help="Successive pairs of each scene.")] = 48,
    short: Short = False,
    output: Png = None,
) -> None:
    """Print the table; draw the masks of the first scene."""
    rows = []
    for config in configs or SCENES:
        seen = rendered(config, 2 if short else pairs, quick=short)
        errors = measure(seen)
        overlap = errors.overlap
        words = f"{config.stem} | {len(seen)} | {errors.background} | {overlap[:, 0].mean():.3f} | "
        words += f"{overlap[:, 1].mean():.3f} | {np.median(overlap):.3f} | {overlap.min():.3f} | "
        words += f"{100 * (overlap >= 0.95).mean():.0f} % | {errors.by_brightness:.3f} | "
        rows.append(words + f"{errors.doubtful} | {errors.seconds:.2f}")
        if output is not None and errors.found is not None:
            _draw(seen, errors, output.with_stem(f"{output.stem}_{config.stem}"))
    print_table(HEAD, rows)


def _draw(seen: RenderedPairs, errors: MaskErrors, path: Path) -> None:
    """The picture that a run's report shows."""
    rectifier = replace(errors.rectifier, found=errors.found)
    strip = mask_strip(cast(StereoSequence, seen), rectifier)
    if strip is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        picture = cv2.imdecode(np.frombuffer(strip[0], dtype=np.uint8), cv2.IMREAD_COLOR)
        cv2.imwrite(str(path), picture)


if __name__ == "__main__":
    command(main)
