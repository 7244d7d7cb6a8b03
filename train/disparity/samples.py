"""Training samples of disparity with their truth, cached on disk, and augmented batches of them.

A sample is the input of the network and the truth. Semi-global matching of a pair takes longer than a
training step, so it is done once for each pair. A pair gives two samples: the second is its mirror image with
exchanged cameras. The truth: the simulator writes the depth of every pixel of the unrectified images
(``truth0``, ``truth1``). Here it is transformed to the rectified images, together with the visibility of each
pixel's surface in the other camera.

Batches contain random crops of samples. Data augmentation compensates for the small number of bodies: rows
are flipped, matches are removed as on a textureless panel, hypotheses are displaced, and one image is
brightened.
"""

import logging
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from polhode.config.frontend_settings import Depth
from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced, write_text
from polhode.files.foreign_files import MIB, read_text
from polhode.files.output.single_file import remove_all_partials
from polhode.frontend.disparity.learned import (
    InitialDisparity,
    fill_holes,
    hypotheses,
    initial_disparity,
    input_channels,
)
from polhode.frontend.disparity.sgbm import Floats, cut_crop
from polhode.frontend.rectification import Rectifier, make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array, Bools, inverse_pose
from polhode.records.dataset import StereoCalibration, StereoSequence, open_sequence
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.frame_renderer import products_path, read_products
from polhode.train.corpus import scene_digest
from polhode.train.task import Batch

MAX_LIST_BYTES = MIB
_NAME = re.compile(r"[^/]+_\d{3,}m?\.npz")
"""Of a file of samples."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrueDisparity:
    """Truth (H, W) of one rectified image."""

    disparity: Floats
    """[px], NaN outside the target"""
    visible: Bools
    """the other camera sees the same surface"""
    sunlit: Bools
    """in direct sunlight"""


def true_disparities(
    sequence: StereoSequence, rectifier: Rectifier, k: int
) -> tuple[TrueDisparity, TrueDisparity]:
    """True disparities of the left and the right image of pair k. Raises InputError: the truth is missing."""
    rig, disparity, sunlit = rectifier.rig, [], []
    for side in (0, 1):
        path = products_path(sequence.folder / "mav0", side, int(sequence.timestamps_ns[k]))
        found = read_products(path)
        if found.depth is None or found.shadow is None:
            raise InputError(f"{path}: contains no depth or no shadow; simulate with scene.render.products")
        z = rectified_depth(found.depth, sequence.calibration, rectifier, side)
        disparity.append((rig.focal_px * rig.baseline_m / z + rig.disparity_offset_px).astype(np.float32))
        shadowed = _resampled(found.shadow.astype(np.float32), rectifier, side)
        sunlit.append(np.isfinite(z) & (shadowed == 0))
    return (
        TrueDisparity(disparity[0], _visible(disparity[0], disparity[1], 1), sunlit[0]),
        TrueDisparity(disparity[1], _visible(disparity[1], disparity[0], -1), sunlit[1]),
    )


def rectified_depth(depth: Array, calibration: StereoCalibration, rectifier: Rectifier, side: int) -> Array:
    """Depth (H', W') [m] along the rectified axis from depth (H, W) along a camera's own axis."""
    own_depth = _resampled(depth.astype(np.float32), rectifier, side).astype(np.float64)
    rig = rectifier.rig
    centre = rig.cx_px - (rig.disparity_offset_px if side == 1 else 0.0)
    v, u = np.mgrid[: own_depth.shape[0], : own_depth.shape[1]]
    ray_R = np.stack([(u - centre) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones(u.shape)], axis=-1)
    R_KR = rectifier.X_CR[:3, :3]
    if side == 1:
        X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1
        R_KR = X_CD[:3, :3].T @ R_KR
    return np.asarray(own_depth / (ray_R @ R_KR[2]))


def _resampled(image: Floats, rectifier: Rectifier, side: int) -> Floats:
    """The rectified image, from the nearest pixels; NaN outside the original image."""
    if rectifier.maps is None:
        return image
    map_u, map_v = rectifier.maps[side]
    return np.asarray(
        cv2.remap(
            image, map_u, map_v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
        ),
        dtype=np.float32,
    )


def _visible(disparity: Floats, other: Floats, sign: int) -> Bools:
    """Pixels for which one of the nearest pixels of the other image, at u - sign * disparity, agrees."""
    h, w = disparity.shape
    target = np.isfinite(disparity)
    there = np.arange(w)[None, :] - sign * np.where(target, disparity, 0.0)
    visible = np.zeros((h, w), dtype=bool)
    for column in (np.floor(there), np.ceil(there)):
        inside = (column >= 0) & (column < w)
        found = np.take_along_axis(other, np.clip(column, 0, w - 1).astype(np.int64), axis=1)
        with np.errstate(invalid="ignore"):
            # largest difference of the disparities of a point that both cameras see
            visible |= inside & (np.abs(found - disparity) < 1.0)
    return np.asarray(visible & target)


@dataclass(frozen=True)
class DisparitySample:
    """One crop (h, w) with its truth."""

    start: InitialDisparity
    truth: Floats
    """(h, w) disparity of the crop [px]; NaN outside the target"""
    visible: Bools
    """(h, w) both cameras see the surface"""

    def part(self, rows: slice, columns: slice) -> "DisparitySample":
        """The rectangle of the given rows and columns."""
        inner = (rows, columns)
        return DisparitySample(self.start.part(rows, columns), self.truth[inner], self.visible[inner])


def build_samples(folder: Path, cache: Path, config: Depth, seed: int, every: int = 1) -> list[Path]:
    """Files with the samples of every n-th pair of one simulated sequence; one that is in the cache, made
    from the same scene with the same settings, is not matched again.

    Raises InputError: the cache has a file of another program under the name of a list of samples.
    """
    made: list[Path] = []
    index = cache / f"{folder.name}.txt"
    first = f"# samples of scene {scene_digest(folder)}, seed {seed}, every {every}"
    if index.is_file():
        head, *names = read_text(index, MAX_LIST_BYTES, "a list of samples").splitlines() or [""]
        if not (head.startswith("# samples") or head == "" or _NAME.fullmatch(head)):
            raise InputError(f"{index}: is no list of samples, so it stays; choose another train.depth.cache")
        there = [cache / name for name in names if _NAME.fullmatch(name)]
        if head == first and len(there) == len(names) and all(each.is_file() for each in there):
            return there
        _log.warning("%s: of another scene or other settings, or incomplete; it is matched again", index)
    cache.mkdir(parents=True, exist_ok=True)
    remove_all_partials(cache)
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    for k in range(0, len(sequence), every):
        for mirrored in (False, True):
            path = cache / f"{folder.name}_{k:03d}{'m' if mirrored else ''}.npz"
            rng = np.random.default_rng([seed, k, mirrored, zlib.crc32(folder.name.encode())])
            sample = make_sample(sequence, rectifier, k, mirrored, config, rng)
            if sample is not None:
                write_sample(path, sample)
                made.append(path)
    write_text(index, "\n".join([first, *(path.name for path in made)]) + "\n")
    return made


def make_sample(
    sequence: StereoSequence,
    rectifier: Rectifier,
    k: int,
    mirrored: bool,
    config: Depth,
    rng: np.random.Generator,
) -> DisparitySample | None:
    """The sample of pair k, or None: the target is out of view, or almost nothing matches."""
    raw = sequence.read_pair(k)
    left, right = rectifier(raw.left, 0), rectifier(raw.right, 1)
    truth = true_disparities(sequence, rectifier, k)[int(mirrored)]
    if mirrored:
        left, right = np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1])
        truth = TrueDisparity(truth.disparity[:, ::-1], truth.visible[:, ::-1], truth.sunlit[:, ::-1])
    mask = target_mask(left)
    known = np.isfinite(truth.disparity) & mask
    if known.sum() < 500:
        return None
    margins = rng.uniform(0.0, 8.0, 2)  # largest margin of the search range around the true disparities
    span = (
        float(truth.disparity[known].min() - margins[0]),
        float(truth.disparity[known].max() + margins[1]),
    )
    crop = cut_crop(left, right, mask, span, config)
    start = initial_disparity(crop, config)
    if start is None:
        return None
    inner = crop.inner
    disparity = (truth.disparity[inner] - np.float32(crop.shift_px)).astype(np.float32)
    return DisparitySample(start, disparity, truth.visible[inner])


def write_sample(path: Path, sample: DisparitySample) -> None:
    """Write the whole file or nothing."""
    arrays = {f"start_{f.name}": getattr(sample.start, f.name) for f in fields(InitialDisparity)}
    truth = {"truth": sample.truth, "visible": sample.visible}
    with replaced(path) as partial:
        np.savez(partial, allow_pickle=False, **truth, **arrays)


def read_sample(path: Path) -> DisparitySample:
    """Read a file of ``write_sample``. Raises InputError for anything else."""
    names = [f.name for f in fields(InitialDisparity) if f.name != "margin_px"]
    images = {f"start_{name}": ("fb", 2) for name in names} | {"truth": ("f", 2), "visible": ("b", 2)}
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, images | {"start_margin_px": ("iu", 0)})
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    values = {name: arrays[f"start_{name}"] for name in names}
    start = InitialDisparity(**values, margin_px=int(arrays["start_margin_px"]))
    return DisparitySample(start, arrays["truth"], arrays["visible"])


def random_crop(sample: DisparitySample, size: tuple[int, int], rng: np.random.Generator) -> DisparitySample:
    """A rectangle (h, w) around a random pixel of the target; a smaller sample is first padded with sky."""
    more = [max(wanted - side, 0) for wanted, side in zip(size, sample.truth.shape, strict=True)]
    if any(more):
        pads = ((0, more[0]), (0, more[1]))
        sample = DisparitySample(
            sample.start.padded((more[0], more[1])),
            np.pad(sample.truth, pads, constant_values=np.nan),
            np.pad(sample.visible, pads),
        )
    v, u = (int(i) for i in rng.choice(np.argwhere(sample.start.target)))
    h, w = sample.truth.shape
    top = int(np.clip(v - rng.integers(0, size[0]), 0, h - size[0]))
    first = int(np.clip(u - rng.integers(0, size[1]), 0, w - size[1]))
    return sample.part(slice(top, top + size[0]), slice(first, first + size[1]))


def random_batch(files: Sequence[Path], size: int, crop_px: int, rng: np.random.Generator) -> Batch:
    """``size`` augmented crops of random samples."""
    chosen = rng.choice(len(files), size, replace=len(files) < size)
    return stack([augment(random_crop(read_sample(files[i]), (crop_px, crop_px), rng), rng) for i in chosen])


def stack(samples: Sequence[DisparitySample]) -> Batch:
    """A batch of B samples of equal size.

    ``channels`` (B, CHANNELS, h, w); ``hypotheses`` (B, 6, h, w) [px]; (B, h, w): ``truth`` [px], NaN outside
    the target; ``visible``: both cameras see the surface; ``lit``: bright enough for matching; ``target``: by
    the front end's segmentation.
    """
    images: dict[str, list[NDArray[np.generic]]] = {
        "truth": [sample.truth for sample in samples],
        "visible": [sample.visible for sample in samples],
        "lit": [sample.start.lit for sample in samples],
        "target": [sample.start.target for sample in samples],
    }
    return {
        "channels": torch.cat([input_channels(sample.start) for sample in samples]),
        "hypotheses": torch.stack([hypotheses(sample.start) for sample in samples]),
        **{name: torch.from_numpy(np.stack(each)) for name, each in images.items()},
    }


def augment(sample: DisparitySample, rng: np.random.Generator) -> DisparitySample:
    """The sample with random changes that preserve or follow the truth."""
    if rng.random() < 0.5:
        sample = flip_rows(sample)
    start = sample.start
    if rng.random() < 0.5:
        start = remove_matches(start, int(rng.integers(1, 6)), rng)
    if rng.random() < 0.3:
        start = shift_by_plane(start, rng)
    if rng.random() < 0.5:
        gain = np.float32(rng.uniform(0.85, 1.15))
        start = replace(start, right=start.right * gain)
    return replace(sample, start=start)


def flip_rows(sample: DisparitySample) -> DisparitySample:
    """The sample with rows in reverse order, which preserves the epipolar lines."""

    def flipped(instance: object) -> dict[str, NDArray[np.generic]]:
        arrays = {k: v for k, v in vars(instance).items() if isinstance(v, np.ndarray)}
        return {name: np.ascontiguousarray(array[::-1]) for name, array in arrays.items()}

    return DisparitySample(start=replace(sample.start, **flipped(sample.start)), **flipped(sample))  # type: ignore[arg-type]


def remove_matches(start: InitialDisparity, count: int, rng: np.random.Generator) -> InitialDisparity:
    """Matches removed in ``count`` ellipses, and the holes filled again."""
    h, w = start.filled.shape
    hole = np.zeros((h, w), dtype=np.uint8)
    for _ in range(count):
        centre = (int(rng.integers(w)), int(rng.integers(h)))
        axes = (int(rng.integers(3, 30)), int(rng.integers(3, 30)))
        cv2.ellipse(hole, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
    known = np.isfinite(start.sigma) & (hole == 0)
    if known.sum() < 50:
        return start
    filled = fill_holes(np.where(known, start.filled, np.nan).astype(np.float32))
    sigma = np.where(known, start.sigma, np.nan).astype(np.float32)
    return replace(start, filled=filled, sigma=sigma)


def shift_by_plane(start: InitialDisparity, rng: np.random.Generator) -> InitialDisparity:
    """All hypotheses displaced by a random plane of about a pixel."""
    h, w = start.filled.shape
    v, u = np.mgrid[-0.5 : 0.5 : h * 1j, -0.5 : 0.5 : w * 1j]
    value, slope_u, slope_v = rng.normal(0.0, (0.5, 0.7, 0.7))
    plane = (value + slope_u * u + slope_v * v).astype(np.float32)
    names = ("filled", "far", "near", "unchecked", "facet", "coarse")
    return replace(start, **{name: getattr(start, name) + plane for name in names})
