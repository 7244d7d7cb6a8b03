"""Which kind of recording the user's paths are."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from polhode.importers.options import ImportOptions
from polhode.importers.sources.euroc import is_euroc, open_euroc
from polhode.importers.sources.image_folders import ImageFiles, open_folders
from polhode.importers.sources.kitti import kitti_folders
from polhode.importers.sources.ros_bag import RosBag, is_bag, opened_bag
from polhode.importers.sources.tum_rgbd import is_tum_rgbd, open_tum_rgbd
from polhode.importers.sources.video import Videos, is_video, open_videos
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

KINDS = (
    "two folders of images (left, right, or images and depth), a folder of EuRoC or KITTI, a bag of ROS "
    "(.bag, .db3, .mcap, or its folder), a side-by-side video, two videos, or a folder of TUM RGB-D"
)

PACKED = (".zst", ".zstd", ".gz", ".bz2", ".xz", ".zip", ".7z", ".tar", ".tgz")
"""Suffixes of files that have to be unpacked"""

Recording = ImageFiles | RosBag | Videos
"""Timestamps and calibration first (``contents``), then the images that are wanted, each once (``images``)"""


@contextmanager
def opened_recording(
    paths: Sequence[Path], options: ImportOptions, progress: Progress
) -> Iterator[Recording]:
    """The recording of one path or two. Raises InputError for what is missing, of no known kind, or wrong."""
    if not paths:
        raise InputError(f"a source is missing: give {KINDS}; see polhode import --help")
    if len(paths) > 2:
        raise InputError(f"{len(paths)} sources were given: give {KINDS}")
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: no such file or folder; give {KINDS}")
    folders = len(paths) == 2 and all(path.is_dir() for path in paths)
    if options.states_ranges and not folders and not is_tum_rgbd(paths[0]) and not is_bag(paths[0]):
        raise InputError(
            f"{paths[0]}: --range-scale-m and its like are for two folders (images, depth), bags with depth "
            "and TUM RGB-D; leave them out"
        )
    bags, videos = [is_bag(path) for path in paths], [is_video(path) for path in paths]
    if all(bags):
        if len(paths) > 1:
            raise InputError(f"{paths[1]}: one bag is imported at a time; merge them, or import one by one")
        with opened_bag(paths[0], options, progress) as bag:
            yield bag
    elif packed := next((path for path in paths if path.suffix.lower() in PACKED), None):
        raise InputError(f"{packed}: a compressed file; unpack it first, and give what is in it")
    elif all(videos):
        yield open_videos(paths, options, progress)
    elif len(paths) == 1 and (kitti := kitti_folders(paths[0])):
        images = open_folders(kitti.left, kitti.right, options)
        yield replace(images, contents=replace(images.contents, calibration=kitti.calibration))
    elif folders:
        yield open_folders(paths[0], paths[1], options)
    elif len(paths) == 1 and is_tum_rgbd(paths[0]):
        yield open_tum_rgbd(paths[0], options)
    elif len(paths) == 1 and is_euroc(paths[0]):
        if options.stamps or options.rate_hz is not None:
            raise InputError(
                f"{paths[0]}: its times are those of data.csv; leave --stamps and --rate-hz out, or state "
                "--time-unit"
            )
        yield open_euroc(paths[0], options.poses, bool(options.calibration), options.time_unit)
    elif len(paths) == 1 and paths[0].is_dir():
        raise InputError(f"{paths[0]}: a single folder that is no EuRoC sequence and no bag; give {KINDS}")
    else:
        wrong = next(
            path for path, a, b in zip(paths, bags, videos, strict=True) if not (a or b) or len(paths) == 2
        )
        raise InputError(f"{wrong}: not a source; give {KINDS}")
