"""The flow of an import: open, pair, write, publish.

Everything that times, topics and calibration can show is checked before the first image is written.
"""

import hashlib
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import polhode
from polhode.files.foreign_files import MIB, read_bytes
from polhode.files.images import UnreadableImage, read_header, read_raw
from polhode.geometry.lie import Ints
from polhode.importers.calibrations.read_rig import CAMERA_KINDS, KINDS, read_camera, read_rig
from polhode.importers.calibrations.rig import Rig, require_usable, with_virtual_camera, write_rig
from polhode.importers.image_writing import (
    WrittenImages,
    copy_masks,
    first_size,
    write_images,
    write_listings,
)
from polhode.importers.imported_dataset import ImportedDataset, require_free, staged_import
from polhode.importers.options import Crop, ImportOptions
from polhode.importers.pairs import MIN_PAIRS, ChosenPairs, choose_pairs
from polhode.importers.sources.open_recording import Recording, opened_recording
from polhode.importers.sources.recording import Contents
from polhode.importers.understood import understood
from polhode.records.dataset import read_inspector
from polhode.records.dataset_writer import write_inspector, write_range_sensor
from polhode.records.range_images import why_no_ranges
from polhode.records.rig_calibration import USUAL_BASELINES_M
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Imported:
    """What an import brought, or with a dry run would bring."""

    pairs: int
    duration_s: float
    understood: dict[str, str]
    """What was read out of the recording, by its name"""
    notes: tuple[str, ...]
    """What was chosen, for the user"""
    warnings: tuple[str, ...]
    kind: str = "stereo pairs"
    """What the pairs are"""


def import_sequence(
    sources: Sequence[Path], folder: Path, options: ImportOptions, progress: Progress, overwrite: bool = False
) -> Imported:
    """Write the dataset ``folder`` from a recording, resuming where the same import was interrupted.

    Raises InputError, one line: the folder exists (``overwrite`` replaces an import), a source is missing,
    damaged or of no known kind, it has no calibration or another one than its images, the cameras have no
    times in common. Raises RunFailure if a file cannot be written, KeyboardInterrupt with a message.
    """
    require_free(folder, overwrite)
    with opened_recording(sources, options, progress) as recording:
        rig, pairs, early = _begun(recording, options)
        has_ranges = recording.contents.ranges is not None
        with staged_import(folder, overwrite, _fingerprint(sources, options), has_ranges) as dataset:
            written, whole, lost = _write(recording, pairs, rig, options, dataset, progress)
            stamps_ns = np.array(written.stamps, dtype=np.int64)
            done = _summary(recording, options, pairs, stamps_ns, written, whole, (*early, *lost))
            dataset.write_record(_record(sources, options, pairs, done))
    return done


def look_at_recording(sources: Sequence[Path], options: ImportOptions, progress: Progress) -> Imported:
    """What ``import_sequence`` would bring, by its times and the first images alone; errors as there."""
    with opened_recording(sources, options, progress) as recording, TemporaryDirectory() as place:
        rig, pairs, early = _begun(recording, options)
        dataset = ImportedDataset(Path(place), recording.contents.ranges is not None)
        first = pairs.first(MIN_PAIRS)
        written, whole, lost = _write(recording, first, rig, options, dataset, progress)
        return _summary(recording, options, pairs, pairs.stamps_ns, written, whole, (*early, *lost))


def _begun(recording: Recording, options: ImportOptions) -> tuple[Rig, ChosenPairs, tuple[str, ...]]:
    """Calibration, pairs, and warnings about them."""
    contents = recording.contents
    rig = _rig(recording, options)
    pairs = choose_pairs(recording.name, contents, options)
    early = (*contents.warnings, *pairs.warnings)
    # a rig of 5 mm and more whose T is in millimetres: no image would show it, all lengths follow it
    if contents.ranges is None and rig.baseline_m > USUAL_BASELINES_M[1] and options.unit_m == 1.0:
        early += (
            f"{rig.right.source}: the cameras are {rig.baseline_m:.4g} m apart; if that calibration is in "
            "millimetres, give --unit mm: all lengths scale with it",
        )
    early += rig.remarks
    for line in early:
        _log.warning(line)
    return rig, pairs, early


def _write(
    recording: Recording,
    pairs: ChosenPairs,
    rig: Rig,
    options: ImportOptions,
    dataset: ImportedDataset,
    progress: Progress,
) -> tuple[WrittenImages, Rig, tuple[str, ...]]:
    """Write the whole dataset but its record: images, the rig of the images as recorded, warnings."""
    contents = recording.contents
    written = write_images(recording, pairs, rig, options.crop, dataset, progress)
    lost = _require_pairs(recording, pairs, written)
    whole = _sized(rig, written, dataset, options.crop)
    rig = whole
    if (crop := options.crop) is not None:
        part = (crop.left, crop.top, crop.width, crop.height)
        rig = replace(whole, left=whole.left.cropped(*part), right=whole.right.cropped(*part))
        require_usable(rig)
    try:
        lost += _write_others(contents, pairs, written, (whole, rig), options.crop, dataset)
    except InputError as error:
        # of files that are published under another name
        raise InputError(str(error).replace(str(dataset.path), recording.name)) from None
    if contents.ranges is not None:
        _require_ranges(recording, rig, written, dataset)
    for line in lost:
        _log.warning(line)
    return written, whole, lost


def _summary(
    recording: Recording,
    options: ImportOptions,
    pairs: ChosenPairs,
    stamps_ns: Ints,
    written: WrittenImages,
    rig: Rig,
    warnings: tuple[str, ...],
) -> Imported:
    """The result for the user; stamps_ns: (n,) of the pairs that are imported."""
    contents = recording.contents
    kind = "stereo pairs" if contents.ranges is None else "images with ranges"
    table = understood(recording, options, pairs, stamps_ns, written, rig)
    duration_s = 1e-9 * float(stamps_ns[-1] - stamps_ns[0])
    return Imported(len(stamps_ns), duration_s, table, (*contents.notes, *written.notes), warnings, kind)


def _rig(recording: Recording, options: ImportOptions) -> Rig:
    """The calibration that the user gives, else the recording's own; on the body whose poses there are."""
    contents = recording.contents
    rig, is_stereo = contents.rig, contents.ranges is None
    files = options.calibration or contents.calibration
    if files and is_stereo:
        rig = read_rig(files, lambda: first_size(recording), _kitti_cameras(recording.name))
    elif files:
        rig = with_virtual_camera(read_camera(files))
    if rig is None:
        kinds = KINDS if is_stereo else CAMERA_KINDS
        raise InputError(f"{recording.name}: no calibration in it; give --calibration: {kinds}")
    rig = rig.in_metres(options.unit_m) if is_stereo else rig
    if contents.poses is not None and contents.poses.X_BC0 is not None:
        rig = rig.on_body(contents.poses.X_BC0)
    if contents.bits is not None:
        rig = rig.of_depth(contents.bits)
    if all(camera.size_px is not None for camera in rig.cameras):
        require_usable(rig)
    return rig


def _kitti_cameras(name: str) -> tuple[int, int]:
    """Which two of KITTI's cameras the folders of a recording are those of; the grey ones unless named."""
    found = [int(number) for number in re.findall(r"image_0?([0-3])\b", name)]
    return (found[0], found[1]) if len(found) == 2 else (0, 1)


def _require_pairs(recording: Recording, pairs: ChosenPairs, written: WrittenImages) -> tuple[str, ...]:
    """Warnings of images that could not be read. Raises InputError if too few pairs are left."""
    if not written.unreadable:
        return ()
    left = len(written.stamps)
    line = (
        f"{recording.name}: {len(written.unreadable)} images cannot be read (first: {written.unreadable[0]})"
    )
    if left < MIN_PAIRS:
        raise InputError(
            f"{line}; {left} of {len(pairs.stamps_ns)} pairs are left, at least {MIN_PAIRS} are needed"
        )
    return (f"{line}; {len(pairs.stamps_ns) - left} pairs are left out",)


def _sized(rig: Rig, written: WrittenImages, dataset: ImportedDataset, crop: Crop | None) -> Rig:
    """The rig of the images as they were recorded. Raises InputError for a rig that no run reads."""
    cameras = []
    for index, camera in enumerate(rig.cameras):
        size = written.sizes[index] or (camera.size_px if crop else None)
        if size is None:
            name = next(iter(dataset.images_there(index).values()))
            size = read_header(read_bytes(dataset.folder(index) / "data" / name, 2**30, "an image")).size_px
        cameras.append(camera.sized(size))
    sized = replace(rig, left=cameras[0], right=cameras[1])
    require_usable(sized)
    return sized


def _write_others(
    contents: Contents,
    pairs: ChosenPairs,
    written: WrittenImages,
    rigs: tuple[Rig, Rig],
    crop: Crop | None,
    dataset: ImportedDataset,
) -> tuple[str, ...]:
    """Everything but the images, and warnings. ``rigs``: of the images as recorded, and as written."""
    mav0 = dataset.mav0
    write_rig(mav0, rigs[1], pairs.rate_hz, 2 if contents.ranges is None else 1)
    if (ranges := contents.ranges) is not None:
        write_range_sensor(
            dataset.folder(1), ranges.scale_m, ranges.sigma_m, ranges.growth_per_m, ranges.along_ray
        )
    write_listings(dataset, written)
    for name, source in contents.tables.items():
        (mav0 / name).parent.mkdir(parents=True, exist_ok=True)
        (mav0 / name).write_bytes(read_bytes(source, 512 * MIB, "a table"))
    if contents.poses is not None:
        poses = contents.poses
        write_inspector(mav0, poses.timestamps_ns, poses.X_NB, poses.sigma_p_m, poses.sigma_theta_rad)
    stamps = np.array(written.stamps, dtype=np.int64)
    if (mav0 / "inspector0" / "data.csv").is_file():
        read_inspector(mav0 / "inspector0", stamps)
    if any(contents.masks):
        own = [
            dict(zip(pairs.stamps_ns.tolist(), times[indices].tolist(), strict=True))
            for times, indices in zip(contents.stamps_ns, (pairs.left, pairs.right), strict=True)
        ]
        return copy_masks(contents.masks, contents.files, (own[0], own[1]), rigs[0], crop, mav0)
    return ()


def _require_ranges(recording: Recording, rig: Rig, written: WrittenImages, dataset: ImportedDataset) -> None:
    """Raise InputError if the first depth image holds no ranges."""
    stamp = written.stamps[0]
    size = rig.right.size_px
    assert size is not None
    try:
        wrong = why_no_ranges(read_raw(dataset.folder(1) / "data" / written.names[1][stamp], *size))
    except UnreadableImage as error:
        wrong = str(error)
    if wrong:
        raise InputError(f"{recording.name}: the depth image of {stamp} ns has {wrong}")


def _fingerprint(sources: Sequence[Path], options: ImportOptions) -> str:
    """A text that identifies what the images depend on: sources by size and date, options, the program."""
    digest = hashlib.sha256()
    for source in (*sources, *options.calibration, *options.stamps):
        for path in sorted(source.rglob("*")) if source.is_dir() else [source]:
            state = path.stat()
            digest.update(
                f"{path.absolute()} {state.st_size} {state.st_mtime_ns}\n".encode(errors="surrogateescape")
            )
    home = Path(polhode.__path__[0])
    for file in sorted((home / "importers").rglob("*.py")):
        digest.update(file.read_bytes())
    return f"{options}\n{digest.hexdigest()}\n"


def _record(
    sources: Sequence[Path], options: ImportOptions, pairs: ChosenPairs, done: Imported
) -> dict[str, object]:
    """The content of ``import.json``: what was imported, and what was found out."""
    defaults = vars(ImportOptions())
    return {
        "sources": [str(source) for source in sources],
        "options": {name: str(value) for name, value in vars(options).items() if value != defaults[name]},
        "pairs": len(pairs.stamps_ns),
        "unpaired": list(pairs.unpaired),
        "offset_of_stamps_s": 1e-9 * pairs.offset_ns,
        "understood": done.understood,
        "warnings": list(done.warnings),
    }
