"""A folder in the layout of EuRoC: a dataset of polhode, or a sequence as its authors publish it.

Images, masks and tables are copied as they are. ``inspector0`` gives the inspector's poses; without it,
EuRoC's ``state_groundtruth_estimate0`` does, which states those of the same body.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.files.tables import attitudes_of, header_of, read_listing, read_table
from polhode.geometry.lie import make_pose
from polhode.importers.calibrations.read_rig import read_euroc_camera, read_euroc_rig
from polhode.importers.calibrations.rig import Rig, with_virtual_camera
from polhode.importers.sources.image_folders import ImageFiles
from polhode.importers.sources.recording import Contents, Poses
from polhode.importers.times import IN_NS, WORDS, TimeUnit, require_plausible, unit_in
from polhode.records.calibration_prior import states_sigmas
from polhode.records.camera_folders import CameraFolders, find_cameras
from polhode.records.mask_files import other_mask_folders
from polhode.records.range_images import read_range_model
from polhode.records.rig_calibration import read_range_calibration
from polhode.runtime.errors import InputError

ESTIMATE = "state_groundtruth_estimate0"
COPIED = ("inspector0/data.csv", "inspector0/sensor.yaml", "wrench0/data.csv")


def is_euroc(path: Path) -> bool:
    """Whether a folder has EuRoC's layout."""
    return (path / "mav0").is_dir() or (path / "cam0" / "data.csv").is_file()


def open_euroc(
    path: Path, poses: str | None, has_rig: bool = False, unit: TimeUnit | None = None
) -> ImageFiles:
    """The recording in ``path``. Raises InputError for what is missing or wrong.

    ``poses``: ``none`` leaves the inspector's poses out; ``has_rig``: another calibration takes the place of
    sensor.yaml, which may be missing; ``unit``: of the times in data.csv, as the user states it.
    """
    mav0 = path / "mav0" if (path / "mav0").is_dir() else path
    folders = find_cameras(mav0)
    cameras = (folders.folder(0), folders.folder(1))
    listings = [read_listing(camera / "data.csv") for camera in cameras]
    units = [unit or unit_in(",".join(header_of(camera / "data.csv")[:1])) or "ns" for camera in cameras]
    listings = [
        {stamp * IN_NS[each]: name for stamp, name in listing.items()}
        for each, listing in zip(units, listings, strict=True)
    ]
    files = [
        tuple(camera / "data" / name for name in names.values())
        for camera, names in zip(cameras, listings, strict=True)
    ]
    stamps = [np.array(list(names), dtype=np.int64) for names in listings]
    if unit is None:
        advice = "state the unit of data.csv: --time-unit ns, us, ms or s"
        require_plausible(cameras[0] / "data.csv", stamps[0], advice)
    rig = None if has_rig else _rig(folders)
    tables = {name: mav0 / name for name in COPIED if (mav0 / name).is_file()}
    found: Poses | None = None
    notes: tuple[str, ...] = ()
    if poses == "none":
        tables = {name: table for name, table in tables.items() if not name.startswith("inspector0")}
    elif poses is not None:
        raise InputError(
            f"--poses {poses}: a folder of EuRoC has no topics; leave it out, or give --poses none"
        )
    elif "inspector0/data.csv" not in tables and (mav0 / ESTIMATE / "data.csv").is_file():
        found = _estimate(mav0 / ESTIMATE / "data.csv")
        notes = (f"inspector poses: {ESTIMATE} (--poses none: cameras at rest)",)
    given = (folders.masks(0), None if folders.has_ranges else folders.masks(1))
    masks = [folder if folder is not None and folder.is_dir() else None for folder in given]
    ranges = read_range_model(cameras[1]) if folders.has_ranges else None
    contents = Contents(
        (stamps[0], stamps[1]),
        rig,
        found,
        None if rig is None else rig.left.bits,
        tables,
        (masks[0], masks[1]),
        (listings[0], listings[1]),
        ranges,
        times=f"{WORDS[units[0]]}, of data.csv",
        notes=notes,
        warnings=tuple(
            f"{path / name} is not used: the masks of a sequence are in mav0/masks0 and mav0/masks1"
            for name in other_mask_folders(mav0)
        ),
    )
    return ImageFiles(str(path), (files[0], files[1]), contents)


def _estimate(path: Path) -> Poses:
    """The poses of EuRoC's state estimate: p_RS_R (3) [m], q_RS (w, x, y, z)."""
    table = read_table(path, columns=7)
    return Poses(
        table.timestamps_ns, make_pose(attitudes_of(table, table.values[:, 3:], "q_RS"), table.values[:, :3])
    )


def _rig(folders: CameraFolders) -> Rig:
    """The calibration in the folder."""
    mav0 = folders.mav0
    if not folders.has_ranges:
        return read_euroc_rig(mav0, folders.names)
    rig = with_virtual_camera(read_euroc_camera(mav0, folders.names[0]))
    if states_sigmas(mav0, folders.names[:1]):
        rig = replace(rig, prior=read_range_calibration(mav0, folders.names[0]).prior)
    return rig
