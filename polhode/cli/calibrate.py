"""``polhode calibrate``: the calibration of a stereo rig from images of a board."""

import json
import math
from pathlib import Path
from typing import Annotated

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.errors import InputError

RECORDING = ("rate_hz", "left_topic", "right_topic", "tolerance_s", "start_s", "end_s", "every")
"""Options that are those of polhode import"""


class CalibrateCommand(Command):
    """Calibrate a stereo rig from images of a board: chessboard, ChArUco, AprilTags (docs/calibrate.md).

    Images come from --left and --right, or from a recording as polhode import reads it: two folders, a bag,
    a side-by-side video, two videos. Images that would spoil the result are left out, each with its reason.
    Writes sensor.yaml of both cameras, the same for OpenCV, Kalibr and ROS, calibration.json with the
    standard deviation of every parameter, and the page report.html.
    """

    sources: Annotated[tuple[Path, ...], Positional("SOURCE...")] = ()
    """A recording: one path or two, instead of --left and --right."""
    output: Annotated[Path, Named("RIG", "-o")]
    """Folder of the results: a new or empty one, or that of an earlier call, whose files are replaced."""
    board: Annotated[str, Named("9x6")]
    """Columns x rows: inner corners of a chessboard, squares of a ChArUco board, tags of an AprilTag grid."""
    square_mm: Annotated[float, Named("MM"), Field(gt=0, allow_inf_nan=False)]
    """Side of a square, or of a tag (its black part), as measured on the board [mm]."""
    left: Annotated[tuple[str, ...], Named("GLOB...")] = ()
    """Images of the left camera: patterns, files or a folder."""
    right: Annotated[tuple[str, ...], Named("GLOB...")] = ()
    """Images of the right camera. Paired by the number in the name, else by natural order."""
    pattern: Annotated[str, Named("chessboard|charuco|aprilgrid")] = "chessboard"
    """What is on the board."""
    marker_mm: Annotated[float | None, Named("MM")] = None
    """Side of the markers of a ChArUco board [mm]; three quarters of a square unless given."""
    spacing: Annotated[float, Named("SHARE")] = 0.3
    """Gap between the tags of a grid, over their side."""
    dictionary: Annotated[str | None, Named("NAME")] = None
    """Dictionary of the markers, as OpenCV calls it; 5X5_100 of a ChArUco board, APRILTAG_36h11 of a grid
    unless given."""
    model: Annotated[str, Named("brown5|brown8|fisheye")] = "brown5"
    """Lens model of both cameras: Brown's distortion with 5 or 8 coefficients, or an equidistant fisheye."""
    right_model: Annotated[str | None, Named("MODEL")] = None
    """That of the right camera, if it is another one."""
    rate_hz: Annotated[float | None, Named("HZ")] = None
    """Frame rate of videos whose own times are wrong [Hz]."""
    left_topic: Annotated[str | None, Named("TOPIC")] = None
    """Topic of the left images in a bag. Found by its name unless given."""
    right_topic: Annotated[str | None, Named("TOPIC")] = None
    """Topic of the right images."""
    tolerance_s: Annotated[float | None, Named("S")] = None
    """Largest difference between the times of a pair [s]. A hundredth of the usual interval unless given."""
    start_s: Annotated[float, Named("S", "--start")] = 0.0
    """Of a recording, begin so long after the first pair [s]."""
    end_s: Annotated[float, Named("S", "--end")] = math.inf
    """End so long after the first pair [s]."""
    every: Annotated[int, Named("N"), Field(ge=1)] = 1
    """Look at each N-th pair of a recording; at most 200, spread over it, are looked at."""

    def execute(self) -> Answer:
        """Calibrate, write and print."""
        if not self.end_s > self.start_s >= 0.0:
            raise InputError(
                f"--start-s {self.start_s:g} --end-s {self.end_s:g}: give times of at least 0, end later"
            )
        from polhode.calibration.boards import make_board
        from polhode.calibration.calibrate import calibrate
        from polhode.calibration.image_pairs import opened_pairs
        from polhode.calibration.lenses import model_named
        from polhode.calibration.page import (
            PAGE,
            RESULT,
            files_of,
            format_calibration,
            results_folder,
            write_results,
        )
        from polhode.importers.options import ImportOptions
        from polhode.runtime.console import choose_progress

        board = make_board(
            self.pattern,
            self.board,
            1e-3 * self.square_mm,
            None if self.marker_mm is None else 1e-3 * self.marker_mm,
            self.spacing,
            self.dictionary,
        )
        models = (
            model_named("--model", self.model),
            model_named("--right-model", self.right_model or self.model),
        )
        options = ImportOptions(poses="none", **{name: getattr(self, name) for name in RECORDING})
        progress = choose_progress()
        opened = opened_pairs(self.sources, self.left, self.right, options, progress)
        with results_folder(self.output) as place, opened as pairs:
            rig = calibrate(pairs, board, models, progress)
            files = files_of(rig, place.name)
            write_results(place, files)
        return Answer(
            f"Calibration: {self.output / PAGE}",
            format_calibration(rig),
            paths=tuple(self.output / name for name in sorted(files, key=lambda name: name != PAGE)),
            figures=json.loads(files[RESULT]),
        )
