"""A folder of TUM's RGB-D benchmark: colour and depth images of one camera, and its poses.

rgb.txt and depth.txt list times and files, groundtruth.txt poses of the colour camera (t x y z, q x y z w) by
a motion capture system (Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012). Depth
images are registered to the colour ones, 16 bits, a value of 5000 is 1 m; depth is along the optical axis.

The noise of a pixel is that of the benchmark's sensor, the first Kinect: 1.425 mm at 1 m, growing with the
square of the depth (Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data for indoor mapping
applications", Sensors 12, 2012), and rounding beside it.
"""

from pathlib import Path

import numpy as np

from polhode.files.foreign_files import MIB, read_text
from polhode.files.tables import number_rows
from polhode.geometry.lie import Ints, make_pose, matrix_from_wxyz
from polhode.importers.options import ImportOptions
from polhode.importers.sources.image_folders import ImageFiles
from polhode.importers.sources.recording import Contents, Poses
from polhode.importers.times import read_times
from polhode.records.range_images import RangeModel
from polhode.runtime.errors import InputError

POSES = "groundtruth.txt"


def is_tum_rgbd(path: Path) -> bool:
    """Whether a folder is laid out as that benchmark's."""
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def open_tum_rgbd(path: Path, options: ImportOptions) -> ImageFiles:
    """The recording in ``path``: colour images as those of the camera, depth images as its ranges.

    Raises InputError for what is missing or wrong.
    """
    listings = [_listing(path, name) for name in ("rgb.txt", "depth.txt")]
    if options.poses not in (None, "none"):
        raise InputError(
            f"--poses {options.poses}: TUM RGB-D has no topics; leave it out, or give --poses none"
        )
    given = (options.range_scale_m, options.range_sigma_m, options.range_growth_per_m)
    usual = (1.0 / 5000.0, 0.5e-3, 1.425e-3)
    scale, sigma, growth = (u if each is None else each for each, u in zip(given, usual, strict=True))
    model = RangeModel(scale, sigma, growth)
    poses = None
    notes: tuple[str, ...] = (
        f"ranges: {model.scale_m:g} m per unit, standard deviation {1e3 * model.sigma_m:g} mm and "
        f"{1e3 * model.growth_per_m:g} mm at 1 m, growing with the square (--range-scale-m, --range-sigma-m, "
        "--range-growth-per-m)",
    )
    if options.poses is None and (path / POSES).is_file():
        poses = _poses(path / POSES)
        notes = (*notes, f"inspector poses: {POSES} (--poses none: camera at rest)")
    (colour_ns, colour), (depth_ns, depth) = listings
    contents = Contents((colour_ns, depth_ns), None, poses, notes=notes, ranges=model)
    return ImageFiles(str(path), (colour, depth), contents)


def _listing(folder: Path, name: str) -> tuple[Ints, tuple[Path, ...]]:
    """Times [ns] and files. Raises InputError for a row without a file, or one that is not in the folder."""
    table = folder / name
    stamps_ns = read_times(table).stamps_ns
    files: list[Path] = []
    for number, line in enumerate(read_text(table, 512 * MIB, "a table").splitlines(), start=1):
        words = line.replace(",", " ").split(maxsplit=1)
        if not words or words[0].startswith("#") or (not files and words[0][0].isalpha()):
            continue
        if len(words) < 2:
            raise InputError(f"{table} line {number}: no file; give time and file in each row")
        file = Path(words[1].strip())
        if file.is_absolute() or ".." in file.parts:
            raise InputError(f"{table} line {number}: the name leads out of the folder; give a file in it")
        files.append(folder / file)
    return stamps_ns, tuple(files)


def _poses(path: Path) -> Poses:
    """Poses of the colour camera. Raises InputError for a row that is no pose."""
    what = "timestamp tx ty tz qx qy qz qw"
    rows = np.array([row for _, row in number_rows(path, 8, what, 1_000_000)]).reshape(-1, 8)
    stamps_ns = read_times(path).stamps_ns
    if len(rows) != len(stamps_ns):
        raise InputError(f"{path}: {len(rows)} of {len(stamps_ns)} rows hold a pose; give {what} in each")
    q_xyzw, p = rows[:, 4:], rows[:, 1:4]
    length = np.linalg.norm(q_xyzw, axis=1)
    if len(rows) == 0 or (abs(length - 1.0) > 1e-2).any() or abs(p).max() > 1e12:
        raise InputError(f"{path}: a quaternion is not of unit length, or a coordinate is none; correct it")
    R = matrix_from_wxyz(q_xyzw[:, [3, 0, 1, 2]] / length[:, None])
    return Poses(stamps_ns, make_pose(R, p), X_BC0=np.eye(4))
