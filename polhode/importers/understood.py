"""What an import understood of a recording, as a table for the user and for ``import.json``."""

from pathlib import Path

import numpy as np

from polhode.geometry.lie import Ints
from polhode.importers.calibrations.rig import Camera, Rig
from polhode.importers.image_writing import WrittenImages
from polhode.importers.options import ImportOptions
from polhode.importers.pairs import ChosenPairs
from polhode.importers.sources.open_recording import Recording
from polhode.importers.sources.recording import Contents
from polhode.records.mask_files import find_masks, mask_file
from polhode.records.pairing import time_in_words


def understood(
    recording: Recording,
    options: ImportOptions,
    pairs: ChosenPairs,
    stamps_ns: Ints,
    written: WrittenImages,
    rig: Rig,
) -> dict[str, str]:
    """Rows of the table: name -> text.

    stamps_ns: (n,) of the pairs that are imported; rig: of the images as recorded.
    """
    contents = recording.contents
    is_stereo = contents.ranges is None
    table = {
        "source": recording.name,
        "left camera" if is_stereo else "camera": _camera(rig.left),
    }
    if is_stereo:
        table["right camera"] = _camera(rig.right)
        table["baseline"] = f"{rig.baseline_m:.4g} m"
    table["calibration"] = ", ".join(map(str, options.calibration)) or "the recording's own"
    noun = "pairs" if is_stereo else "images with ranges"
    steps_ns = np.diff(stamps_ns)
    interval = f"{time_in_words(float(np.median(steps_ns)))} apart, " if len(steps_ns) else ""
    table["times"] = (
        f"{len(stamps_ns)} {noun}, {interval}{1e-9 * (stamps_ns[-1] - stamps_ns[0]):.4g} s, from "
        f"{contents.times}"
    )
    clock = "none" if not pairs.offset_ns else time_in_words(pairs.offset_ns)
    ahead = "" if not pairs.offset_ns else " ahead" if pairs.offset_ns > 0 else " behind"
    table["offset of the right clock" if is_stereo else "offset of the ranges' clock"] = clock + ahead
    table["masks"] = _masks(contents, pairs)
    table["inspector poses"] = (
        f"{len(contents.poses.timestamps_ns)}"
        if contents.poses is not None
        else "as the dataset has them"
        if "inspector0/data.csv" in contents.tables
        else "none: the cameras are at rest"
    )
    listed = [len(each) for each in contents.stamps_ns]
    left_out = sum(pairs.unpaired)
    reasons = [f"{left_out} of {sum(listed)} images without a partner"] if left_out else []
    unchosen = min(listed) - left_out // 2 - len(pairs.stamps_ns)
    if options.every > 1 or options.start_s > 0.0 or np.isfinite(options.end_s):
        reasons.append(f"{max(unchosen, 0)} pairs by --start, --end and --every")
    if contents.left_out:
        reasons.append(f"{contents.left_out} images of other parts, since the clock was set back")
    if written.unreadable:
        reasons.append(f"{len(written.unreadable)} images that cannot be read")
    table["left out"] = "; ".join(reasons) or "nothing"
    return table


def _camera(camera: Camera) -> str:
    fu, fv, _, _ = camera.intrinsics
    lens = "no distortion" if camera.model == "none" or not any(camera.distortion) else camera.model
    if camera.size_px is None:
        return f"focal length {fu:.4g} px, {lens}"
    width, height = camera.size_px
    view = [f"{np.rad2deg(2.0 * np.arctan2(side, 2.0 * f)):.3g}" for side, f in ((width, fu), (height, fv))]
    return f"{width}x{height} px, {' x '.join(view)} deg, focal length {fu:.4g} px, {lens}"


def _masks(contents: Contents, pairs: ChosenPairs) -> str:
    """How many of the pairs have a mask, of each camera."""
    counts = []
    for side, folder, files, stamps_ns, chosen in zip(
        ("left", "right"),
        contents.masks,
        contents.files,
        contents.stamps_ns,
        (pairs.left, pairs.right),
        strict=True,
    ):
        if folder is None:
            continue
        masks = find_masks(folder, files, pairs.stamps_ns.tolist())
        own = zip(stamps_ns[chosen].tolist(), pairs.stamps_ns.tolist(), strict=True)
        found = sum(mask_file(masks, each, Path(files.get(each[0], ""))) is not None for each in own)
        counts.append(f"{found} {side}")
    return ", ".join(counts) or "none"
