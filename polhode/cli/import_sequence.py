"""``polhode import``: a recording of somebody else as a dataset."""

import math
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.console import choose_progress
from polhode.runtime.errors import InputError

MAX_TIME_S = 1e9
"""Of a recording, and of offsets between its clocks [s]"""


class ImportCommand(Command):
    """Make a dataset from a recording: images, bags, videos (docs/import.md).

    Sources: two folders of images (left, right; or images, depth); a bag of ROS 1 or ROS 2 (.bag, .db3,
    .mcap, or its folder); one side-by-side video, or two videos; a folder of EuRoC, or of TUM RGB-D (one
    camera with depth). Images are paired by nearest time, and copied without loss. An interrupted import goes
    on with the same command.
    """

    sources: Annotated[tuple[Path, ...], Positional("SOURCE...")]
    """One path or two."""
    output: Annotated[Path | None, Named("SEQ", "-o")] = None
    """Folder of the dataset, which is created."""
    dry_run: bool = False
    """Show what is understood of the recording, by its times and first images, and write nothing."""
    calibration: Annotated[tuple[Path, ...], Named("FILE...")] = ()
    """Calibration: a YAML or JSON file of OpenCV (or two: intrinsics, extrinsics), a camchain of Kalibr, two
    camera_info of ROS (left, right), or a folder with cam0/sensor.yaml and cam1/sensor.yaml. By default that
    of the bag or of the EuRoC folder."""
    unit: Annotated[Literal["m", "mm"], Named("m|mm")] = "m"
    """Unit of the lengths in the calibration: in a file of OpenCV that of the board's squares."""
    stamps: Annotated[tuple[Path, ...], Named("FILE...")] = ()
    """Timestamps for images and videos without: one row an image. One file for both cameras, or one each."""
    time_unit: Annotated[Literal["ns", "us", "ms", "s"] | None, Named("ns|us|ms|s")] = None
    """Unit of the times in these files, or in the names of the images. Recognized by headers, size and
    intervals unless given."""
    rate_hz: Annotated[float | None, Named("HZ"), Field(gt=0, le=MAX_TIME_S)] = None
    """Frame rate of numbered images, and of videos whose own times are wrong [Hz]."""
    left_topic: Annotated[str | None, Named("TOPIC")] = None
    """Topic of the left images in a bag. Found by its name unless given."""
    right_topic: Annotated[str | None, Named("TOPIC")] = None
    """Topic of the right images."""
    poses: Annotated[str | None, Named("TOPIC|tf:FRAME|none")] = None
    """Poses of the inspector in a bag: a topic (Odometry, PoseStamped), or the frame of tf that is at rest.
    By default the odometry whose frame tf links to the camera; none: the cameras are at rest."""
    pose_of: Annotated[str | None, Named("FRAME")] = None
    """What that topic states the pose of: a frame of tf, left (the left camera), or body (of the
    calibration)."""
    tolerance_s: Annotated[float | None, Named("S"), Field(ge=0, le=MAX_TIME_S)] = None
    """Largest difference between the timestamps of a pair, beyond the offset of the clocks [s]. A hundredth
    of the usual interval unless given."""
    offset_s: Annotated[float | None, Named("S"), Field(ge=-MAX_TIME_S, le=MAX_TIME_S)] = None
    """What the right camera's clock is ahead of the left one's [s]. Found from the timestamps unless
    given."""
    start_s: Annotated[float, Named("S", "--start"), Field(ge=0, le=MAX_TIME_S)] = 0.0
    """Begin so long after the first pair [s]."""
    end_s: Annotated[float, Named("S", "--end")] = math.inf
    """End so long after the first pair [s]."""
    every: Annotated[int, Named("N"), Field(ge=1)] = 1
    """Import each N-th pair."""
    crop: Annotated[str | None, Named("LEFT,TOP,WIDTH,HEIGHT")] = None
    """Part of the images that is kept [px]; the calibration is adjusted."""
    range_scale_m: Annotated[float | None, Named("M")] = None
    """Metres per unit of depth images: the second of two folders is depth if this is given. 0.0002 for TUM
    RGB-D unless given [m]."""
    range_sigma_m: Annotated[float | None, Named("M")] = None
    """Standard deviation of a pixel's depth, at no distance; needed for two folders. That of TUM's sensor
    unless given [m]."""
    range_growth_per_m: Annotated[float | None, Named("X")] = None
    """Part of it that grows with the square of the depth. That of TUM's sensor unless given [1/m]."""
    overwrite: bool = False
    """Replace an existing dataset that import made, if nothing was changed in it. Nothing else is ever
    replaced."""

    def execute(self) -> Answer:
        """Import. The dataset appears when it is complete; an interrupted one is resumed."""
        from polhode.importers.import_sequence import import_sequence, look_at_recording
        from polhode.importers.options import ImportOptions, parse_crop
        from polhode.records import range_images as limits

        for name, least, most in (
            ("range_scale_m", limits.MIN_SCALE_M, limits.MAX_SCALE_M),
            ("range_sigma_m", limits.MIN_SIGMA_M, limits.MAX_SIGMA_M),
            ("range_growth_per_m", 0.0, limits.MAX_GROWTH_PER_M),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise InputError(f"--{name.replace('_', '-')} {value:g}: give {least:g} to {most:g}")
        if not self.end_s > self.start_s:
            raise InputError(f"--end-s {self.end_s:g}: give a time after --start-s {self.start_s:g}")
        if (given := len(self.stamps)) > 2:
            raise InputError(f"--stamps: {given} files were given; give one, or one for each camera")
        same = {each.name for each in fields(ImportOptions)} - {"unit_m", "crop"}
        options = ImportOptions(
            **{name: getattr(self, name) for name in same},
            unit_m=1e-3 if self.unit == "mm" else 1.0,
            crop=None if self.crop is None else parse_crop(self.crop),
        )
        if self.dry_run:
            done = look_at_recording(self.sources, options, choose_progress())
        elif self.output is None:
            raise InputError("-o is missing: give the folder of the dataset, or --dry-run to write nothing")
        else:
            done = import_sequence(self.sources, self.output, options, choose_progress(), self.overwrite)
        paths = () if self.dry_run or self.output is None else (self.output,)
        width = max(map(len, done.understood))
        rows = [f"{name:{width}}  {text}" for name, text in done.understood.items()]
        return Answer(
            f"{done.pairs} {done.kind}, {done.duration_s:.4g} s: {paths[0] if paths else 'nothing written'}",
            "\n".join((*rows, *done.notes)),
            paths=paths,
            figures={
                "pairs": done.pairs,
                "kind": done.kind,
                "duration_s": done.duration_s,
                "understood": done.understood,
            },
        )
